"""Options and arguments of many subcommands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from clradar.cli.options.groups import option

Unit = Literal["m", "mm", "cm", "inch"]

Amplitude = Literal["unit", "spreading"]


CaptureArgument = Annotated[
    Path,
    typer.Argument(metavar="CAPTURE", help="Native capture, recorded .npy frame, or radar folder."),
]
MeasuredArgument = Annotated[
    Path, typer.Argument(metavar="MEASURED", help="Volume, capture or recording.")
]
CaptureOutput = Annotated[Path, typer.Option("-o", "--output", help="Capture to write (HDF5).")]
DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="NAME",
        help="OpenCL device: its selector or part of its name (see `clradar devices`). "
        "[default: CLRADAR_DEVICE, else PYOPENCL_CTX, else a GPU, else a CPU]",
    ),
]
DevicesOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="NAME",
        help="OpenCL device, or several to divide the work among: names with commas, or all (all "
        "GPUs). [default: as `clradar devices` shows]",
    ),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace files that exist.")]
OpenOption = Annotated[
    bool, typer.Option("--open", help="Open the picture or the page once it is written.")
]


@dataclass(frozen=True, kw_only=True)
class UnitOptions:
    """The unit of length of a mesh."""

    unit: Unit = option("m", "Unit of length of the mesh file.")


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """The search for the pose of a mesh."""

    search_deg: float = option(45.0, "Rotations about boresight that are tried.", metavar="DEG")
