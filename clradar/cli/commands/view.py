"""``clradar view``: look at recordings, captures and volumes in a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli.console import counted, print_line, print_warning
from clradar.cli.options.common import DEVICE, FORCE
from clradar.cli.options.groups import REQUIRED, argument, option, wrong_usage
from clradar.cli.options.measured import DepthMapOptions, Variant
from clradar.cli.options.scene import PlacementOptions
from clradar.cli.outputs import PAGES, check_outputs, check_suffix
from clradar.jobs import open_devices


@dataclass(frozen=True, kw_only=True)
class BesideOptions(PlacementOptions):
    """What is shown beside the measurement."""

    simulated: list[Path] | None = option(
        "Capture, volume or recording to show in a second colour; may be repeated.",
        metavar="SIMULATED",
    )
    mesh: Path | None = option(
        "Draw this mesh, and without --simulated simulate it for the radar of PATH.",
        metavar="MESH",
    )

    def scene(self) -> cl.Scene | None:
        """The mesh where it is, if there is one."""
        if self.mesh is not None:
            return cl.Scene.from_mesh(self.mesh, unit=self.unit, transform=self.matrix())
        if self.transform is not None:
            raise wrong_usage("--transform", "expected --mesh with it")
        return None


def command(
    path: Path = argument(
        "Recording (radar folder, or the folder that holds one), data set, capture, recorded .npy "
        "frame, volume, or a folder of these files.",
        REQUIRED,
        metavar="PATH",
    ),
    *,
    watch: bool = option(
        "PATH is being written: it may be empty yet, and the newest comes first.",
        False,
        without="--html",
    ),
    variant: Variant = option("Variant of a recording's frames.", "raw"),
    html: Path | None = option(
        "Write scene and time line of all frames into this .html file, and serve nothing.",
        metavar="FILE",
        panel="Output",
    ),
    force: bool = FORCE,
    port: int = option(
        "Port at 127.0.0.1, or the next free one; 0: any free one.", 8080, min=0, max=65535
    ),
    beside: BesideOptions,
    depth: DepthMapOptions,
    device: str | None = DEVICE,
) -> None:
    """Serves a page at 127.0.0.1 until Ctrl-C, and prints its address. Needs viser: pip install
    viser. Captures are imaged as `clradar image` does, with larger voxels at first.
    """
    check_suffix(html, PAGES)
    check_outputs([html], force=force, inputs=[path])
    from clradar.view.beside import Others, Simulation
    from clradar.view.samples import SampleFrames
    from clradar.view.server import serve
    from clradar.view.session import View
    from clradar.view.sources import open_source
    from clradar.view.truth import recording_truth
    from clradar.view.wish import Wish

    opened = open_devices(device).first
    scene = beside.scene()  # a mesh that cannot be read should not cost an image first
    source = open_source(path, variant, watch=watch)
    second: Others | Simulation | None = None
    if beside.simulated:
        second = Others(source, tuple(open_source(other) for other in beside.simulated))
    elif scene is not None:
        second = Simulation(scene, opened)
    truth = recording_truth(path, source.label)
    if isinstance(source, SampleFrames):
        truth = source.truth
    about: Any = {"beside": second, "mesh": scene, "truth": truth, "device": opened}
    view = View(source=source, wish=Wish(dynamic_range_db=depth.dynamic_range_db), **about)
    if html is None:
        serve(view, port, print_line)
        return
    from clradar.view.page_file import write_page

    count = write_page(view, html, force=force, warn=print_warning)
    print_line(f"{html}: {counted(count, 'frame')}, for any browser")
