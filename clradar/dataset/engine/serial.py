"""What makes the samples of a data set, and the engine that needs one process only."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from clradar import __version__
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.sample import make_sample
from clradar.dataset.store.folder import Aside, part_path
from clradar.dataset.store.shard_writer import write_sample
from clradar.errors import DeviceError, OutputError
from clradar.files.failures import clean
from clradar.opencl import Device, forget_devices, open_device
from clradar.versions import package_versions

ATTEMPTS = 2
"""How often a sample is tried before it is set aside."""


@dataclass(frozen=True, slots=True)
class PartMaker:
    """Makes one sample and writes its part. Can be sent to another process.

    Attributes
    ----------
    folder : Path
        Of the data set; every process that makes parts has to see it under this name.
    plan : Plan
    device : str or None
        See `clradar.open_device`; opened where the part is made.
    """

    folder: Path
    plan: Plan
    device: str | None = None

    def __call__(self, sample: int) -> int:
        """Make sample `sample`, write its part whole or not at all, return its number.

        Raises
        ------
        OutputError
            The part cannot be written, which is no fault of the sample.
        DeviceError
            The next sample of this process opens the device anew, since a failed launch can leave
            a context that fails for ever.
        """
        try:
            device = open_device(self.device)
            made = make_sample(recipe(self.plan, sample), device, rigs=self.plan.folder)
        except DeviceError:
            forget_devices()
            raise
        target = part_path(self.folder, sample)
        output = self.plan.output
        write_sample(target, made, made_with(device), compression=output.compression, force=True)
        return sample


Outcome = int | Aside
"""A sample that is made, or why it is not."""


class Engine(Protocol):
    """Makes the parts of samples, in any order.

    Attributes
    ----------
    device : str or None
        See `clradar.open_device`; None is what each process takes by itself.
    """

    @property
    def device(self) -> str | None: ...

    def made_with(self) -> Mapping[str, Any]:
        """Return the versions and the device that the samples' bits will depend on."""

    def outcomes(self, samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
        """Yield what became of each sample as soon as it is known.

        An `OutputError` of a part (a full disk) ends the run; any other error is the sample's.
        """

    def stop(self) -> None:
        """Make no more; nothing is written any longer when this returns."""


class Serial:
    """Makes one sample after the other in this process.

    Parameters
    ----------
    device : str or None
        See `clradar.open_device`.
    """

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


def reason_of(error: Exception) -> str:
    """Return on one line why a sample could not be made."""
    return clean(f"{type(error).__name__}: {error}")


def is_device_fault(aside: Aside) -> bool:
    """Return whether the device refused, and not the sample."""
    return aside.reason.startswith(f"{DeviceError.__name__}: ")


def made_with(device: Device) -> dict[str, Any]:
    """Return the versions and the device that a sample's bits depend on."""
    return {
        "clradar": __version__,
        "packages": package_versions(),
        "python": platform.python_version(),
        "device": dict(device.describe()),
    }


def absolute(path: Path) -> Path:
    """Return a name that other machines may know too: no links are followed in it."""
    return Path(os.path.abspath(path))
