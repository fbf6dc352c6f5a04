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

CAPTURE: Any = argument(
    "Native capture, recorded .npy frame, or radar folder.", REQUIRED, metavar="CAPTURE"
)
MEASURED: Any = argument("Volume, capture or recording.", REQUIRED, metavar="MEASURED")
DEVICE: Any = option(
    "OpenCL device: selector or part of its name, or several to divide the work among: with "
    "commas, or all (all GPUs). [default: as `clradar devices` shows]",
    metavar="NAME",
    names=("--device",),
    panel="Expert",
)
FORCE: Any = option("Replace files that exist.", False, names=("--force",), panel="Output")
JSON: Any = option("Print JSON, in metres and hertz.", False, names=("--json",), panel="Output")


@dataclass(frozen=True, kw_only=True)
class UnitOptions:
    """The unit of length of a mesh."""

    unit: Unit = option("Unit of length of the mesh file.", "m")


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """The search for the pose of a mesh."""

    search_deg: float = option("Rotations about boresight that are tried.", 45.0, panel="Expert")


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """The processes that the work is divided among."""

    PANEL = "Expert"

    workers: int | None = option(
        "Worker processes (pip install 'dask[distributed]'), each with a GPU or a share of the "
        "cores. [default: one for each of several devices, else this one]",
        metavar="N",
        min=1,
    )
    scheduler: str | None = option(
        "Address of a Dask scheduler, whose workers see the same files.",
        metavar="tcp://HOST:PORT",
        without="--workers",
    )

    def where(self, device: str | None, files: Sequence[Path] = ()) -> Where:
        """Where the work is done; workers of a scheduler have to see the files."""
        from clradar.jobs import Where

        return Where(device, self.workers, self.scheduler, tuple(files))
