"""The interface of engines, and the sequential engine in this process."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import make_sample
from clradar.dataset.store.folder import part_path
from clradar.dataset.store.shard_writer import write_sample
from clradar.errors import DeviceError, OutputError, handled_warnings
from clradar.jobs.outcome import ATTEMPTS, Aside, reason_of
from clradar.jobs.resources import made_with, own_device
from clradar.opencl import forget_devices, open_device


@dataclass(frozen=True, slots=True)
class Made:
    """A sample whose part is written, and the texts of its `ClradarWarning`s."""

    sample: int
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PartMaker:
    """A picklable function that makes one sample and writes its part.

    All processes that make parts need the data set's `folder` under this name. The device (see
    `clradar.open_device`) is opened where the part is made.
    """

    folder: Path
    plan: Plan
    device: str | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """The files beside the folder that samples need."""
        names = [name for rig in self.plan.hands.rigs for name in (rig.file, rig.mapping)]
        return tuple(str(self.plan.folder / name) for name in names if name is not None)

    def alone(self, sample: int) -> PartMaker:
        """The same: no sample brings anything of its own."""
        return self

    def __call__(self, sample: int) -> Made:
        """Make a sample, and write its part whole or not at all.

        Raises
        ------
        OutputError
            The part cannot be written, whatever the sample.
        DeviceError
            The next sample of this process opens the device again, since a context may stay
            unusable after a failed launch.
        """
        texts: list[str] = []
        try:
            device = own_device(self.device)
            with handled_warnings(texts.append):  # for the process that shows them
                made = make_sample(recipe(self.plan, sample), device, rigs=self.plan.folder)
        except DeviceError:
            forget_devices()
            raise
        target = part_path(self.folder, sample)
        output = self.plan.output
        write_sample(target, made, made_with(device), compression=output.compression, force=True)
        return Made(sample, tuple(texts))


Outcome = Made | Aside
"""What was made of a sample."""


class Engine(Protocol):
    """Makes the parts of samples, in any order.

    Attributes
    ----------
    device : str or None
        See `clradar.open_device`; None is the default of each process.
    """

    @property
    def device(self) -> str | None: ...

    def made_with(self) -> Mapping[str, Any]:
        """Return the versions and the device on which the samples' bits depend."""

    def outcomes(self, samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
        """Yield the outcome of each sample as soon as it is known.

        An `OutputError` of a part (a full disk) ends the run; others count for the sample.
        """

    def stop(self) -> None:
        """Make no more; nothing is written after this returns."""


class Serial:
    """Makes the samples sequentially in this process on a device; see `clradar.open_device`."""

    def __init__(self, device: str | None = None) -> None:
        self.device = device

    def made_with(self) -> Mapping[str, Any]:
        return made_with(open_device(self.device))

    def outcomes(self, samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
        for sample in samples:
            yield _tried(sample, make)

    def stop(self) -> None:
        pass


def _tried(sample: int, make: PartMaker) -> Outcome:
    for attempt in range(1, ATTEMPTS + 1):
        try:
            return make(sample)
        except OutputError:
            raise
        except Exception as error:
            if attempt == ATTEMPTS:
                return Aside(sample, reason_of(error), attempt)
    raise AssertionError("unreachable")


def is_device_fault(aside: Aside) -> bool:
    """Return whether a sample failed in the device."""
    return aside.reason.startswith(f"{DeviceError.__name__}: ")


def absolute(path: Path) -> Path:
    """Return an absolute path without following links, so that other machines may have it too."""
    return Path(os.path.abspath(path))
