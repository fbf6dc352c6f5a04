"""Folders of commands that take long: the settings they were begun with, and what is done."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import OutputError
from clradar.files.atomic import replacing
from clradar.files.failures import fail, reading
from clradar.files.json_differences import differences, listed_differences
from clradar.files.json_file import read_json, write_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.files.work_folder import LOCK, remove_temporaries

SETTINGS = "settings.json"


def begin_work(
    folder: Path, settings: Mapping[str, Any], *, own: Sequence[str], work: str, force: bool
) -> None:
    """Check that the content of a folder was made with these settings.

    An empty folder takes them on. With `force` one that was begun with others is cleared: of the
    names in `own`, and of nothing else. `work` is what goes on in it, such as "sweep".

    Raises
    ------
    OutputError
        It was begun with other settings, or holds files but nothing that was begun.
    """
    # Here, where no other process writes, and not by those that share the work later.
    for place in (folder, *(folder / name for name in own)):
        remove_temporaries(place)
    path = folder / SETTINGS
    if path.exists() or path.is_symlink():
        different = differences(_read_settings(path, work, force), _plain(settings))
        if not different:
            return
        if not force:
            raise OutputError(
                f"{folder}: was begun with other settings: {listed_differences(different)}. Repeat "
                "them to resume, choose another folder, or begin anew with --force"
            )
    elif not force and any(entry.name != LOCK for entry in folder.iterdir()):
        raise OutputError(
            f"{folder}: holds files, but no {work}; choose another folder, or write among them "
            "with --force"
        )
    clear(folder, own)
    write_json(path, dict(settings), force=False)


def clear(folder: Path, own: Sequence[str]) -> None:
    """Remove files and folders of these names, in this order."""
    try:
        for name in own:
            path = folder / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be cleared: {error}") from error


@contextmanager
def cleared_on_failure(folder: Path, own: Sequence[str], *, unless: str) -> Iterator[None]:
    """Leave no settings of work that fails before there is anything to resume with.

    `unless` is a pattern of files, of which one is enough to resume. Interruptions are resumed.
    """
    try:
        yield
    except Exception:
        if not any(folder.glob(unless)):
            clear(folder, own)
        raise


def _read_settings(path: Path, work: str, force: bool) -> dict[str, Any]:
    expected = f"the settings of a {work}, as JSON"
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


class FolderStore(MutableMapping[str, dict[str, np.ndarray]]):
    """Arrays by name, each name a file that is there whole or not at all."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)

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
