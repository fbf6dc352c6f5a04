"""Options of a measurement: radar, frame of a recording, cleaning, image formation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import clradar as cl
from clradar.cli.options.groups import given, option, recorded, wrong_usage
from clradar.cli.parse import RANGE_RULE, check_unit, finite, numbers, whole_steps
from clradar.constants import DYNAMIC_RANGE_DB, FINEST_SPACING_M, PLAUSIBLE_HZ, PLAUSIBLE_RANGE_M
from clradar.model import VoxelGrid, checks

START_GHZ, STOP_GHZ, STEPS = 72.0, 82.0, 128

ARRAY_HELP = "Antennas: a .toml file (docs/arrays.md), or qar50, the 94 x 94 imager."


@dataclass(frozen=True, kw_only=True)
class BandOptions:
    """The frequencies of a stepped-frequency sweep."""

    band: str | None = option(
        None,
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
        if len(values) != 3 or not finite(values) or values[2] % 1:
            raise wrong_usage("--band", f"expected FIRST:LAST:STEPS, got '{self.band}'")
        for value in values[:2]:
            check_unit("--band", "a frequency", value, PLAUSIBLE_HZ, "GHz")
        first, last, steps = values[0], values[1], int(values[2])
        if steps < 1 or (first >= last if steps > 1 else first != last):
            expected = (
                "FIRST below LAST, or both equal for one step" if steps > 0 else "STEPS from 1"
            )
            raise wrong_usage("--band", f"expected {expected}, got '{self.band}'")
        return first, last, steps

    def waveform(self) -> cl.Waveform:
        """The frequencies, those of the paper without the option."""
        start_ghz, stop_ghz, steps = self.band_ghz
        return cl.Waveform.sfcw(start_ghz * 1e9, stop_ghz * 1e9, steps)


@dataclass(frozen=True, kw_only=True)
class RadarOptions(BandOptions):
    """The antennas and the frequencies."""

    array: str | None = option(None, f"{ARRAY_HELP} [default: qar50]", metavar="ARRAY")

    @property
    def files(self) -> list[Path]:
        """The file of the array, if there is one."""
        from clradar.arrays.instruments import KNOWN

        return [] if self.array is None or self.array in KNOWN else [Path(self.array)]

    def antennas(self) -> cl.AntennaArray:
        """The array, the imager's without the option."""
        from clradar import arrays
        from clradar.arrays.instruments import KNOWN

        name = "qar50" if self.array is None else self.array
        return KNOWN[name]() if name in KNOWN else arrays.read_array(name)

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
    """Which frame of a recording."""

    frame: int | None = option(None, "Frame of a recording. [default: 0]", metavar="N")
    variant: Variant | None = option(None, "Variant of a recording's frame. [default: raw]")

    @property
    def chosen(self) -> dict[str, Any]:
        """`frame` and `variant` as `measurement_io.open_capture` takes them."""
        return recorded(self)

    def open(self, path: Path) -> tuple[cl.Capture, list[Path]]:
        """The capture of a file or folder, and the files whose content it is."""
        from measurement_io import open_capture

        capture = open_capture(path, **self.chosen)
        return capture, recording_files(path, capture.meta)


@dataclass(frozen=True, kw_only=True)
class AntennaOptions:
    """Files with the positions of antennas."""

    rx_file: Path | None = option(None, "Positions of the Rx antennas of a recorded frame.")
    tx_file: Path | None = option(None, "Positions of the Tx antennas of a recorded frame.")

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [path for path in (self.rx_file, self.tx_file) if path is not None]

    @property
    def chosen(self) -> dict[str, Any]:
        """`rx_file` and `tx_file` as `measurement_io.open_recording` takes them."""
        return {"rx_file": self.rx_file, "tx_file": self.tx_file}


PAPER_GRID_MM = ("-100:100:1", "-100:100:1", "260:340:1")
"""The grid of the paper's experiment: 201 x 201 x 81 voxels of 1 mm."""

MODEL_METHODS = ("least-squares", "sparse")
"""Those of `clradar.reconstruct`."""

GRID_RULE = f"{RANGE_RULE}, or one number for a single slice"


def axis_option(axis: str, default: str) -> Any:
    """The option of an axis; `default` says what holds without it."""
    rule = GRID_RULE if axis == "x" else f"The same along {axis}"
    return option(None, f"{rule}. [default: {default}]", metavar="RANGE")


@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """The voxel grid, in millimetres; without any of the three one that shows the object."""

    x_mm: str | None = axis_option("x", PAPER_GRID_MM[0])
    y_mm: str | None = axis_option("y", PAPER_GRID_MM[1])
    z_mm: str | None = axis_option("z", PAPER_GRID_MM[2])

    @property
    def given(self) -> bool:
        """Whether there is an axis of the options."""
        return (self.x_mm, self.y_mm, self.z_mm) != (None, None, None)

    def grid(self, defaults_mm: tuple[str, str, str] = PAPER_GRID_MM) -> VoxelGrid:
        """The grid, with default ranges for the axes that were not given."""
        texts = (self.x_mm, self.y_mm, self.z_mm)
        axes = [
            axis_mm(option, default if text is None else text)
            for option, text, default in zip(
                ("--x-mm", "--y-mm", "--z-mm"), texts, defaults_mm, strict=True
            )
        ]
        x_m, y_m, z_m = ((first / 1e3, last / 1e3) for first, last, _ in axes)
        return VoxelGrid.from_extent(x_m, y_m, z_m, [step / 1e3 for _, _, step in axes])


@dataclass(frozen=True, kw_only=True)
class ImagingOptions:
    """How an image is formed."""

    method: Literal["fast", "range", "exact"] = option(
        "fast",
        "fast: over a tree of blocks, -50 dB of error; range: from range profiles, "
        "-54 dB; exact: the plain sum.",
    )
    window: Literal["rect", "hann", "taylor"] = option("rect", "Weights over frequency.")

    @property
    def fitted(self) -> bool:
        """Whether it is formed by iteration: by `clradar.reconstruct`."""
        return self.method in MODEL_METHODS

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`."""
        return {"method": self.method, "window": self.window}


@dataclass(frozen=True, kw_only=True)
class ModelImagingOptions(ImagingOptions):
    """How an image is formed, also by iteration."""

    # A wider choice than that of the other commands.
    method: Literal["fast", "range", "exact", "least-squares", "sparse"] = option(  # type: ignore[assignment]
        "fast",
        "fast: back-projection over a tree of blocks, -50 dB of error; range: from range profiles, "
        "-54 dB; exact: the plain sum. By iteration (needs pylops): least-squares: reflectivity "
        "that explains the samples; sparse: that of few voxels.",
    )
    iterations: int | None = option(
        None, "At most, of an image by iteration. [default: 30, sparse 100]", min=1
    )
    damping_db: float | None = option(
        None, "Of least-squares: weight of the reflectivity's power. [default: none]", metavar="DB"
    )
    sparsity_db: float | None = option(
        None, "Of sparse: threshold below the maximum. [default: -30]", metavar="DB"
    )

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

    dynamic_range_db: float = option(
        DYNAMIC_RANGE_DB, "Cut this far below an image's maximum.", metavar="DB"
    )

    def __post_init__(self) -> None:
        checks.dynamic_range("--dynamic-range-db", self.dynamic_range_db)


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    """What is drawn of a volume."""

    view: Literal["xy", "xz", "yz", "all"] | None = option(
        None, "Axes of the figure, or all three. [default: xy, or across the axis that is thin]"
    )
    slice: str | None = option(
        None,
        "Draw one plane of voxels: x=12 is the nearest to 12 mm, x the one through the strongest "
        "voxel.",
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
        wrong = bool(equals) and (len(values) != 1 or not finite(values))
        if axis not in ("x", "y", "z") or wrong:
            words = f"expected x, y or z, or one with =MM; got '{self.slice}'"
            raise wrong_usage("--slice", words)
        return axis, values[0] / 1e3 if equals else None


def axis_mm(option: str, text: str) -> tuple[float, float, float]:
    """First, last and step of ``FIRST:LAST:STEP`` in millimetres.

    A single number is an axis of one voxel; its step is 1 mm.
    """
    values = numbers(text, ":")
    if len(values) not in (1, 3) or not finite(values):
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
    """Voxels and ends of a grid in words."""
    from clradar.imaging.grid_words import box_words

    counts = " x ".join(str(n) for n in grid.counts)
    return f"{counts} voxels ({box_words(grid)})"


GATE_RULE = "NEAR:FAR, half path lengths"


@dataclass(frozen=True, kw_only=True)
class EmptyOptions:
    """The capture of the empty room."""

    empty: Path | None = option(None, "The same without the object: subtracted.", metavar="EMPTY")
    scaling: Literal["none", "common", "channel"] = option(
        "none",
        "Multiply EMPTY by complex factors first, for drift: one for all, or one per channel.",
        needs="--empty",
    )


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """A window of range."""

    gate_mm: str | None = option(
        None, f"Keep only echoes from this window: {GATE_RULE}.", metavar="NEAR:FAR"
    )
    edge_mm: float | None = option(
        None,
        "Width of the window's edges, outside it. [default: 4 c / 2B, 60 for 10 GHz]",
        metavar="MM",
        needs="--gate-mm",
    )
    clutter_db: float | None = option(
        None,
        "How much stronger echoes outside the window are than inside. [default: 40]",
        metavar="DB",
        needs="--gate-mm",
    )

    def settings(self) -> dict[str, Any] | None:
        """Settings of `calibration.range_gate`; None without a window."""
        if self.gate_mm is None:
            return None
        ends_m = [value / 1e3 for value in numbers(self.gate_mm, ":")]
        if len(ends_m) != 2 or not finite(ends_m) or not 0 <= ends_m[0] < ends_m[1]:
            raise wrong_usage(
                "--gate-mm",
                f"expected {GATE_RULE} in millimetres, 0 <= NEAR < FAR; got '{self.gate_mm}'",
            )
        found = {"near_m": ends_m[0], "far_m": ends_m[1]}
        if self.edge_mm is not None:
            found["edge_m"] = self.edge_mm / 1e3
        if self.clutter_db is not None:
            found["clutter_db"] = self.clutter_db
        return found


@dataclass(frozen=True, kw_only=True)
class ChannelOptions:
    """The responses of the channels."""

    channels: Path | None = option(
        None, "Correct by this file of `clradar channels` (HDF5).", metavar="CHANNELS"
    )
    keep_noisy: bool = option(False, "Do not set noisy channels to zero.", needs="--channels")

    @property
    def files(self) -> list[Path]:
        """The file that was given."""
        return [] if self.channels is None else [self.channels]

    @property
    def mask(self) -> tuple[str, ...]:
        """Which channels are set to zero."""
        return ("dead",) if self.keep_noisy else ("dead", "noisy")

    def read(self) -> cl.ChannelCalibration | None:
        """The channels of the file."""
        from measurement_io import open_channels

        return None if self.channels is None else open_channels(self.channels)
