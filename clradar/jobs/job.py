"""Folders of long work, which resume only what was made from the same inputs and settings."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from clradar.errors import ClradarError, OutputError, warn
from clradar.files.atomic import remove_temporaries, replacing
from clradar.files.failures import fail, reading, shown
from clradar.files.hashing import content_record, holds_still
from clradar.files.json_file import differences, listed_differences, read_json, write_json
from clradar.jobs.lock import LOCK, held
from clradar.jobs.outcome import Work
from clradar.jobs.where import Where
from clradar.model.progress import Progress

KEY = "settings.json"  # what a folder was begun with: its settings, and what its inputs hold
MADE_FROM = "made_from"

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Items that are worked on once, into a folder of one writer at a time.

    A folder begins with its `key`, and goes on only with an equal one. An item is done when its
    files are there, which the steps write whole or not at all, one last. So a run that is killed at
    any moment and begun again ends with the bytes of an undisturbed one.
    """

    folder: Path
    work: str  # what goes on in it, for messages: "sweep"
    key: Mapping[str, Any]  # settings, as JSON knows them, without places of files
    own: Sequence[str]  # names in the folder that are the job's own, in the order of removal
    # Files by the option or argument that names them: what they hold is part of the key.
    inputs: Mapping[str, Sequence[Path]] = field(default_factory=lambda: MappingProxyType({}))
    # Whether there is anything to resume with; without, what failed leaves nothing.
    resumable: Callable[[Path], bool] = lambda folder: False
    force: bool = False  # begin anew in a folder that was begun with another key
    key_name: str = KEY
    # What of a key has to be equal: a key may tell more, or be of an older version.
    compared: Callable[[Mapping[str, Any]], Mapping[str, Any]] = lambda key: key

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other processes out of the folder, and begin in it or go on."""
        with held(self.folder, self.work):
            self._remove_temporaries()
            self._begin()
            try:
                yield
            except Exception:
                if not self.resumable(self.folder):
                    self.clear()
                raise
            finally:
                self._remove_temporaries()

    def _remove_temporaries(self) -> None:
        """Remove what killed processes left, while no other writes."""
        for place in (self.folder, *(self.folder / name for name in self.own)):
            remove_temporaries(place)

    def _begin(self) -> None:
        path = self.folder / self.key_name
        if path.exists() or path.is_symlink():
            try:
                expected = f"the settings of a begun {self.work}, as JSON"
                before = read_json(path, expected)
                if not isinstance(before, dict):
                    fail(path, expected, "no JSON object")
            except ValueError:  # MeasurementError is one
                if not self.force:
                    raise
                before = {}
            known = before.pop(MADE_FROM, {})
            now = json.loads(json.dumps(self.compared(self.key), allow_nan=False))
            different = [
                *changed_files(self.inputs, known), *differences(self.compared(before), now)
            ]  # fmt: skip
            if not different:
                return
            if not self.force:
                raise OutputError(
                    f"{self.folder}: was begun with other settings: "
                    f"{listed_differences(different)}. Repeat them to resume, choose another "
                    "folder, or begin anew with --force"
                )
        elif not self.force and any(entry.name != LOCK for entry in self.folder.iterdir()):
            raise OutputError(
                f"{self.folder}: holds files, but no begun {self.work}; choose another folder, or "
                "write among them with --force"
            )
        self.clear()
        made_from = {name: list(map(content_record, files)) for name, files in self.inputs.items()}
        more = {MADE_FROM: made_from} if self.inputs else {}
        write_json(path, {**self.key, **more}, force=False)

    def clear(self, names: Iterable[str] | None = None) -> None:
        """Remove what is the job's own, or some of it."""
        remove(self.folder, self.own if names is None else names)

    def each(
        self,
        work: Work[Any],
        items: Sequence[Item],
        where: Where,
        *,
        done: Callable[[Item], bool],
        name: Callable[[Item], str] = lambda item: "",
        tolerated: Callable[[ClradarError], bool] = lambda error: False,
        progress: Progress | None = None,
        say: Callable[[str], None] = lambda text: None,
        noun: str = "item",
    ) -> Iterator[tuple[Item, Any]]:
        """Work on the items that are not done; yield each with its result, as they are done.

        `done`: whether the files of an item are there. `name` stands in front of its warnings, each
        given once; an error that is `tolerated` is one. `say` is told how many were done before.
        """
        left = [item for item in items if not done(item)]
        before = len(items) - len(left)
        if before:
            say(f"{self.folder}: resumes with {before} of {len(items)} {noun}s done before")
        said: set[str] = set()
        for item, (result, warned) in where.outcomes(work, left, self.folder, progress):
            failed = isinstance(result, ClradarError)
            if failed and tolerated(result):
                warned = [*warned, str(result)]
            for text in warned:
                if text not in said:
                    warn(f"{name(item)}{text}")
                said.add(text)
            if not failed:
                yield item, result
            elif not tolerated(result):
                raise result


def changed_files(inputs: Mapping[str, Sequence[Path]], known: Any) -> list[str]:
    """Which files hold something else than at their records (`content_record`), in words."""
    found, known = [], known if isinstance(known, dict) else {}
    for name in {**inputs, **known}:  # an option that is not given any more, too
        before, now = known.get(name, []), inputs.get(name, ())
        if len(before) != len(now):
            files = f"{len(before)} file{'s'[: len(before) != 1]}"
            found.append(f"{name} of {files}, now of {len(now)}")
            continue
        for path, record in zip(now, before, strict=True):
            if not holds_still(path, record):
                found.append(f"{name} '{path}' holds something else now")
    return found


def remove(folder: Path, names: Iterable[str]) -> None:
    """Remove files and folders of these names, in this order."""
    try:
        for name in names:
            path = folder / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{shown(folder)}: cannot be cleared: {error}") from error


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
