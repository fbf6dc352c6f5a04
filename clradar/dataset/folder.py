"""The folder of a data set: its manifest and its shards.

    manifest.json            the plan, what made the samples, and which samples failed
    shards/shard-00000.h5    samples
    contact-sheet.png        when it is complete

A shard that is there is done. Of what failed the shards tell, too: the manifest is written anew
from them. Data sets of version 1, by clradar 0.2 and older, also have `parts`, single samples of
shards that were never closed; their manifests have a list of shards, which does not count.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clradar.dataset.plan.plan import Plan, PlanError, plan_from, plan_record
from clradar.dataset.plan.recipe import EARLIER_SETTINGS
from clradar.errors import MeasurementError, OutputError, quoted
from clradar.files.failures import fail, reading, shown
from clradar.files.json_file import read_json_object, write_json
from clradar.files.records import is_whole
from clradar.jobs.outcome import Aside

FORMAT, VERSION = "dataset", 2
MANIFEST, SHARDS, PARTS = "manifest.json", "shards", "parts"
CONTACT_SHEET = "contact-sheet.png"
SUMMARIES = (CONTACT_SHEET, "statistics.json", "statistics.csv")
"""What sums up a complete data set; the last two of versions until 0.2."""

OWN_NAMES = (MANIFEST, SHARDS, PARTS, *SUMMARIES)
"""Names in the folder of a data set that are its own; others are left alone."""

EXPECTED = "the manifest of a data set"
_SHARD = re.compile(r"shard-(\d{5,})\.h5")


@dataclass(slots=True)
class Manifest:
    """A data set as its folder tells it without any shard being opened.

    `shards` are the numbers of those that are there, `aside` the samples that failed, by number.
    """

    plan: Plan
    made_with: Mapping[str, Any] = field(default_factory=dict)
    aside: dict[int, Aside] = field(default_factory=dict)
    shards: set[int] = field(default_factory=set)

    def is_done(self, shard: int) -> bool:
        """Whether a shard is there, or nothing of it can be made."""
        return shard in self.shards or all(n in self.aside for n in self.plan.shard_samples(shard))

    @property
    def missing(self) -> list[int]:
        """The shards that are to be made."""
        return [shard for shard in range(self.plan.n_shards) if not self.is_done(shard)]

    @property
    def complete(self) -> bool:
        return not self.missing

    @property
    def stored(self) -> list[int]:
        """The samples that are there."""
        samples = (n for shard in sorted(self.shards) for n in self.plan.shard_samples(shard))
        return [sample for sample in samples if sample not in self.aside]

    def place_of(self, sample: int) -> str | None:
        """The shard with a sample, relative to the folder; None if it is missing or failed."""
        shard = sample // self.plan.output.shard_size
        return None if shard not in self.shards or sample in self.aside else shard_name(shard)

    def record(self) -> dict[str, Any]:
        """Return it as JSON."""
        aside = [self.aside[sample] for sample in sorted(self.aside)]
        return {
            "clradar_format": FORMAT,
            "clradar_version": VERSION,
            "plan": plan_record(self.plan),
            "made_with": dict(self.made_with),
            "set_aside": [{name: getattr(a, name) for name in a.__slots__} for a in aside],
        }


def write_manifest(folder: Path, manifest: Manifest) -> None:
    write_json(folder / MANIFEST, manifest.record(), force=True)


def is_dataset(path: Path) -> bool:
    """Return whether a folder is that of a data set."""
    return (path / MANIFEST).is_file() and (path / SHARDS).is_dir()


def refuse_own(folder: Path, output: Path) -> None:
    """Raise `OutputError` if an output would be a file of the data set's own."""
    place, owner = (Path(os.path.realpath(path)) for path in (output, folder))
    if place.is_relative_to(owner) and {*place.relative_to(owner).parts[:1]} & {*OWN_NAMES}:
        raise OutputError(f"{shown(output)}: belongs to the data set; choose another name")


def read_manifest(folder: Path) -> Manifest:
    """Return what the folder of a data set tells, of version 1, too."""
    path = folder / MANIFEST
    manifest = manifest_of(path, read_json_object(path))
    if (folder / SHARDS).is_dir():
        for entry in os.scandir(folder / SHARDS):
            number = shard_number(entry.name)
            if number is not None and number < manifest.plan.n_shards:
                manifest.shards.add(number)
    return manifest


def manifest_of(path: Path, record: Mapping[str, Any]) -> Manifest:
    """Return the content of a manifest, without shards."""
    with reading(path, EXPECTED):
        if record.get("clradar_format") != FORMAT:
            fail(path, EXPECTED, "another JSON file")
        version = record["clradar_version"]
        if not is_whole(version) or version > VERSION:
            fail(path, f"version {VERSION} or older", f"{quoted(version)}; update clradar")
        for key, kind in {"plan": dict, "made_with": dict, "set_aside": list}.items():
            if not isinstance(record[key], kind):
                fail(path, f"{key} to be a {kind.__name__}", quoted(record[key]))
        plan = _plan(path, record["plan"])
        manifest = Manifest(plan, record["made_with"])
        for content in record["set_aside"]:
            aside = Aside(**content)
            numbers = is_whole(aside.sample) and is_whole(aside.attempts)
            if not numbers or not 0 <= aside.sample < plan.samples:
                fail(path, "an entry with sample, reason, attempts", quoted(content))
            manifest.aside[aside.sample] = Aside(aside.sample, str(aside.reason), aside.attempts)
        return manifest


def _plan(path: Path, content: Mapping[str, Any]) -> Plan:
    """Return the plan of a manifest; its mistakes are damage, of which the first is shown."""
    simulation = content.get("simulation")
    if isinstance(simulation, dict):  # with the defaults of its time
        content = {**content, "simulation": {**EARLIER_SETTINGS, **simulation}}
    try:
        return plan_from(content, shown(path), path.parent)
    except PlanError as error:
        count = len(error.mistakes)
        more = f" (the first of {count} mistakes)" if count > 1 else ""
        raise MeasurementError(f"{error.mistakes[0]}{more}") from error


def shard_name(number: int) -> str:
    """Return the path of a shard, relative to the folder."""
    return f"{SHARDS}/shard-{number:05d}.h5"


def shard_number(name: str) -> int | None:
    """Return the number of a shard from its file's name; None of other files."""
    found = _SHARD.fullmatch(name)
    number = None if found is None else int(found[1])
    return number if number is not None and shard_name(number) == f"{SHARDS}/{name}" else None
