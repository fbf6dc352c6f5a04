"""Options of image formation: the voxel grid, the method, the weights over frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from clradar.cli.options.groups import given, option
from clradar.cli.options.values import (
    RANGE_RULE,
    check_unit,
    finite,
    numbers,
    whole_steps,
    wrong_usage,
)
from clradar.constants import DYNAMIC_RANGE_DB, FINEST_SPACING_M, PLAUSIBLE_RANGE_M
from clradar.model import VoxelGrid, checks

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
        fitted = self.method in MODEL_METHODS
        fits = {
            "--window": not fitted,
            "--iterations": fitted,
            "--damping-db": self.method == "least-squares",
            "--sparsity-db": self.method == "sparse",
        }
        for name in given(self):
            if not fits.get(name, True):
                raise wrong_usage(name, f"not an option of --method {self.method}")

    @property
    def arguments(self) -> dict[str, Any]:
        """Of `clradar.backproject`, or of `clradar.reconstruct`."""
        if self.method not in MODEL_METHODS:
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


ViewName = Literal["xy", "xz", "yz", "all"]
VIEW_HELP = "Axes of the figure, or all three. [default: xy, or across the axis that is thin]"
SLICE_HELP = (
    "Draw one plane of voxels: x=12 is the nearest to 12 mm, x the one through the strongest voxel."
)


def plane(text: str) -> tuple[str, float | None]:
    """Axis of a slice ``AXIS`` or ``AXIS=MM``, and its place, metres; None: the strongest voxel."""
    axis, equals, place = text.partition("=")
    values = numbers(place, ":") if equals else []
    wrong = bool(equals) and (len(values) != 1 or not finite(values))
    if axis not in ("x", "y", "z") or wrong:
        raise wrong_usage("--slice", f"expected x, y or z, or one with =MM; got '{text}'")
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
