"""The folder of a data set: its manifest and its shards.

    manifest.json            the plan, what made the samples, which failed, SHA-256 of shards
    shards/shard-00000.h5    samples
    contact-sheet.png        when it is complete

A shard that is there is done. Of what failed the shards tell, too: the manifest is written anew
from them. Data sets of version 1, by clradar 0.2 and older, also have `parts`, single samples of
shards that were never closed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field

from clradar.dataset.plan.plan import Plan, plan_from, plan_record
from clradar.errors import quoted
from clradar.files.failures import fail, shown
from clradar.files.json_file import read_json_object, write_json
from clradar.files.records import OpenRecord, Whole, record_of
from clradar.jobs.outcome import Aside

FORMAT, VERSION = "dataset", 2
MANIFEST, SHARDS, PARTS = "manifest.json", "shards", "parts"
CONTACT_SHEET = "contact-sheet.png"
SUMMARIES = (CONTACT_SHEET, "statistics.json", "statistics.csv")
"""What sums up a complete data set; the last two of versions until 0.2."""

OWN_NAMES = (MANIFEST, SHARDS, PARTS, *SUMMARIES)
"""Names in the folder of a data set that are its own; others are left alone."""


class AsideRecord(OpenRecord):
    sample: Whole
    reason: str
    attempts: Whole


class ManifestRecord(OpenRecord):
    """What is read of a manifest, beside its format and version."""

    plan: dict[str, Any]
    made_with: dict[str, Any]
    set_aside: tuple[AsideRecord, ...]
    sha256: dict[str, str] = Field(default_factory=dict)


@dataclass(slots=True)
class Manifest:
    """A data set as its folder tells it without any shard being opened."""

    plan: Plan
    made_with: Mapping[str, Any] = field(default_factory=dict)
    aside: dict[int, Aside] = field(default_factory=dict)  # what failed, by its number
    sha256: dict[str, str] = field(default_factory=dict)  # by the names of shards
    shards: set[int] = field(default_factory=set)  # that are there

    @property
    def missing(self) -> list[int]:
        """The shards that are to be made: not there, and with a sample that has not failed."""
        absent = (n for n in range(self.plan.n_shards) if n not in self.shards)
        return [n for n in absent if not all(s in self.aside for s in self.plan.shard_samples(n))]

    @property
    def stored(self) -> list[int]:
        """The samples that are there."""
        samples = (n for shard in sorted(self.shards) for n in self.plan.shard_samples(shard))
        return [sample for sample in samples if sample not in self.aside]

    def place_of(self, sample: int) -> str:
        """The shard with a sample, or which would have it, relative to the folder."""
        return shard_name(sample // self.plan.output.shard_size)

    def take(self, number: int, failed: Mapping[int, Aside], sha256: str) -> None:
        """Take in a shard, of whose samples these failed."""
        samples = self.plan.shard_samples(number)
        others = {n: aside for n, aside in self.aside.items() if n not in samples}
        self.aside = {**others, **failed}
        self.shards.add(number)
        self.sha256[Path(shard_name(number)).name] = sha256

    def record(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "clradar_format": FORMAT,
            "clradar_version": VERSION,
            "plan": plan_record(self.plan),
            "made_with": dict(self.made_with),
            "set_aside": [asdict(self.aside[sample]) for sample in sorted(self.aside)],
            "sha256": {name: self.sha256[name] for name in sorted(self.sha256)},
        }


def write_manifest(folder: Path, manifest: Manifest) -> None:
    write_json(folder / MANIFEST, manifest.record(), force=True)


def is_dataset(path: Path) -> bool:
    """Return whether a folder is that of a data set."""
    return (path / MANIFEST).is_file() and (path / SHARDS).is_dir()


def read_manifest(folder: Path) -> Manifest:
    """Return what the folder of a data set tells, of version 1, too."""
    path = folder / MANIFEST
    manifest = manifest_of(path, read_json_object(path))
    if (folder / SHARDS).is_dir():
        there = {f"{SHARDS}/{name}" for name in os.listdir(folder / SHARDS)}
        manifest.shards = {n for n in range(manifest.plan.n_shards) if shard_name(n) in there}
    return manifest


def manifest_of(path: Path, content: Mapping[str, Any]) -> Manifest:
    """Return the content of a manifest, without shards."""
    expected = "the manifest of a data set"
    if content.get("clradar_format") != FORMAT:
        fail(path, expected, "another JSON file")
    version = content.get("clradar_version")
    if not isinstance(version, int) or version > VERSION:
        fail(path, f"version {VERSION} or older", f"{quoted(version)}; update clradar")
    record = record_of(content, ManifestRecord, path)
    aside = {one.sample: Aside(**one.model_dump()) for one in record.set_aside}
    plan = plan_from(record.plan, shown(path), path.parent)
    return Manifest(plan, record.made_with, aside, record.sha256)


def shard_name(number: int) -> str:
    """Return the path of a shard, relative to the folder."""
    return f"{SHARDS}/shard-{number:05d}.h5"
