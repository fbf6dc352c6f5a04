"""Options and arguments of many subcommands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from clradar.cli.options.groups import option
from clradar.cli.parse import wrong_usage

if TYPE_CHECKING:
    from clradar.jobs import Where

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


@dataclass(frozen=True, kw_only=True)
class UnitOptions:
    """The unit of length of a mesh."""

    unit: Unit = option("m", "Unit of length of the mesh file.")


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """The search for the pose of a mesh."""

    search_deg: float = option(45.0, "Rotations about boresight that are tried.", metavar="DEG")


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """The processes that the work is divided among."""

    workers: int | None = option(
        None,
        'Worker processes (pip install "clradar[dataset]"), each with a GPU or a share of the '
        "cores. [default: one for each of several devices, else this one]",
        metavar="N",
        min=1,
    )
    scheduler: str | None = option(
        None,
        "The workers of a Dask scheduler, tcp://HOST:PORT, that see the same files; see "
        "docs/datasets-cluster.md.",
        metavar="ADDRESS",
    )

    def __post_init__(self) -> None:
        if self.workers is not None and self.scheduler is not None:
            raise wrong_usage("--scheduler", "expected no --workers with it: it has its own")

    def where(self, device: str | None, files: Sequence[Path] = ()) -> Where:
        """Where the work is done; workers of a scheduler have to see the files."""
        from clradar.jobs import Where

        return Where(device, self.workers, self.scheduler, tuple(files))
