"""Checks of the names of outputs, before the long work starts, and the files that are written."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from clradar.errors import OutputError

if TYPE_CHECKING:
    from clradar import Capture, ChannelCalibration, Volume

    Result = TypeVar("Result", Capture, Volume, ChannelCalibration)


@contextmanager
def _system_errors(path: Path, refused: str) -> Iterator[None]:
    """Raise the system's error about a name as an `OutputError`."""
    try:
        yield
    except OutputError:
        raise
    except (OSError, ValueError) as error:  # a name that is too long, or holds a zero byte
        raise OutputError(f"{path}: {refused}: {error}") from error


def check_outputs(
    outputs: Iterable[Path | None], *, force: bool, inputs: Iterable[Path] = ()
) -> None:
    """Raise unless every output may be written.

    Parameters
    ----------
    outputs : iterable of Path or None
        None: an output that was not requested.
    force : bool
        Existing files may be replaced.
    inputs : iterable of Path
        Files that are read, and are never written to.

    Raises
    ------
    OutputError
        A file exists and `force` is False, its folder does not exist or cannot be written to, it is
        a folder, one name is given twice, or it is also an input.
    """
    taken: dict[str, str] = {}
    for path in inputs:
        taken[os.path.realpath(path)] = "is also an input"
    for output in outputs:
        if output is None:
            continue
        with _system_errors(output, "cannot be written"):
            place = os.path.realpath(output)
            if place in taken:
                raise OutputError(f"{output}: {taken[place]}; choose another name")
            if output.is_dir():
                raise OutputError(f"{output}: expected a file's name, got a folder")
            if not output.parent.is_dir():
                raise OutputError(f"{output}: expected an existing folder, got '{output.parent}'")
            if not force and os.path.lexists(output):
                raise OutputError(f"{output}: exists already; --force replaces it")
            if not os.access(output.parent, os.W_OK | os.X_OK):
                raise OutputError(f"{output}: the folder '{output.parent}' cannot be written to")
        taken[place] = "is named twice as an output"


def check_folder(folder: Path, *, force: bool, replaced: Collection[str] | None = None) -> None:
    """Raise unless a folder is missing or empty, or may be written into with `force`.

    `replaced` names the only files that `force` may replace; None: any.
    """
    with _system_errors(folder, "cannot be written"):
        if not os.path.lexists(folder):
            return
        if not folder.is_dir():
            raise OutputError(f"{folder}: expected a folder's name, got a file")
        there = sorted(path.name for path in folder.iterdir())
    if there and not force:
        raise OutputError(
            f"{folder}: holds files already; choose another folder, or replace an earlier result "
            "with --force"
        )
    for name in there:
        if replaced is not None and name not in replaced:
            raise OutputError(
                f"{folder}: holds '{name}', which --force would delete; choose another folder"
            )


def make_folder(folder: Path) -> None:
    """Make a folder, with those above it, where missing."""
    with _system_errors(folder, "cannot be made"):
        folder.mkdir(parents=True, exist_ok=True)


def check_suffix(path: Path | None, suffixes: Sequence[str]) -> None:
    """Raise unless the name ends as its kind of file does; None: it was not requested."""
    if path is not None and path.suffix.lower() not in suffixes:
        raise OutputError(
            f"{path}: expected a name that ends in {', '.join(suffixes)}, got '{path.suffix}'"
        )


def check_figure(path: Path | None) -> None:
    """Raise unless a figure can be written under this name."""
    from clradar.plot import SUFFIXES

    check_suffix(path, SUFFIXES)


def save(path: Path, result: Result, origin: Mapping[str, Any], *, force: bool) -> Result:
    """Write a capture, a volume or channels with their provenance; return it as written."""
    from clradar import Capture, Volume
    from measurement_io import save_capture, save_channels, save_volume

    written = replace(result, meta={**result.meta, **origin})
    if isinstance(written, Capture):
        save_capture(path, written, force=force)
    elif isinstance(written, Volume):
        save_volume(path, written, force=force)
    else:
        save_channels(path, written, force=force)
    return written
