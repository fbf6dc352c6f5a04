"""The folder of a data set: its manifest, its shards and parts, and how a run resumes.

    manifest.json            the plan, and every closed shard with its SHA-256
    shards/shard-00000.h5    samples
    parts/00000123.h5        a finished sample whose shard is open
    parts/00000123.json      why a sample was set aside
    statistics.json, statistics.csv, contact-sheet.png    when it is complete

The manifest is the commit record: a shard is closed when the manifest names it, and its parts are
removed only then. A run that is killed at any moment resumes from the same parts to the same bytes.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clradar.dataset.plan.plan import Plan, PlanError, plan_from, plan_record
from clradar.dataset.plan.recipe import EARLIER_SETTINGS
from clradar.dataset.store.content_check import check_part
from clradar.dataset.store.shard_writer import assemble
from clradar.errors import MeasurementError, OutputError, quoted
from clradar.files.failures import fail, reading, shown
from clradar.files.hashing import sha256_of
from clradar.files.json_differences import differences, listed_differences
from clradar.files.json_file import read_json_object, write_json
from clradar.files.records import is_whole
from clradar.jobs.lock import LOCK, TEMPORARY, held, remove_temporaries
from clradar.jobs.outcome import Aside

FORMAT, VERSION = "dataset", 1
MANIFEST, SHARDS, PARTS = "manifest.json", "shards", "parts"
STATISTICS, TABLE, CONTACT_SHEET = "statistics.json", "statistics.csv", "contact-sheet.png"
SUMMARIES = (STATISTICS, TABLE, CONTACT_SHEET)
"""Files that summarise a complete data set."""

OWN_NAMES = (MANIFEST, SHARDS, PARTS, *SUMMARIES)
"""Names in the folder of a data set that are its own; others are left alone."""

_CONTENT = {"plan": dict, "made_with": dict, "shards": list, "set_aside": list}
"""Types of a manifest's entries."""

SHARD_NAME, PART_NAME = re.compile(r"shard-\d{5,}\.h5"), re.compile(r"\d{8,}\.(h5|json)")
"""Names of a data set's files; others in its folders are left alone."""


@dataclass(frozen=True, slots=True)
class ShardEntry:
    """A closed shard: its number, its file, and how many samples are stored in it.

    The file is relative to the folder; it is None, and so are its SHA-256 and its size, if all
    samples were set aside. Older manifests have no size.
    """

    number: int
    file: str | None
    sha256: str | None
    samples: int
    size_bytes: int | None = None


@dataclass(slots=True)
class Manifest:
    """The content of `manifest.json`."""

    plan: Plan
    made_with: Mapping[str, Any]
    shards: dict[int, ShardEntry] = field(default_factory=dict)
    aside: dict[int, Aside] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        return len(self.shards) == self.plan.n_shards

    def record(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "clradar_format": FORMAT,
            "clradar_version": VERSION,
            "complete": self.complete,
            "plan": plan_record(self.plan),
            "made_with": dict(self.made_with),
            "shards": [_record(self.shards[number]) for number in sorted(self.shards)],
            "set_aside": [_record(self.aside[sample]) for sample in sorted(self.aside)],
        }


def _record(entry: Any) -> dict[str, Any]:
    return {name: getattr(entry, name) for name in entry.__slots__}


def is_dataset(path: Path) -> bool:
    """Return whether a folder is that of a data set."""
    return (path / MANIFEST).is_file() and (path / SHARDS).is_dir()


def refuse_own(folder: Path, output: Path) -> None:
    """Raise `OutputError` if an output would be a file of the data set's own."""
    place, owner = (Path(os.path.realpath(path)) for path in (output, folder))
    if place.is_relative_to(owner) and {*place.relative_to(owner).parts[:1]} & {*OWN_NAMES}:
        raise OutputError(f"{shown(output)}: belongs to the data set; choose another name")


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of a data set.

    Raises
    ------
    MeasurementError
        There is none, it is damaged, or of a newer version.
    """
    path = folder / MANIFEST
    expected = "the manifest of a data set"
    record = read_json_object(path)
    with reading(path, expected):
        if record.get("clradar_format") != FORMAT:
            fail(path, expected, "another JSON file")
        version = record["clradar_version"]
        if not is_whole(version) or version > VERSION:
            fail(path, f"version {VERSION} or older", f"{quoted(version)}; update clradar")
        for key, kind in _CONTENT.items():
            if not isinstance(record[key], kind):
                fail(path, f"{key} to be a {kind.__name__}", quoted(record[key]))
        manifest = Manifest(_plan(path, record["plan"], folder), record["made_with"])
        for content in record["shards"]:
            shard = ShardEntry(**content)
            if not _is_sound(shard, manifest.plan):
                fail(path, "an entry with number, file, sha256, samples, size", quoted(content))
            manifest.shards[shard.number] = shard
        for content in record["set_aside"]:
            aside = Aside(**content)
            if not (_is_index(aside.sample, manifest.plan.samples) and is_whole(aside.attempts)):
                fail(path, "an entry with sample, reason, attempts", quoted(content))
            manifest.aside[aside.sample] = Aside(aside.sample, str(aside.reason), aside.attempts)
        return manifest


def _plan(path: Path, content: Mapping[str, Any], folder: Path) -> Plan:
    """Return the plan of a manifest, with the defaults of its time; its mistakes are damage, of
    which the first is shown."""
    simulation = content.get("simulation")
    if isinstance(simulation, dict):
        content = {**content, "simulation": {**EARLIER_SETTINGS, **simulation}}
    try:
        return plan_from(content, shown(path), folder)
    except PlanError as error:
        count = len(error.mistakes)
        more = f" (the first of {count} mistakes)" if count > 1 else ""
        raise MeasurementError(f"{error.mistakes[0]}{more}") from error


def _is_sound(shard: ShardEntry, plan: Plan) -> bool:
    """Whether the entry of a shard has the types and numbers of one of this plan."""
    return (
        _is_index(shard.number, plan.n_shards)
        and shard.file in (None, shard_name(shard.number))
        and (shard.sha256 is None if shard.file is None else _is_sha256(shard.sha256))
        and is_whole(shard.samples)
        and (shard.size_bytes is None or is_whole(shard.size_bytes))
    )


def _is_sha256(value: object) -> bool:
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None


def _is_index(value: Any, count: int) -> bool:
    return is_whole(value) and 0 <= value < count


def shard_name(number: int) -> str:
    """Return the path of a shard, relative to the folder."""
    return f"{SHARDS}/shard-{number:05d}.h5"


def part_path(folder: Path, sample: int) -> Path:
    """Return the file of a single sample."""
    return folder / PARTS / f"{sample:08d}.h5"


def stored_path(folder: Path, manifest: Manifest, sample: int) -> Path | None:
    """Return the shard or part with a sample, or None if it is missing or set aside."""
    entry = manifest.shards.get(sample // manifest.plan.output.shard_size)
    if entry is None:
        part = part_path(folder, sample)
        return part if part.is_file() else None
    if entry.file is None or sample in manifest.aside:
        return None
    return folder / entry.file


class DatasetFolder:
    """A data set that is being written. Make one with `begin`."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path, self.manifest = path, manifest
        self.plan = manifest.plan

    def part(self, sample: int) -> Path:
        return part_path(self.path, sample)

    def shard(self, number: int) -> Path:
        return self.path / shard_name(number)

    def note(self, sample: int) -> Path:
        return self.path / PARTS / f"{sample:08d}.json"

    def missing(self) -> list[int]:
        """Return the samples that are neither made nor set aside, ascending."""
        there = {path.name for path in (self.path / PARTS).iterdir()}
        return [
            sample
            for number in range(self.plan.n_shards)
            if number not in self.manifest.shards
            for sample in self.plan.shard_samples(number)
            if self.part(sample).name not in there and self.note(sample).name not in there
        ]

    def set_aside(self, aside: Aside) -> None:
        """Write the note that a sample is set aside."""
        write_json(self.note(aside.sample), _record(aside), force=True)

    def own_parts(self) -> list[Path]:
        """Return the parts, and the notes on samples set aside."""
        return [path for path in (self.path / PARTS).glob("*") if PART_NAME.fullmatch(path.name)]

    def close_shard(self, number: int) -> None:
        """Close a shard if all its samples are made or set aside."""
        if number in self.manifest.shards:
            return
        samples = self.plan.shard_samples(number)
        parts = [self.part(sample) for sample in samples if self.part(sample).is_file()]
        # A part counts, even beside a note that its sample is set aside.
        notes = [
            self.note(sample)
            for sample in samples
            if not self.part(sample).is_file() and self.note(sample).is_file()
        ]
        if len(parts) + len(notes) < len(samples):
            return
        entry = ShardEntry(number, None, None, 0)
        if parts:
            target = self.shard(number)
            self._assemble(target, parts)
            digest, size_bytes = sha256_of(target), target.stat().st_size
            entry = ShardEntry(number, shard_name(number), digest, len(parts), size_bytes)
        for note in notes:
            aside = Aside(**read_json_object(note))
            self.manifest.aside[aside.sample] = aside
        self.manifest.shards[number] = entry
        self.write_manifest()
        self._remove_parts(number)

    def _assemble(self, target: Path, parts: list[Path]) -> None:
        try:
            assemble(target, parts, compression=self.plan.output.compression)
        except Exception:
            for part in parts:  # name the part if it is corrupt
                check_part(part, self.plan, int(part.stem))
            raise

    def write_manifest(self) -> None:
        write_json(self.path / MANIFEST, self.manifest.record(), force=True)

    def _remove_parts(self, number: int) -> None:
        for sample in self.plan.shard_samples(number):
            self.part(sample).unlink(missing_ok=True)
            self.note(sample).unlink(missing_ok=True)

    def remove_half_written(self) -> None:
        """Remove temporary files of a killed process."""
        for folder in (self.path, self.path / SHARDS, self.path / PARTS):
            remove_temporaries(folder)

    def tidy(self) -> None:
        """Remove what a killed process left: temporary files, parts of closed shards."""
        self.remove_half_written()
        for path in self.own_parts():
            sample = int(path.stem)
            done = sample // self.plan.output.shard_size in self.manifest.shards
            if done or sample >= self.plan.samples:
                path.unlink(missing_ok=True)


@contextmanager
def begin(
    path: Path, plan: Plan, made_with: Mapping[str, Any], *, force: bool = False
) -> Iterator[DatasetFolder]:
    """Create a data set, or resume the one in the folder, under a lock.

    `made_with` are versions and device, for the manifest of a new data set. `force` removes the
    data set that is in the folder, of this plan or another; other files in it stay. A failure
    before there is a sample leaves no data set.

    Raises
    ------
    OutputError
        The folder holds a data set of another plan, or files but no data set.
    """
    with held(path, "run of a data set"):
        folder = DatasetFolder(path, _manifest(path, plan, made_with, force))
        # The manifest first: a folder with other files and without a manifest is left alone.
        folder.write_manifest()
        try:
            for name in (SHARDS, PARTS):
                (path / name).mkdir(exist_ok=True)
            folder.tidy()
            yield folder
        except Exception:  # an interruption is to be resumed
            if not folder.manifest.shards and not folder.own_parts():
                _clear(path)  # nothing to resume with
                for name in (SHARDS, PARTS):
                    with suppress(OSError):  # it holds files of others
                        (path / name).rmdir()
            raise


def _manifest(path: Path, plan: Plan, made_with: Mapping[str, Any], force: bool) -> Manifest:
    if not (path / MANIFEST).exists():
        # A kill before the manifest is written leaves the lock and temporary files only.
        others = sorted(e.name for e in path.iterdir() if e.name != LOCK and not e.match(TEMPORARY))
        if others and not force:
            raise OutputError(
                f"{shown(path)}: holds files ({shown(others[0])}, ...), but no data set; choose "
                "another folder"
            )
        return Manifest(plan, made_with)
    manifest = read_manifest(path)
    if force:
        _clear(path)
        return Manifest(plan, made_with)
    plain = [json.loads(json.dumps(plan_record(p))) for p in (manifest.plan, plan)]
    different = differences(plain[0], plain[1])
    if different:
        raise OutputError(
            f"{shown(path)}: is a data set of another plan: {listed_differences(different)}. "
            "Resume with that plan, choose another folder, or replace the data set with --force"
        )
    manifest.plan = plan  # equal, with the folder of its rigs
    return manifest


def _clear(path: Path) -> None:
    """Remove the files of a data set, and no others in its folder."""
    # The manifest first: if this is killed, the remaining files belong to no data set.
    for name in (MANIFEST, *SUMMARIES):
        (path / name).unlink(missing_ok=True)
    for name, own in ((SHARDS, SHARD_NAME), (PARTS, PART_NAME)):
        if (path / name).is_dir():
            remove_temporaries(path / name)
            for file in (path / name).iterdir():
                if own.fullmatch(file.name):
                    file.unlink(missing_ok=True)
