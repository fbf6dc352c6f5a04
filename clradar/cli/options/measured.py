"""Options of a measurement: radar, frame of a recording, cleaning, image formation; and of all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import calibration
import clradar as cl
import measurement_io
from clradar.arrays import instruments
from clradar.cli import parse
from clradar.cli.groups import argument, arguments_of, call, option, written
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.jobs import Where
from clradar.model import checks

CAPTURE: Any = argument("Native capture, recorded .npy frame, or radar folder.")
MEASURED: Any = argument("Volume, capture or recording.")
DEVICE: Any = option(
    "OpenCL device: selector or part of its name, or several to divide the work among: with "
    "commas, or all (all GPUs). [default: as `clradar devices` shows]",
    None,
    "--device",
    metavar="NAME",
    panel="Expert",
    kept=False,
)
JSON: Any = option("Print JSON, in metres and hertz.", False, "--json", panel="Output")


def figure(help: str, *names: str, **details: Any) -> Any:
    """A field that is the option of a figure to write."""
    help = f"{help}: .png, .pdf or .svg."
    return written(help, *names, "--figure", check=parse.figure, **details)


page = partial(written, check=parse.page)

own_option = partial(option, needs="--fit-hand", without="--rig")
"""Of the embedded hand: a rig is one hand, whose mesh, size and side are what they are."""

rig_option = partial(option, needs="--rig")


def alpha_or_fit() -> Any:
    """The alpha of what is fitted to a measurement: a number, or `parse.FIT`."""
    return option(
        "0 specular to 1 diffuse, or fit: as the brightness falls with the angle.",
        parse.FIT,
        metavar="ALPHA|fit",
        parse=parse.alpha_or_fit,
    )


ITERATED = "--method=least-squares|sparse"
"""Of images that are formed by iteration, as a rule of `option`."""

Unit = Literal["m", "mm", "cm", "inch"]
Variant = Literal["raw", "emptyfiltered"]


@dataclass(frozen=True, kw_only=True)
class UnitOptions:
    unit: Unit = option("Unit of length of the mesh file.", "m")


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    search_deg: float = option(
        "Rotations about boresight that are tried.", 45.0, panel="Expert", check=checks.positive
    )


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """The processes that the work is divided among."""

    PANEL = "Expert"

    workers: int | None = option(
        "Worker processes (pip install 'dask[distributed]'), each with a GPU or a share of the "
        "cores. [default: one for each of several devices, else this one]",
        min=1,
        without=ITERATED,
        kept=False,
    )
    scheduler: str | None = option(
        "Address of a Dask scheduler, whose workers see the same files.",
        metavar="tcp://HOST:PORT",
        without=f"--workers {ITERATED}",
        kept=False,
    )

    def where(self, device: str | None) -> Where:
        """Where the work is done; workers of a scheduler have to see all inputs."""
        return Where(device, self.workers, self.scheduler, tuple(call.paths))


def array_files(array: str) -> list[Path]:
    """The file of an array, if it is none that comes along."""
    return [] if array in instruments.KNOWN else [Path(array)]


array_option = partial(
    option,
    "Antennas: a .toml file (docs/arrays.md), or qar50, the 94 x 94 imager.",
    "qar50",
    metavar="ARRAY",
    files=array_files,
)


@dataclass(frozen=True, kw_only=True)
class RadarOptions:
    """The antennas, and the frequencies of a stepped-frequency sweep."""

    PANEL = "Input"

    band: parse.Band = option(
        "First and last frequency, GHz, and their number.",
        "72:82:128",
        metavar="FIRST:LAST:STEPS",
        parse=parse.band,
    )

    array: str = array_option()

    def waveform(self) -> cl.Waveform:
        """The frequencies, those of the paper without the option."""
        start_ghz, stop_ghz, steps = self.band
        return cl.Waveform.sfcw(start_ghz * 1e9, stop_ghz * 1e9, steps)

    def antennas(self) -> cl.AntennaArray:
        known = instruments.KNOWN.get(self.array)
        return cl.arrays.read_array(self.array) if known is None else known()

    def clusters(self) -> tuple[cl.AntennaArray, ...]:
        """The arrays of a file of clusters, each of which has a capture of its own; else one."""
        known = instruments.KNOWN.get(self.array)
        return cl.arrays.read_clusters(self.array) if known is None else (known(),)


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """Which frame of a recording; as `measurement_io.open_capture` takes it."""

    PANEL = "Input"

    frame: int | None = option("Frame of a recording. [default: 0]")
    variant: Variant | None = option("Variant of a recording's frame. [default: raw]")


@dataclass(frozen=True, kw_only=True)
class AntennaOptions:
    """Files with the positions of antennas; as `measurement_io.open_recording` takes them."""

    rx_file: Path | None = option("Positions of the Rx antennas of a recorded frame.")
    tx_file: Path | None = option("Positions of the Tx antennas of a recorded frame.")


PAPER_GRID_MM = ((-100.0, 100.0, 1.0), (-100.0, 100.0, 1.0), (260.0, 340.0, 1.0))
"""The grid of the paper's experiment: 201 x 201 x 81 voxels of 1 mm."""


@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """The voxel grid, in millimetres; without any of the three one that shows the object."""

    PANEL = "Grid"

    x_mm: parse.Axis | None = option(
        f"{parse.GRID_RULE}. [default: around the echoes]", metavar="RANGE", parse=parse.axis_mm
    )
    y_mm: parse.Axis | None = option("The same along y.", metavar="RANGE", parse=parse.axis_mm)
    z_mm: parse.Axis | None = option("The same along z.", metavar="RANGE", parse=parse.axis_mm)

    def grid(self, defaults_mm: tuple[parse.Axis, ...] = PAPER_GRID_MM) -> cl.VoxelGrid:
        """The grid, with default ranges for the axes that were not given."""
        own = (self.x_mm, self.y_mm, self.z_mm)
        axes = [axis or default for axis, default in zip(own, defaults_mm, strict=True)]
        x_m, y_m, z_m = ((first / 1e3, last / 1e3) for first, last, _ in axes)
        return cl.VoxelGrid.from_extent(x_m, y_m, z_m, [step / 1e3 for _, _, step in axes])


def grid_text(grid: cl.VoxelGrid) -> str:
    """Voxels and ends of a grid."""
    from clradar.imaging.grid_words import box_words

    return f"{' x '.join(map(str, grid.counts))} voxels ({box_words(grid)})"


METHODS = (
    "fast: over a tree of blocks, error -50 dB; range: from range profiles, -54 dB; exact: the "
    "plain sum."
)


@dataclass(frozen=True, kw_only=True)
class ImagingOptions:
    method: Literal["fast", "range", "exact"] = option(METHODS, "fast")
    window: Literal["rect", "hann", "taylor"] = option(
        "Weights over frequency.", "rect", without=ITERATED
    )

    @property
    def iterated(self) -> bool:
        """Whether it is formed by iteration: by `clradar.reconstruct`."""
        return self.method in ("least-squares", "sparse")

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`."""
        return {"method": self.method, "window": self.window}


@dataclass(frozen=True, kw_only=True)
class DepthMapOptions:
    dynamic_range_db: float = option(
        "Cut this far below an image's maximum.", DYNAMIC_RANGE_DB, check=checks.dynamic_range
    )


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    PANEL = "Output"

    view: Literal["xy", "xz", "yz", "all"] | None = option(
        "Axes of the figure, or all three. [default: xy, or across the axis that is thin]",
        kept=False,
    )
    slice: tuple[str, float | None] | None = option(
        "Draw one plane of voxels: x=12 is the nearest to 12 mm, x that of the strongest voxel.",
        metavar="AXIS[=MM]",
        needs="--png",
        without="--view",
        parse=parse.plane,
        kept=False,
    )


@dataclass(frozen=True, kw_only=True)
class CleaningOptions:
    """What `calibration.clean` does with a capture: empty room, window of range, channels."""

    empty: Path | None = option("The same without the object: subtracted.", metavar="EMPTY")
    scaling: Literal["none", "common", "channel"] = option(
        "Complex factors that EMPTY is multiplied by, for drift: one for all, or per channel.",
        "none",
        needs="--empty",
    )
    gate_mm: tuple[float, float] | None = option(
        "Keep only echoes from this window of half path lengths.",
        metavar="NEAR:FAR",
        parse=parse.window_mm,
    )
    edge_mm: float | None = option(
        "Width of the window's edges, outside it. [default: 60 for 10 GHz]", needs="--gate-mm"
    )
    clutter_db: float | None = option(
        "How much stronger echoes are outside the window. [default: 40]", needs="--gate-mm"
    )
    channels: Path | None = option(
        "Correct by this file of `clradar channels` (HDF5).", metavar="CHANNELS"
    )
    keep_noisy: bool = option("Do not set noisy channels to zero.", False, needs="--channels")

    def cleaned(self, capture: cl.Capture, empty: cl.Capture | None) -> cl.Capture:
        known = arguments_of(self, CleaningOptions)
        gate: dict[str, Any] = {n: known[n] for n in ("edge_m", "clutter_db") if n in known}
        if self.gate_mm is not None:
            gate |= dict(zip(("near_m", "far_m"), known["gate_m"], strict=True))
        return calibration.clean(
            capture, empty=empty, scaling=self.scaling, gate=gate or None,
            channels=None if self.channels is None else measurement_io.open_channels(self.channels),
            mask=("dead",) if self.keep_noisy else ("dead", "noisy"),
        )  # fmt: skip


def open_frame(path: Path, frames: FrameOptions) -> cl.Capture:
    return noted(path, measurement_io.open_capture(path, **arguments_of(frames)))


def noted(path: Path, found: cl.Capture) -> cl.Capture:
    """What was opened of an input: if that is a folder, the file of the frame is what was read."""
    if path.is_dir():
        call.read.setdefault(path, []).extend(frame_files(found))
    return found


def frame_files(capture: cl.Capture) -> list[Path]:
    source = capture.meta.get("source")
    return [Path(source)] if isinstance(source, str) and Path(source).is_file() else []
