"""Folders of commands that take long: the settings they were begun with, and what is done."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from clradar.cli.console import counted
from clradar.errors import OutputError
from clradar.files.atomic import replacing
from clradar.files.failures import fail, reading
from clradar.files.hashing import content_record, holds_still
from clradar.files.json_differences import differences, listed_differences
from clradar.files.json_file import read_json, write_json
from clradar.files.limits import MAX_SMALL_JSON_BYTES
from clradar.files.work_folder import LOCK, remove_temporaries

SETTINGS = "settings.json"

MADE_FROM = "made_from"
"""Key of the settings: what the inputs hold."""


def begin_work(
    folder: Path,
    settings: Mapping[str, Any],
    *,
    own: Sequence[str],
    work: str,
    force: bool,
    inputs: Mapping[str, Sequence[Path]] = MappingProxyType({}),
) -> None:
    """Check that the content of a folder was made with these settings.

    An empty folder takes them on. With `force` one that was begun with others is cleared: of the
    names in `own`, and of nothing else. `work` is what goes on in it, such as "sweep". `inputs` are
    files by the option or argument that names them: their content counts, and not their place.

    Raises
    ------
    OutputError
        It was begun with other settings or inputs, or holds files but nothing that was begun.
    """
    # Here, where no other process writes, and not by those that share the work later.
    for place in (folder, *(folder / name for name in own)):
        remove_temporaries(place)
    path = folder / SETTINGS
    if path.exists() or path.is_symlink():
        before = _read_settings(path, work, force)
        known = before.pop(MADE_FROM, {})
        different = [*changed_files(inputs, known), *differences(before, _plain(settings))]
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
    made_from = {name: list(map(content_record, files)) for name, files in inputs.items()}
    write_json(path, {**settings, **({MADE_FROM: made_from} if inputs else {})}, force=False)


def changed_files(inputs: Mapping[str, Sequence[Path]], known: Any) -> list[str]:
    """Which files hold something else than at their records (`content_record`), in words."""
    found = []
    for name in inputs:
        before = known.get(name, []) if isinstance(known, dict) else []
        if len(before) != len(inputs[name]):
            found.append(f"{name} of {counted(len(before), 'file')}, now of {len(inputs[name])}")
            continue
        for path, record in zip(inputs[name], before, strict=True):
            if not holds_still(path, record):
                found.append(f"{name} '{path}' holds something else now")
    return found


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
