"""The folder of a sweep: what has been done is kept in it, so that it can go on after a kill."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, MutableMapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clradar.cli.output import write_json
from clradar.errors import OutputError
from clradar.files import work_folder
from clradar.files.atomic import replacing
from clradar.files.failures import fail, reading
from clradar.files.json_differences import differences
from clradar.files.json_file import read_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.files.work_folder import LOCK, remove_temporaries

SETTINGS, TRANSFORM, RESULT = "settings.json", "transform.json", "sweep.json"
TABLE, REGION_TABLE, FIGURE = "sweep.csv", "regions.csv", "sweep.png"
WORK = "work"

# The settings first: what is left when a removal is cut short then belongs to no sweep.
FILES = (SETTINGS, TRANSFORM, RESULT, TABLE, REGION_TABLE, FIGURE)

MOST_DIFFERENCES = 5

held = partial(work_folder.held, work="sweep")
"""Make the folder, and keep other processes from sweeping into it while the block runs."""


class FolderStore(MutableMapping[str, dict[str, np.ndarray]]):
    """Arrays by name, each name a file that is there whole or not at all."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)
        remove_temporaries(folder)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npz"

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._path(name).is_file()

    def __getitem__(self, name: str) -> dict[str, np.ndarray]:
        if name not in self:
            raise KeyError(name)
        path = self._path(name)
        with reading(path, "the arrays of an image"), np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files}

    def __setitem__(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        with replacing(self._path(name), force=True) as temporary, open(temporary, "xb") as file:
            values: dict[str, Any] = dict(arrays)
            np.savez(file, **values)

    def __delitem__(self, name: str) -> None:
        self._path(name).unlink()

    def __iter__(self) -> Iterator[str]:
        return (path.stem for path in sorted(self._folder.glob("*.npz")))

    def __len__(self) -> int:
        return sum(1 for _ in self)


def begin(folder: Path, settings: Mapping[str, Any], *, force: bool) -> None:
    """Make sure that what the folder holds was made with these settings.

    An empty folder takes them on. With `force` one that was begun with others is cleared: of the
    files of a sweep, and of nothing else.

    Raises
    ------
    OutputError
        It was begun with other settings, or holds files but no sweep.
    """
    remove_temporaries(folder)
    path = folder / SETTINGS
    if path.exists() or path.is_symlink():
        different = differences(_read_settings(path, force), _plain(settings))
        if not different:
            return
        if not force:
            more = len(different) - MOST_DIFFERENCES
            listed = "; ".join(different[:MOST_DIFFERENCES]) + (
                f"; {more} more" if more > 0 else ""
            )
            raise OutputError(
                f"{folder}: was begun with other settings: {listed}. Repeat them to go on, choose "
                "another folder, or begin anew with --force"
            )
    elif not force and any(entry.name != LOCK for entry in folder.iterdir()):
        raise OutputError(
            f"{folder}: holds files, but no sweep; choose another folder, or write among them with "
            "--force"
        )
    _clear(folder)
    write_json(path, dict(settings), force=False)


def _clear(folder: Path) -> None:
    try:
        for name in FILES:
            (folder / name).unlink(missing_ok=True)
        if (folder / WORK).exists():
            shutil.rmtree(folder / WORK)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be cleared: {error}") from error


def _read_settings(path: Path, force: bool) -> dict[str, Any]:
    expected = "the settings of a sweep, as JSON"
    try:
        value = read_json(path, expected, MAX_SMALL_JSON_BYTES)
        if not isinstance(value, dict):
            fail(path, expected, "no JSON object")
        return value
    except ValueError:  # MeasurementError is one
        if force:
            return {}
        raise


def _plain(settings: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(settings, allow_nan=False))


def is_finished(folder: Path) -> bool:
    """Whether all results are there; the last to be written is RESULT."""
    return all((folder / name).is_file() for name in (RESULT, TABLE, FIGURE))


def finish(folder: Path) -> None:
    """Remove the images that were kept for going on."""
    shutil.rmtree(folder / WORK, ignore_errors=True)
