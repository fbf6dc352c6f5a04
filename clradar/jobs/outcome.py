"""What becomes of an item, and what its bits depend on."""

from __future__ import annotations

import platform
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from clradar.errors import ClradarError, ClradarWarning
from clradar.files.failures import clean
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.versions import own_version, package_versions

ATTEMPTS = 2  # attempts at an item before it is set aside

Result = TypeVar("Result")

Work = Callable[[Any, Device, Progress], Result]
"""Works on an item on a device; says by the last argument how far it is."""

Outcome = tuple[Any, list[str]]
"""What a function returned, or its `ClradarError`; and its warnings, each once."""


def reason_of(error: BaseException) -> str:
    return clean(f"{type(error).__name__}: {error}")


def outcome_of(function: Callable[..., Any], *arguments: Any) -> Outcome:
    """Call a function; an error keeps its type on its way back."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClradarWarning)
        try:
            result = function(*arguments)
        except ClradarError as error:
            result = error
    ours = (str(one.message) for one in caught if issubclass(one.category, ClradarWarning))
    return result, list(dict.fromkeys(ours))


def silent(done: int, total: int) -> None:
    """Progress that nobody sees."""


def made_with(device: Device) -> dict[str, Any]:
    """The versions and the device on which the bits of a result depend."""
    return {
        "clradar": own_version(),
        "packages": dict(_packages()),
        "python": platform.python_version(),
        "device": dict(device.describe()),
    }


_packages = cache(package_versions)  # which reads files, for every item
