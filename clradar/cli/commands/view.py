"""``clradar view``: look at recordings, captures and volumes in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli import options as opt, parse
from clradar.cli.console import counted, print_line, print_warning
from clradar.jobs import open_devices


def command(
    path: Path = opt.argument(
        "Recording, data set, capture, recorded .npy frame, volume, or a folder of these files.",
    ),
    *,
    watch: bool = opt.option(
        "PATH is being written: it may be empty yet, and the newest comes first.",
        False,
        without="--html",
    ),
    variant: opt.Variant = opt.option("Variant of a recording's frames.", "raw"),
    html: Path | None = opt.written(
        "Write scene and time line of all frames into this .html file, and serve nothing.",
        check=parse.page,
    ),
    port: int = opt.option(
        "Port at 127.0.0.1, or the next free one; 0: any free one.", 8080, min=0, max=65535
    ),
    simulated: list[Path] | None = opt.option(
        "Capture, volume or recording to show in a second colour; may be repeated.",
        metavar="SIMULATED",
    ),
    mesh: Path | None = opt.option(
        "Draw this mesh, and without --simulated simulate it for the radar of PATH.",
        metavar="MESH",
    ),
    place: opt.PlacementOptions,
    depth: opt.DepthMapOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Serves a page at 127.0.0.1 until Ctrl-C, and prints its address. Needs viser: pip install
    viser. Captures are imaged as `clradar image` does, with larger voxels at first.
    """
    from clradar.view.beside import Others, Simulation
    from clradar.view.samples import SampleFrames
    from clradar.view.server import serve
    from clradar.view.session import View
    from clradar.view.sources import open_source
    from clradar.view.truth import recording_truth
    from clradar.view.wish import Wish

    opened = open_devices(device).first
    scene = None
    if mesh is not None:  # one that cannot be read should not cost an image first
        scene = cl.Scene.from_mesh(mesh, unit=place.unit, transform=place.matrix())
    elif place.transform is not None:
        raise opt.wrong_usage("--transform", "expected --mesh with it")
    source = open_source(path, variant, watch=watch)
    second: Others | Simulation | None = None
    if simulated:
        second = Others(source, tuple(open_source(other) for other in simulated))
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

    count = write_page(view, html, force=opt.call.force, warn=print_warning)
    print_line(f"{html}: {counted(count, 'frame')}, for any browser")
