"""``clradar view``: look at recordings, captures and volumes in a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.console import counted, print_line, print_warning
from clradar.cli.options.common import DEVICE, FORCE
from clradar.cli.options.groups import REQUIRED, argument, option, wrong_usage
from clradar.cli.options.measured import DepthMapOptions, Variant
from clradar.cli.options.scene import PlacementOptions
from clradar.cli.outputs import check_outputs, check_page

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, kw_only=True)
class BesideOptions(PlacementOptions):
    """What is shown beside the measurement."""

    simulated: list[Path] | None = option(
        None,
        "Capture, volume or recording to show in a second colour; may be repeated.",
        metavar="SIMULATED",
    )
    mesh: Path | None = option(
        None,
        "Draw this mesh, and without --simulated simulate it for the radar of PATH.",
        metavar="MESH",
    )
    pose: str | None = option(
        None,
        "The same of the parametric hand: a name or a pose file, its middle at 300 mm or its wrist "
        "where --transform has it; or pose.toml or folder of a fit, the hand where it was found.",
        metavar="POSE",
        without="--mesh",
    )
    left: bool = option(False, "A left hand, unless a fit says which.", needs="--pose")

    def scene(self, device: cl.Device) -> cl.Scene | None:
        """The mesh where it is, if there is one."""
        if self.mesh is not None:
            return cl.Scene.from_mesh(self.mesh, unit=self.unit, transform=self.matrix())
        if self.pose is not None:
            handedness = "left" if self.left else "right"
            return posed_hand(self.pose, handedness, self.matrix(), device)
        if self.transform is not None:
            raise wrong_usage("--transform", "expected --mesh or --pose with it")
        return None


def posed_hand(
    text: str, handedness: str, transform: np.ndarray | None, device: cl.Device
) -> cl.Scene:
    """The hand of a pose, at 300 mm, where it was fitted, or its wrist where `transform` has it."""
    import numpy as np

    from calibration.hand_fit.starts import FIT_FILE, starts_of
    from clradar.errors import ModelError
    from clradar.files.json_file import read_json_object
    from clradar.hand import HandShape, hand_mesh

    path = Path(text)
    folder = path if path.is_dir() else path.parent
    if (path.is_dir() or path.suffix == ".toml") and (folder / FIT_FILE).is_file():
        text = str(folder)
        options = read_json_object(folder / FIT_FILE).get("options")
        if isinstance(options, dict) and options.get("rig"):
            raise ModelError(
                f"{folder}: expected the fit of the parametric hand, got that of a rig; "
                f"--mesh {folder / 'placed.ply'} has it where it was found"
            )
    start, *others = starts_of(text)
    if others:
        raise wrong_usage("--pose", f"expected one pose, got {text!r}")
    mesh = hand_mesh(
        start.pose,
        handedness=start.handedness or handedness,
        shape=start.shape or HandShape(),
        device=device,
    )
    matrix = start.transform if transform is None else transform
    if matrix is not None:
        mesh = mesh.moved(np.eye(3), -mesh.joints_m[0])
    return cl.Scene.from_mesh(mesh, transform=matrix)


def command(
    path: Path = argument(
        REQUIRED,
        "Recording (radar folder, or the folder that holds one), data set, capture, recorded .npy "
        "frame, volume, a folder of these files, or the .json of `clradar compare`.",
        metavar="PATH",
    ),
    *,
    watch: bool = option(
        False,
        "PATH is a folder or data set that is being written: it may be empty yet, and the newest "
        "file or sample comes first. Without it, frames that come later are followed, too.",
        without="--html",
    ),
    variant: Variant = option("raw", "Variant of a recording's frames."),
    html: Path | None = option(
        None,
        "Write scene and time line of all frames into this .html file, and serve nothing.",
        metavar="FILE",
    ),
    force: bool = FORCE,
    port: int = option(
        8080, "Port at 127.0.0.1, or the next one that is free; 0: any free one.", min=0, max=65535
    ),
    beside: BesideOptions,
    depth: DepthMapOptions,
    device: str | None = DEVICE,
) -> None:
    """Serves a page at 127.0.0.1 until Ctrl-C, and prints its address. Needs viser: pip install
    'clradar[view]'. Captures are imaged as `clradar image` does, with larger voxels at first.
    """
    check_page(html)
    check_outputs([html], force=force, inputs=[path])
    from clradar.view.beside import Others, Simulation
    from clradar.view.samples import SampleFrames
    from clradar.view.server import serve
    from clradar.view.sources import open_source
    from clradar.view.truth import HasTruth, recording_truth
    from clradar.view.wish import Wish

    simulated = list(beside.simulated or [])
    if path.suffix == ".json":
        path, compared = compared_files(path)
        simulated = [*compared, *simulated]
    opened = cl.open_device(device)
    scene = beside.scene(opened)  # a mesh that cannot be read should not cost an image first
    source = open_source(path, variant, watch=watch)
    second: Others | Simulation | None = None
    if simulated:
        second = Others(source, tuple(open_source(other) for other in simulated))
    elif scene is not None:
        second = Simulation(scene, opened)
    wish = Wish(dynamic_range_db=depth.dynamic_range_db)
    truth: HasTruth | None = recording_truth(path, source.label)
    if isinstance(source, SampleFrames):
        truth = source
    shown: dict[str, Any] = {
        "wish": wish, "beside": second, "mesh": scene, "truth": truth, "device": opened
    }  # fmt: skip
    if html is None:
        serve(source, port=port, say=print_line, **shown)
        return
    from clradar.view.page_file import write_page

    count = write_page(source, html, force=force, warn=print_warning, **shown)
    print_line(f"{html}: {counted(count, 'frame')}, for any browser")


def compared_files(path: Path) -> tuple[Path, list[Path]]:
    """The files that `clradar compare --json` compared: the measured and the simulated ones.

    They are looked for where the comparison was made, and then beside its file.
    """
    from clradar.errors import MeasurementError
    from clradar.files.json_file import read_json_object

    record = read_json_object(path)
    measured, simulated = record.get("measured"), record.get("simulated")
    entries = simulated if isinstance(simulated, list) else []
    named: list[Any] = [measured, *(e.get("file") for e in entries if isinstance(e, dict))]
    if len(named) < 2 or not all(isinstance(name, str) for name in named):
        raise MeasurementError(
            f"{path}: expected what `clradar compare --json` writes, with 'measured' and the "
            "'file' of each of 'simulated'"
        )
    found = [p if p.exists() else path.parent / p for p in map(Path, named)]
    return found[0], found[1:]
