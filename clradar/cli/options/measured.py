"""Options of a measurement: radar, frame of a recording, cleaning, image formation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import clradar as cl
from clradar.cli.options.groups import given, option, recorded, wrong_usage
from clradar.cli.parse import RANGE_RULE, check_unit, numbers, whole_steps
from clradar.constants import DYNAMIC_RANGE_DB, FINEST_SPACING_M, PLAUSIBLE_HZ, PLAUSIBLE_RANGE_M
from clradar.model import VoxelGrid, checks

START_GHZ, STOP_GHZ, STEPS = 72.0, 82.0, 128

ARRAY_HELP = "Antennas: a .toml file (docs/arrays.md), or qar50, the 94 x 94 imager."


@dataclass(frozen=True, kw_only=True)
class BandOptions:
    """The frequencies of a stepped-frequency sweep."""

    PANEL = "Input"

    band: str | None = option(
        f"First and last frequency, GHz, and their number. "
        f"[default: {START_GHZ:g}:{STOP_GHZ:g}:{STEPS}]",
        metavar="FIRST:LAST:STEPS",
    )

    @property
    def band_ghz(self) -> tuple[float, float, int]:
        """First and last frequency in gigahertz, and their number."""
        if self.band is None:
            return START_GHZ, STOP_GHZ, STEPS
        values = numbers(self.band, ":")
        if len(values) != 3 or values[2] % 1 or values[2] < 1:
            raise wrong_usage("--band", f"expected FIRST:LAST:STEPS, got '{self.band}'")
        first, last, steps = values[0], values[1], int(values[2])
        for value in (first, last):
            check_unit("--band", "a frequency", value, PLAUSIBLE_HZ, "GHz")
        if first >= last if steps > 1 else first != last:
            expected = "FIRST below LAST, or both equal for one step"
            raise wrong_usage("--band", f"expected {expected}, got '{self.band}'")
        return first, last, steps

    def waveform(self) -> cl.Waveform:
        """The frequencies, those of the paper without the option."""
        start_ghz, stop_ghz, steps = self.band_ghz
        return cl.Waveform.sfcw(start_ghz * 1e9, stop_ghz * 1e9, steps)


@dataclass(frozen=True, kw_only=True)
class RadarOptions(BandOptions):
    """The antennas and the frequencies."""

    array: str | None = option(f"{ARRAY_HELP} [default: qar50]", metavar="ARRAY")

    @property
    def files(self) -> list[Path]:
        """The file of the array, if there is one."""
        from clradar.arrays.instruments import KNOWN

        return [] if self.array is None or self.array in KNOWN else [Path(self.array)]

    def antennas(self) -> cl.AntennaArray:
        """The array, the imager's without the option."""
        from clradar import arrays
        from clradar.arrays.instruments import KNOWN

        return arrays.read_array(str(self.array)) if self.files else KNOWN[self.array or "qar50"]()

    def clusters(self) -> tuple[cl.AntennaArray, ...]:
        """The arrays of a file of clusters, each of which has a capture of its own; else one."""
        from clradar import arrays

        return arrays.read_clusters(str(self.array)) if self.files else (self.antennas(),)


Variant = Literal["raw", "emptyfiltered"]


def recording_files(path: Path, capture_meta: Mapping[str, Any]) -> list[Path]:
    """The files whose content a capture comes from: the frame's, if `path` is a folder."""
    if not path.is_dir():
        return [path]
    source = capture_meta.get("source")
    frame = Path(source) if isinstance(source, str) else None
    return [frame] if frame is not None and frame.is_file() else []


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """Which frame of a recording; as `measurement_io.open_capture` takes it."""

    PANEL = "Input"

    frame: int | None = option("Frame of a recording. [default: 0]", metavar="N")
    variant: Variant | None = option("Variant of a recording's frame. [default: raw]")

    def open(self, path: Path) -> tuple[cl.Capture, list[Path]]:
        """The capture of a file or folder, and the files whose content it is."""
        from measurement_io import open_capture

        capture = open_capture(path, **recorded(self))
        return capture, recording_files(path, capture.meta)


PAPER_GRID_MM = ("-100:100:1", "-100:100:1", "260:340:1")
"""The grid of the paper's experiment: 201 x 201 x 81 voxels of 1 mm."""

GRID_RULE = f"{RANGE_RULE}, or one number for a single slice"


@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """The voxel grid, in millimetres; without any of the three one that shows the object."""

    PANEL = "Grid"

    x_mm: str | None = option(f"{GRID_RULE}. [default: around the echoes]", metavar="RANGE")
    y_mm: str | None = option("The same along y.", metavar="RANGE")
    z_mm: str | None = option("The same along z.", metavar="RANGE")

    @property
    def given(self) -> bool:
        """Whether there is an axis of the options."""
        return (self.x_mm, self.y_mm, self.z_mm) != (None, None, None)

    def grid(self, defaults_mm: tuple[str, str, str] = PAPER_GRID_MM) -> VoxelGrid:
        """The grid, with default ranges for the axes that were not given."""
        named = zip("xyz", (self.x_mm, self.y_mm, self.z_mm), defaults_mm, strict=True)
        axes = [axis_mm(f"--{a}-mm", text or default) for a, text, default in named]
        x_m, y_m, z_m = ((first / 1e3, last / 1e3) for first, last, _ in axes)
        return VoxelGrid.from_extent(x_m, y_m, z_m, [step / 1e3 for _, _, step in axes])


@dataclass(frozen=True, kw_only=True)
class ImagingOptions:
    """How an image is formed."""

    method: Literal["fast", "range", "exact"] = option(
        "fast: over a tree of blocks, error -50 dB; range: from range profiles, -54 dB; exact: the "
        "plain sum.",
        "fast",
    )
    window: Literal["rect", "hann", "taylor"] = option("Weights over frequency.", "rect")

    @property
    def fitted(self) -> bool:
        """Whether it is formed by iteration: by `clradar.reconstruct`."""
        return self.method in ("least-squares", "sparse")

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`."""
        return {"method": self.method, "window": self.window}


@dataclass(frozen=True, kw_only=True)
class ModelImagingOptions(ImagingOptions):
    """How an image is formed, also by iteration."""

    # A wider choice than that of the other commands.
    method: Literal["fast", "range", "exact", "least-squares", "sparse"] = option(  # type: ignore[assignment]
        "fast: over a tree of blocks, error -50 dB; range: from range profiles, -54 dB; exact: the "
        "plain sum. By iteration (needs pylops): least-squares, or sparse, of few voxels.",
        "fast",
    )
    iterations: int | None = option(
        "At most, of an image by iteration. [default: 30, sparse 100]", metavar="N", min=1
    )
    damping_db: float | None = option("Of least-squares: weight of the power. [default: none]")
    sparsity_db: float | None = option("Of sparse: threshold below the maximum. [default: -30]")

    def __post_init__(self) -> None:
        fits = {
            "--window": not self.fitted,
            "--iterations": self.fitted,
            "--damping-db": self.method == "least-squares",
            "--sparsity-db": self.method == "sparse",
        }
        for name in given(self):
            if not fits.get(name, True):
                raise wrong_usage(name, f"not an option of --method {self.method}")

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`, or of `clradar.reconstruct`."""
        if not self.fitted:
            return super().arguments
        names = ("method", "iterations", "damping_db", "sparsity_db")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, kw_only=True)
class DepthMapOptions:
    """How a depth map is made of a volume."""

    dynamic_range_db: float = option("Cut this far below an image's maximum.", DYNAMIC_RANGE_DB)

    def __post_init__(self) -> None:
        checks.dynamic_range("--dynamic-range-db", self.dynamic_range_db)


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    """What is drawn of a volume."""

    PANEL = "Output"

    view: Literal["xy", "xz", "yz", "all"] | None = option(
        "Axes of the figure, or all three. [default: xy, or across the axis that is thin]"
    )
    slice: str | None = option(
        "Draw one plane of voxels: x=12 is the nearest to 12 mm, x that of the strongest voxel.",
        metavar="AXIS[=MM]",
        needs="--png",
    )

    def __post_init__(self) -> None:
        _ = self.plane  # raises where the text is none

    @property
    def plane(self) -> tuple[str, float | None] | None:
        """Axis of a slice, and its place, metres; None: through the strongest voxel."""
        if self.slice is None:
            return None
        axis, equals, place = self.slice.partition("=")
        values = numbers(place, ":") if equals else []
        if axis not in ("x", "y", "z") or len(values) != bool(equals):
            words = f"expected x, y or z, or one with =MM; got '{self.slice}'"
            raise wrong_usage("--slice", words)
        return axis, values[0] / 1e3 if equals else None


def axis_mm(option: str, text: str) -> tuple[float, float, float]:
    """First, last and step of ``FIRST:LAST:STEP`` in millimetres; one number is one voxel."""
    values = numbers(text, ":")
    if len(values) not in (1, 3):
        raise wrong_usage(option, f"expected {GRID_RULE}, in millimetres; got '{text}'")
    farthest = max(map(abs, values[:2]))
    check_unit(option, "coordinates", farthest, (0.0, PLAUSIBLE_RANGE_M[1]), "mm")
    if len(values) == 1:
        return values[0], values[0], 1.0
    first, last, step = values
    if step <= 0 or last < first:
        raise wrong_usage(option, f"expected FIRST <= LAST and STEP > 0, got '{text}'")
    if last > first:
        check_unit(option, "a step", step, (FINEST_SPACING_M, PLAUSIBLE_RANGE_M[1]), "mm")
    whole_steps(option, text, first, last, step)
    return first, last, step


def grid_text(grid: VoxelGrid) -> str:
    """Voxels and ends of a grid."""
    from clradar.imaging.grid_words import box_words

    counts = " x ".join(str(n) for n in grid.counts)
    return f"{counts} voxels ({box_words(grid)})"


@dataclass(frozen=True, kw_only=True)
class CleaningOptions:
    """What `calibration.clean` does with a capture: empty room, window of range, channels."""

    empty: Path | None = option("The same without the object: subtracted.", metavar="EMPTY")
    scaling: Literal["none", "common", "channel"] = option(
        "Complex factors that EMPTY is multiplied by, for drift: one for all, or per channel.",
        "none",
        needs="--empty",
    )
    gate_mm: str | None = option(
        "Keep only echoes from this window of half path lengths.", metavar="NEAR:FAR"
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

    @property
    def gate(self) -> dict[str, Any] | None:
        """Settings of `calibration.range_gate`; None without a window."""
        if self.gate_mm is None:
            return None
        ends_m = [value / 1e3 for value in numbers(self.gate_mm, ":")]
        if len(ends_m) != 2 or not 0 <= ends_m[0] < ends_m[1]:
            rule = "NEAR:FAR, half path lengths in millimetres, 0 <= NEAR < FAR"
            raise wrong_usage("--gate-mm", f"expected {rule}; got '{self.gate_mm}'")
        edge_m = None if self.edge_mm is None else self.edge_mm / 1e3
        more = {"edge_m": edge_m, "clutter_db": self.clutter_db}
        given = {name: value for name, value in more.items() if value is not None}
        return {"near_m": ends_m[0], "far_m": ends_m[1], **given}

    def cleaned(self, capture: cl.Capture, empty: cl.Capture | None) -> cl.Capture:
        """The capture without the empty room, gated and corrected."""
        from calibration import clean
        from measurement_io import open_channels

        return clean(
            capture, empty=empty, scaling=self.scaling, gate=self.gate,
            channels=None if self.channels is None else open_channels(self.channels),
            mask=("dead",) if self.keep_noisy else ("dead", "noisy"),
        )  # fmt: skip
