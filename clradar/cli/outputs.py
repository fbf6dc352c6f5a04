"""Checks of the names of outputs, before the long work starts, and the files that are written.

One rule for all commands: the folder that an output goes into exists. A command whose output is a
folder makes that one, and none above it. Nothing is written over an input, nor into a data set or
a recording.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from clradar.errors import OutputError
from clradar.files.atomic import refuse_special

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
        a folder or a device, one file is named twice, it is also an input, or it is a file of a
        data set or of a recording.
    """
    read, written = list(inputs), set()
    for output in outputs:
        if output is None:
            continue
        with _system_errors(output, "cannot be written"):
            if any(_same(output, path) for path in read):
                raise OutputError(f"{output}: is also an input; choose another name")
            place = os.path.realpath(output).casefold()  # case may not count on this disk
            if place in written:
                raise OutputError(f"{output}: is named twice as an output; choose another name")
            written.add(place)
            if output.is_dir():
                raise OutputError(f"{output}: expected a file's name, got a folder")
            _check_place(output)
            refuse_special(output)
            if not force and os.path.lexists(output):
                raise OutputError(f"{output}: exists already; --force replaces it")


def _same(one: Path, other: Path) -> bool:
    """Whether two names are of one file, by links too."""
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    return one.exists() and other.exists() and one.samefile(other)


def check_folder(
    folder: Path,
    *,
    force: bool,
    replaced: Collection[str] | None = None,
    inputs: Iterable[Path] = (),
) -> None:
    """Raise unless a folder is missing or empty, or may be written into with `force`.

    `replaced` names the only files that `force` may replace; None: any. None of them is one of
    the `inputs`.
    """
    check_place_of_folder(folder, replaced or (), inputs)
    with _system_errors(folder, "cannot be written"):
        there = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
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


def check_place_of_folder(
    folder: Path, replaced: Collection[str] = (), inputs: Iterable[Path] = ()
) -> None:
    """Raise unless there is or may be such a folder, with none of the inputs where it is written.

    `replaced` names what the command writes in it.
    """
    with _system_errors(folder, "cannot be written"):
        if os.path.lexists(folder) and not folder.is_dir():
            raise OutputError(f"{folder}: expected a folder's name, got a file")
        _check_place(folder)
        for path in inputs:
            if _same(folder, path):
                raise OutputError(f"{folder}: is also an input; choose another folder")
            for name in replaced:
                if Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder / name)):
                    raise OutputError(
                        f"{folder}: holds the input '{path}', which would be replaced; choose "
                        "another folder"
                    )


def _check_place(output: Path) -> None:
    """Raise unless an output's folder exists, can be written to, and is nobody else's."""
    if not output.parent.is_dir():
        raise OutputError(f"{output}: expected an existing folder, got '{output.parent}'")
    if not output.is_dir() and not os.access(output.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{output}: the folder '{output.parent}' cannot be written to")
    # A link is followed, and is a file where it lies.
    for place in (os.path.realpath(output), os.path.realpath(output.parent) + f"/{output.name}"):
        for folder in tuple(Path(place).parents)[:OWNED_DEPTH]:
            owner = _owner_of(folder, Path(place).relative_to(folder).parts[0])
            if owner is not None:
                raise OutputError(
                    f"{output}: belongs to the {owner} '{folder}'; choose another name"
                )


OWNED_DEPTH = 3
"""Folders above a file that may own it: a recording is three above its frames."""


def _owner_of(folder: Path, name: str) -> str | None:
    """What a folder is, if what has this name in it is its own; None if anybody may write it."""
    # The files first: these imports take half a second.
    if (folder / "manifest.json").is_file():
        from clradar.dataset.store.folder import OWN_NAMES, is_dataset

        if name in OWN_NAMES and is_dataset(folder):
            return "data set"
    if name.startswith("radar_") or any(folder.glob("radar_*")):
        from measurement_io.maroon.folders import is_own_name

        if is_own_name(folder, name):
            return "recording"
    return None


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder where there is none; a failure that leaves it empty removes it again."""
    missing = not folder.is_dir()
    with _system_errors(folder, "cannot be made"):
        folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException:
        if missing:
            with suppress(OSError):  # it holds something
                folder.rmdir()
        raise


@contextmanager
def whole_folder(folder: Path, *, force: bool, replaced: Collection[str]) -> Iterator[Path]:
    """Yield a folder to fill, which becomes `folder` at the end, in place of an earlier result.

    A failure leaves everything as it was. `replaced` as in `check_folder`.
    """
    from clradar.files.atomic import new_folder, swap_folder

    with new_folder(folder) as temporary:
        made = temporary / "made"
        made.mkdir()
        yield made
        # Another process may have made it meanwhile.
        check_folder(folder, force=force, replaced=replaced)
        swap_folder(made, folder, temporary / "replaced")


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
