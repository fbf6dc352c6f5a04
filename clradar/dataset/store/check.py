"""Verification and description of data sets: every byte, label and recipe against the plan."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from clradar.dataset.store.content_check import content_problems, listed
from clradar.dataset.store.folder import (
    PART_NAME,
    PARTS,
    SHARDS,
    Manifest,
    ShardEntry,
    read_manifest,
)
from clradar.dataset.store.repair import shard_fault
from clradar.errors import ClradarError
from clradar.files.failures import clean, shown
from clradar.files.hashing import sha256_of
from clradar.jobs.lock import TEMPORARY
from clradar.model.progress import Progress
from measurement_io import CheckReport, Description, Fact

LEFT_OVER = "left over; the same command removes it"
FOREIGN = "is not of this data set; it can be removed by hand"


def describe_dataset(folder: Path) -> Description:
    """Describe a data set from its manifest and the sizes of its shards, which are not opened.

    Raises
    ------
    MeasurementError
        The manifest is missing or damaged.
    """
    manifest = read_manifest(folder)
    plan = manifest.plan
    faults = _shard_faults(folder, manifest)
    whole = [entry for number, entry in manifest.shards.items() if number not in faults]
    complete = manifest.complete and not faults
    stored = sum(entry.samples for entry in whole)
    size = sum((folder / entry.file).stat().st_size for entry in whole if entry.file is not None)
    names = [pose.name for pose in plan.poses.poses]
    device = manifest.made_with.get("device", {})
    facts = [
        Fact("samples", f"{stored} of {plan.samples}", {"stored": stored, "plan": plan.samples}),
        Fact("complete", _complete_text(complete, len(manifest.aside)), complete),
        Fact("set aside", f"{len(manifest.aside)}", sorted(manifest.aside)),
        Fact(
            "shards",
            f"{len(whole)} of {plan.n_shards}, {size / 2**20:.1f} MiB",
            {"closed": len(whole), "plan": plan.n_shards, "bytes": size},
        ),
        Fact("products", ", ".join(plan.output.products), list(plan.output.products)),
        Fact("poses", f"{plan.poses.kind} of {len(names)}: {clean(', '.join(names))}", names),
        Fact("seed", f"{plan.seed}", plan.seed),
        Fact("made with", clean(json.dumps(device)), dict(manifest.made_with)),
    ]
    missing = [f"{line}; the same command makes it again" for line in faults.values()]
    if not manifest.complete:
        missing.append("shards: the run is not complete")
    return Description(shown(folder), "data set", tuple(facts), (), tuple(missing))


def _shard_faults(folder: Path, manifest: Manifest) -> dict[int, str]:
    """Return the shards that are missing or of another size, without reading them."""
    found = {}
    for number, entry in manifest.shards.items():
        if entry.file is not None:
            fault = shard_fault(folder / entry.file, entry)
            if fault is not None:
                found[number] = f"{clean(entry.file)}: {fault}"
    return found


def _complete_text(complete: bool, aside: int) -> str:
    if not complete:
        return "no"
    return f"yes, but for {aside} set aside" if aside else "yes"


def check_dataset(folder: Path, progress: Progress | None = None) -> CheckReport:
    """Verify a data set by reading all of it.

    Checked are the manifest; every shard by its SHA-256, and that there are no other files; the
    samples of shards and their order; recipes against the plan; labels and axes against the
    recipes; types and shapes; and that numbers are finite, except depth maps, where NaN is no
    depth, and joints that a rig does not have.

    `progress` is called with (done, total) shards.
    """
    checked: list[str] = []
    problems: list[str] = []
    try:
        manifest = read_manifest(folder)
    except ClradarError as error:
        return CheckReport(shown(folder), (), (clean(error),))
    checked.append("manifest: its plan is whole and has no mistakes")
    problems += _missing(manifest) + _foreign_files(folder, manifest)
    before = len(problems)
    for done, number in enumerate(sorted(manifest.shards), start=1):
        entry = manifest.shards[number]
        try:
            problems += _shard_problems(folder, manifest, entry)
        except ClradarError as error:
            problems.append(clean(error))
        if progress is not None:
            progress(done, len(manifest.shards))
    if len(problems) == before:
        stored = sum(entry.samples for entry in manifest.shards.values())
        checked += [
            f"{len(manifest.shards)} shards: SHA-256, format, samples in order",
            f"{stored} samples: recipes as the plan has them, labels and axes as the recipes",
            f"{', '.join(manifest.plan.output.products)}: types, shapes, finite numbers",
        ]
    if manifest.aside:
        samples = listed(sorted(manifest.aside))
        checked.append(f"set aside, with their reasons in the manifest: {samples}")
    return CheckReport(shown(folder), tuple(checked), tuple(problems))


def _missing(manifest: Manifest) -> list[str]:
    if manifest.complete:
        return []
    open_shards = [n for n in range(manifest.plan.n_shards) if n not in manifest.shards]
    return [f"not complete: shards {listed(open_shards)} are missing; the same command resumes"]


def _foreign_files(folder: Path, manifest: Manifest) -> list[str]:
    """Return problems with files in the folders of shards and parts that the manifest lacks."""
    known = {entry.file for entry in manifest.shards.values()}
    found = []
    for path in sorted((folder / SHARDS).glob("*")):
        name = f"{SHARDS}/{path.name}"
        # A shard whose run was killed before it was in the manifest is written again on resume.
        if name not in known and (manifest.complete or path.suffix != ".h5"):
            own = path.match(TEMPORARY)
            found.append(f"{clean(name)}: {LEFT_OVER if own else FOREIGN}")
    for path in sorted((folder / PARTS).glob("*")):
        name = f"{PARTS}/{clean(path.name)}"
        if not (PART_NAME.fullmatch(path.name) or path.match(TEMPORARY)):
            found.append(f"{name}: {FOREIGN}")
        elif manifest.complete:
            found.append(f"{name}: {LEFT_OVER}")
    return found


def _shard_problems(folder: Path, manifest: Manifest, entry: ShardEntry) -> Iterator[str]:
    samples = manifest.plan.shard_samples(entry.number)
    expected = [sample for sample in samples if sample not in manifest.aside]
    if entry.samples != len(expected):
        yield (
            f"shard {entry.number}: expected {len(expected)} samples, got {entry.samples} in the "
            "manifest"
        )
    if entry.file is None:
        return
    path = folder / entry.file
    if not path.is_file():
        yield (
            f"{clean(entry.file)}: expected a shard, got nothing there; the same command makes it "
            "again"
        )
        return
    digest = sha256_of(path)
    if digest != entry.sha256:
        yield (
            f"{clean(entry.file)}: expected SHA-256 {entry.sha256}, got {digest}; delete the file, "
            "and the same command makes it again"
        )
        return
    yield from content_problems(path, entry.file, manifest.plan, expected)
