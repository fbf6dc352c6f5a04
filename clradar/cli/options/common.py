"""Options and arguments of many subcommands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clradar.cli.options.groups import REQUIRED, argument, option

if TYPE_CHECKING:
    from clradar.jobs import Where

own_option = partial(option, needs="--fit-hand", without="--rig")
"""Of the embedded hand: a rig is one hand, whose mesh, size and side are what they are."""

rig_option = partial(option, needs="--rig")

Unit = Literal["m", "mm", "cm", "inch"]

Amplitude = Literal["unit", "spreading"]

CAPTURE: Any = argument(
    REQUIRED, "Native capture, recorded .npy frame, or radar folder.", metavar="CAPTURE"
)
MEASURED: Any = argument(REQUIRED, "Volume, capture or recording.", metavar="MEASURED")
DEVICE: Any = option(
    None,
    "OpenCL device: its selector or part of its name (see `clradar devices`). "
    "[default: CLRADAR_DEVICE, else PYOPENCL_CTX, else a GPU, else a CPU]",
    metavar="NAME",
    names=("--device",),
)
DEVICES: Any = option(
    None,
    "OpenCL device, or several to divide the work among: names with commas, or all (all GPUs). "
    "[default: as `clradar devices` shows]",
    metavar="NAME",
    names=("--device",),
)
FORCE: Any = option(False, "Replace files that exist.", names=("--force",))
JSON: Any = option(False, "Print JSON for programs, in metres and hertz.", names=("--json",))


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
        without="--workers",
    )

    def where(self, device: str | None, files: Sequence[Path] = ()) -> Where:
        """Where the work is done; workers of a scheduler have to see the files."""
        from clradar.jobs import Where

        return Where(device, self.workers, self.scheduler, tuple(files))
