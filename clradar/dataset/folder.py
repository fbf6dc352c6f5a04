"""The folder of a data set: its manifest and its shards, and whether it is whole.

    manifest.json            the plan, what made the samples, which failed, SHA-256 of shards
    shards/shard-00000.h5    samples

A shard that is there is done. Of what failed the shards tell, too: the manifest is written anew
from them. There may be `parts`, single samples of shards that are not there, which clradar 0.2 and
older, of version 1, never closed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, SkipValidation

from clradar.dataset.plan.plan import Plan, plan_from, plan_record
from clradar.dataset.sample import Sample
from clradar.dataset.shards import (
    Aside,
    arrays_of,
    labels_of,
    opened_shard,
    place_of,
    read_array,
    read_stored,
    samples_of,
)
from clradar.errors import ClradarError, quoted
from clradar.files.failures import clean, fail, shown
from clradar.files.hashing import sha256_of
from clradar.files.json_file import read_json_object, write_json
from clradar.files.records import OpenRecord, record_of
from clradar.model.progress import Progress
from measurement_io import CheckReport, Description, Fact

FORMAT, VERSION = "dataset", 2
MANIFEST, SHARDS, PARTS = "manifest.json", "shards", "parts"
SUMMARIES = ("contact-sheet.png", "statistics.json", "statistics.csv")
"""What older versions wrote of a complete data set."""

OWN_NAMES = (MANIFEST, SHARDS, PARTS, *SUMMARIES)
"""Names in the folder of a data set that are its own; others are left alone."""

MOST_LISTED = 10  # samples listed in a problem


class Manifest(OpenRecord, frozen=False):
    """A data set as its folder tells it without any shard being opened."""

    plan: SkipValidation[Plan]
    made_with: dict[str, Any] = Field(default_factory=dict)
    set_aside: tuple[Aside, ...] = ()  # what failed, in order
    sha256: dict[str, str] = Field(default_factory=dict)  # by the names of shards
    shards: SkipValidation[set[int]] = Field(default_factory=set)  # that are there; of no file

    @property
    def aside(self) -> dict[int, Aside]:
        return {one.sample: one for one in self.set_aside}

    @property
    def missing(self) -> list[int]:
        """The shards that are to be made: not there, and with a sample that has not failed."""
        aside, absent = self.aside, {*range(self.plan.n_shards)} - self.shards
        return sorted(n for n in absent if not aside.keys() >= {*self.plan.shard_samples(n)})

    @property
    def stored(self) -> list[int]:
        """The samples that are there."""
        aside, plan = self.aside, self.plan
        return [n for i in sorted(self.shards) for n in plan.shard_samples(i) if n not in aside]

    def place_of(self, sample: int) -> str:
        """The shard with a sample, or which would have it, relative to the folder."""
        return shard_name(sample // self.plan.output.shard_size)

    def record(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "clradar_format": FORMAT,
            "clradar_version": VERSION,
            "plan": plan_record(self.plan),
            "made_with": self.made_with,
            "set_aside": [aside.model_dump() for aside in self.set_aside],
            "sha256": dict(sorted(self.sha256.items())),
        }


def write_manifest(folder: Path, manifest: Manifest) -> None:
    write_json(folder / MANIFEST, manifest.record(), force=True)


def is_dataset(path: Path) -> bool:
    """Return whether a folder is that of a data set."""
    return (path / MANIFEST).is_file() and (path / SHARDS).is_dir()


def read_manifest(folder: Path) -> Manifest:
    """Return what the folder of a data set tells, of version 1, too."""
    path = folder / MANIFEST
    if not path.is_file():
        fail(folder, "the folder of a data set", f"one without {MANIFEST}")
    manifest = manifest_of(path, read_json_object(path))
    there = {f"{SHARDS}/{path.name}" for path in (folder / SHARDS).glob("*")}
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
    manifest = record_of(content, Manifest, path)
    manifest.plan = plan_from(content["plan"], shown(path), path.parent)
    return manifest


def shard_name(number: int) -> str:
    """Return the path of a shard, relative to the folder."""
    return f"{SHARDS}/shard-{number:05d}.h5"


def stored_sample(folder: Path, manifest: Manifest, sample: int) -> tuple[Sample, dict[str, Any]]:
    """Return a stored sample, and the versions and the device that made it."""
    return read_stored(folder / manifest.place_of(sample), sample, manifest.plan)


def part_name(sample: int) -> str:
    """Return the path of a part, relative to the folder."""
    return f"{PARTS}/{sample:08d}.h5"


# What a data set is, and whether it is whole


def describe_dataset(folder: Path) -> Description:
    """Describe a data set from its manifest and the sizes of its shards, which are not opened."""
    manifest = read_manifest(folder)
    plan, closed, complete = manifest.plan, len(manifest.shards), not manifest.missing
    names = [pose.name for pose in plan.poses.resolved]
    size = sum((folder / shard_name(number)).stat().st_size for number in manifest.shards)
    stored, aside = len(manifest.stored), len(manifest.set_aside)
    text = f"yes, but for {aside} set aside" if aside else "yes"
    device = manifest.made_with.get("device", {})
    shards = f"{closed} of {plan.n_shards}, {size / 2**20:.1f} MiB"
    facts = [
        Fact("samples", f"{stored} of {plan.samples}", {"stored": stored, "plan": plan.samples}),
        Fact("complete", text if complete else "no", complete),
        Fact("set aside", f"{aside}", sorted(manifest.aside)),
        Fact("shards", shards, {"closed": closed, "plan": plan.n_shards, "bytes": size}),
        Fact("products", ", ".join(plan.output.products), list(plan.output.products)),
        Fact("poses", f"{plan.poses.kind} of {len(names)}: {clean(', '.join(names))}", names),
        Fact("seed", f"{plan.seed}", plan.seed),
        Fact("made with", clean(json.dumps(device)), manifest.made_with),
    ]
    return Description(shown(folder), "data set", tuple(facts), (), tuple(_missing(manifest)))


def check_dataset(folder: Path, progress: Progress | None = None) -> CheckReport:
    """Verify a data set by reading all of it: SHA-256 and checksums, and what readers need."""
    try:
        manifest = read_manifest(folder)
    except ClradarError as error:
        return CheckReport(shown(folder), (), error.mistakes or (clean(error),))
    checked = ["manifest: its plan is whole and has no mistakes"]
    problems = [*_missing(manifest)]
    before = len(problems)
    for done, number in enumerate(sorted(manifest.shards), start=1):
        try:
            found = [f"{shard_name(number)}: {p}" for p in _problems(folder, manifest, number)]
        except ClradarError as error:
            found = [clean(error)]
        problems += (f"{p}; delete the file, and the same command makes it again" for p in found)
        if progress is not None:
            progress(done, len(manifest.shards))
    if len(problems) == before:
        known = sum(shard_name(n).split("/")[1] in manifest.sha256 for n in manifest.shards)
        checked += [
            f"shards: {len(manifest.shards)}, {known} by their SHA-256: samples in order",
            f"samples: {len(manifest.stored)}, labels are there",
            f"{', '.join(manifest.plan.output.products)}: finite numbers",
        ]
    if manifest.set_aside:
        samples = _listed(sorted(manifest.aside))
        checked.append(f"set aside, with their reasons in the manifest: {samples}")
    return CheckReport(shown(folder), tuple(checked), tuple(problems))


def _missing(manifest: Manifest) -> Iterator[str]:
    if missing := manifest.missing:
        yield f"not complete: shards {_listed(missing)} are missing; the same command makes them"


def _problems(folder: Path, manifest: Manifest, number: int) -> Iterator[str]:
    """What is wrong with a shard."""
    path, plan = folder / shard_name(number), manifest.plan
    known = manifest.sha256.get(path.name)
    if known is not None and (found := sha256_of(path)) != known:
        yield f"expected the SHA-256 {known}, got {found}"
        return
    samples = sorted({*plan.shard_samples(number)} - manifest.aside.keys())
    with opened_shard(path) as file:
        if (there := samples_of(file)) != samples:
            yield f"expected the samples {_listed(samples)}, got {_listed(there)}"
            return
        for name in labels_of(plan) if samples else ():
            place = place_of(file, name)
            if place not in file or len(file[place][:]) != len(samples):
                yield f"{name}: expected one for each sample"
        for name in arrays_of(plan.output.products):
            # Of depths, and of joints of rigs, some may be missing.
            may_lack = name == "depth_map" or (name == "joints" and plan.hands.rigs)
            wrong = np.isinf if may_lack else lambda array: ~np.isfinite(array)
            rows = enumerate(samples)
            if bad := [n for row, n in rows if np.any(wrong(read_array(file, name, row)))]:
                yield f"{name}: expected finite numbers, got others in the samples {_listed(bad)}"


def _listed(numbers: Sequence[int]) -> str:
    more = len(numbers) - MOST_LISTED
    text = ", ".join(map(str, numbers[:MOST_LISTED]))
    return f"{text} and {more} more" if more > 0 else text or "none"
