"""Exception classes, one base, each subclass also a builtin; and the one class of warnings."""

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_OWN_PACKAGES = frozenset({"clradar", "calibration", "measurement_io"})

MAX_QUOTED_CHARACTERS = 200
"""Of a value, a key or a name that a message quotes; a file can hold one of any length."""


def quoted(text: object, most: int = MAX_QUOTED_CHARACTERS) -> str:
    """Return `text` on one printable line of at most `most` characters; "..." marks a cut."""
    line = " ".join(str(text).split())[: most + 1]
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
    return line if len(line) <= most else line[:most] + "..."


class ClradarError(Exception):
    """Base of all errors raised on purpose; `mistakes` are the lines of a file with several."""

    mistakes: tuple[str, ...] = ()


class ModelError(ClradarError, ValueError):
    """A field or an argument has an invalid value."""


class MeshError(ClradarError, ValueError):
    """A mesh file or a mesh cannot be used as a scene."""


class RigError(ClradarError, ValueError):
    """A file of a rigged hand is damaged, or holds no hand that a pose can move."""


class DeviceError(ClradarError, RuntimeError):
    """OpenCL: no such device, a kernel that does not build, no memory, a failed launch."""


class MeasurementError(ClradarError, ValueError):
    """A recorded or native file is missing, damaged, hostile, or of another format than stated."""


class CompareError(ClradarError, ValueError):
    """Two images cannot be compared or aligned."""


class CalibrationError(ClradarError, ValueError):
    """A capture does not show the known target, or a calibration is of another instrument."""


class OutputError(ClradarError, OSError):
    """An output cannot be written: it exists already, or its folder does not."""


class ClusterError(ClradarError, RuntimeError):
    """Processes on this or other machines cannot be started, reached, or do not fit together."""


class PackageError(ClradarError, ImportError):
    """A user's file or another package has the name of one of our packages and hides it."""


class MissingPackage(ClradarError, ImportError):
    """A package that only some functions need is not installed."""


class ClradarWarning(UserWarning):
    """A result is probably not as intended: the text says why, and what to change.

    Examples
    --------
    >>> import warnings
    >>> warnings.simplefilter("error", clradar.ClradarWarning)
    """


def warn(text: str) -> None:
    """Warn what is wrong, with its numbers, and what to change, by `ClradarWarning`, at the line
    outside of these packages that led here.

    The command line prints such warnings on stderr; in Python the `warnings` module filters them.
    """
    level, frame = 2, sys._getframe().f_back
    while frame is not None and frame.f_globals.get("__name__", "").split(".")[0] in _OWN_PACKAGES:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, ClradarWarning, stacklevel=level)


@contextmanager
def handled_warnings(handle: Callable[[str], object]) -> Iterator[None]:
    """Call a function with the text of every different `ClradarWarning` of the block, once."""
    handled: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        text = str(message)
        if not issubclass(category, ClradarWarning):
            show_others(message, category, *where, **more)
        elif text not in handled:
            handled.add(text)
            handle(text)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ClradarWarning)
        show_others, warnings.showwarning = warnings.showwarning, show
        yield
