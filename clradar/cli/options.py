"""Options that several subcommands share, and how their values are read."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Optional

import numpy as np
import typer

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.model import VoxelGrid

X_MM, Y_MM, Z_MM = "-100:100:1", "-100:100:1", "260:340:1"
"""The grid of the paper's experiment: 201 x 201 x 81 voxels of 1 mm."""

GRID_RULE = "FIRST:LAST:STEP, both ends included, or one number for a single slice"

WHOLE_STEPS = 1e-6
"""How far an axis may be from a whole number of steps: room for the rounding of decimals."""


class Method(str, Enum):
    """How the image is formed."""

    fast = "fast"
    range = "range"
    exact = "exact"


class Window(str, Enum):
    """Weights over frequency."""

    rect = "rect"
    hann = "hann"
    taylor = "taylor"


class Unit(str, Enum):
    """Unit of a mesh file."""

    m = "m"
    mm = "mm"
    cm = "cm"


class Variant(str, Enum):
    """Which variant of a recorded frame."""

    raw = "raw"
    emptyfiltered = "emptyfiltered"


# Optional and not "| None": typer reads these when Python 3.10 runs, too.
DeviceOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--device",
        metavar="NAME",
        help="OpenCL device: its selector or part of its name (see `clradar devices`). "
        "[default: CLRADAR_DEVICE, else PYOPENCL_CTX, else a GPU, else a CPU]",
    ),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace files that exist.")]
XOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--x-mm", metavar="RANGE", help=f"{GRID_RULE}. [default: {X_MM}]"),
]
YOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--y-mm", metavar="RANGE", help=f"The same along y. [default: {Y_MM}]"),
]
ZOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--z-mm", metavar="RANGE", help=f"The same along z. [default: {Z_MM}]"),
]
MethodOption = Annotated[
    Method,
    typer.Option(
        "--method",
        help="fast: over a tree of blocks, -50 dB of error; range: from range profiles, "
        "-54 dB; exact: the plain sum.",
    ),
]
ToleranceOption = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option(
        "--tolerance-db",
        metavar="DB",
        help="Error of fast, RMS over the image's RMS, -80 to -30. [default: -50]",
    ),
]
WindowOption = Annotated[Window, typer.Option("--window", help="Weights over frequency.")]
DynamicRangeOption = Annotated[
    float,
    typer.Option("--dynamic-range-db", metavar="DB", help="Cut this far below an image's maximum."),
]
SearchOption = Annotated[
    float,
    typer.Option("--search-deg", metavar="DEG", help="Rotations about boresight that are tried."),
]
FrameOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--frame", metavar="N", help="Frame of a recording. [default: 0]"),
]
VariantOption = Annotated[
    Optional[Variant],  # noqa: UP045
    typer.Option("--variant", help="Variant of a recording's frame. [default: raw]"),
]

DEFAULT_DYNAMIC_RANGE_DB = DYNAMIC_RANGE_DB


def wrong_usage(option: str, text: str) -> typer.BadParameter:
    """Return the error that ends in exit status 2 and names the option."""
    return typer.BadParameter(text, param_hint=option)


def axis_mm(option: str, text: str) -> tuple[float, float, float]:
    """Return first, last and step of ``FIRST:LAST:STEP`` in millimetres.

    A single number is an axis of one voxel; its step is 1 mm.
    """
    parts = text.split(":")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 3) or not np.isfinite(numbers).all():
        raise wrong_usage(option, f"expected {GRID_RULE}, in millimetres; got '{text}'")
    if len(numbers) == 1:
        return numbers[0], numbers[0], 1.0
    first, last, step = numbers
    if step <= 0 or last < first:
        raise wrong_usage(option, f"expected FIRST <= LAST and STEP > 0, got '{text}'")
    steps = (last - first) / step
    if abs(steps - round(steps)) > WHOLE_STEPS * max(1.0, steps):
        fits = first + np.floor(steps) * step
        raise wrong_usage(
            option,
            f"expected a whole number of steps, such as {first:g}:{fits:g}:{step:g}, got '{text}'",
        )
    return first, last, step


def voxel_grid(x: str | None, y: str | None, z: str | None) -> VoxelGrid:
    """Return the grid that the options ask for; None stands for the default of its axis."""
    axes = [
        axis_mm(option, default if text is None else text)
        for option, text, default in (
            ("--x-mm", x, X_MM),
            ("--y-mm", y, Y_MM),
            ("--z-mm", z, Z_MM),
        )
    ]
    x_m, y_m, z_m = ((first / 1e3, last / 1e3) for first, last, _ in axes)
    return VoxelGrid.from_extent(x_m, y_m, z_m, [step / 1e3 for _, _, step in axes])


def grid_text(grid: VoxelGrid) -> str:
    """Return a grid in words, millimetres."""
    ends = [
        f"{name} {1e3 * axis[0]:g} to {1e3 * axis[-1]:g}"
        for name, axis in zip("xyz", (grid.x_m, grid.y_m, grid.z_m), strict=True)
    ]
    counts = " x ".join(str(n) for n in grid.counts)
    return f"{counts} voxels ({', '.join(ends)} mm)"
