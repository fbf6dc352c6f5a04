"""Verification and description of data sets: every byte, label and array against the recipes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.folder import SHARDS, Manifest, read_manifest, shard_name, shard_number
from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import VERSION, read_recipe, recipe
from clradar.dataset.shards import (
    EXPECTED,
    FIELDS,
    LABELS,
    axes_of,
    data_bytes,
    fields_of,
    fields_of_products,
    guarded_shard,
    label_values,
    read_confined,
    samples_of,
    stored_recipe,
)
from clradar.errors import ClradarError
from clradar.files.failures import clean, reading, shown
from clradar.jobs.lock import TEMPORARY
from clradar.model.progress import Progress
from clradar.versions import own_version
from measurement_io import CheckReport, Description, Fact

BLOCK_BYTES = 2**28
"""Of an array that is in memory at a time."""

MOST_LISTED = 10
"""Samples listed in a problem."""


def describe_dataset(folder: Path) -> Description:
    """Describe a data set from its manifest and the sizes of its shards, which are not opened."""
    manifest = read_manifest(folder)
    plan = manifest.plan
    names = [pose.name for pose in plan.poses.poses]
    size = sum((folder / shard_name(number)).stat().st_size for number in manifest.shards)
    stored, aside = len(manifest.stored), len(manifest.aside)
    text = f"yes, but for {aside} set aside" if aside else "yes"
    device = manifest.made_with.get("device", {})
    closed = len(manifest.shards)
    shards = f"{closed} of {plan.n_shards}, {size / 2**20:.1f} MiB"
    facts = [
        Fact("samples", f"{stored} of {plan.samples}", {"stored": stored, "plan": plan.samples}),
        Fact("complete", text if manifest.complete else "no", manifest.complete),
        Fact("set aside", f"{aside}", sorted(manifest.aside)),
        Fact("shards", shards, {"closed": closed, "plan": plan.n_shards, "bytes": size}),
        Fact("products", ", ".join(plan.output.products), list(plan.output.products)),
        Fact("poses", f"{plan.poses.kind} of {len(names)}: {clean(', '.join(names))}", names),
        Fact("seed", f"{plan.seed}", plan.seed),
        Fact("made with", clean(json.dumps(device)), dict(manifest.made_with)),
    ]
    return Description(shown(folder), "data set", tuple(facts), (), tuple(_missing(manifest)))


def check_dataset(folder: Path, progress: Progress | None = None) -> CheckReport:
    """Verify a data set by reading all of it.

    Recipes are compared with the plan where this version made them, labels and axes with the
    recipes; numbers have to be finite. `progress` is called with (done, total) shards.
    """
    try:
        manifest = read_manifest(folder)
    except ClradarError as error:
        return CheckReport(shown(folder), (), (clean(error),))
    checked = ["manifest: its plan is whole and has no mistakes"]
    problems = [*_missing(manifest), *_foreign_files(folder)]
    before = len(problems)
    for done, number in enumerate(sorted(manifest.shards), start=1):
        try:
            problems += _shard_problems(folder, manifest, number)
        except ClradarError as error:
            problems.append(f"{clean(error)}; delete the file, and the same command makes it again")
        if progress is not None:
            progress(done, len(manifest.shards))
    if len(problems) == before:
        checked += [
            f"{len(manifest.shards)} shards: checksums, format, samples in order",
            f"{len(manifest.stored)} samples: recipes, labels and axes as the recipes",
            f"{', '.join(manifest.plan.output.products)}: types, shapes, finite numbers",
        ]
    if manifest.aside:
        samples = _listed(sorted(manifest.aside))
        checked.append(f"set aside, with their reasons in the manifest: {samples}")
    return CheckReport(shown(folder), tuple(checked), tuple(problems))


def _missing(manifest: Manifest) -> Iterator[str]:
    if not manifest.complete:
        yield (
            f"not complete: shards {_listed(manifest.missing)} are missing; the same command makes "
            "them"
        )


def _foreign_files(folder: Path) -> Iterator[str]:
    for path in sorted((folder / SHARDS).glob("*")):
        if path.match(TEMPORARY):
            yield f"{SHARDS}/{clean(path.name)}: left over; the same command removes it"
        elif shard_number(path.name) is None:
            yield f"{SHARDS}/{clean(path.name)}: is not of this data set; it can be removed by hand"


def _contents(path: Path) -> dict[str, Any]:
    """Read all of a shard, which verifies its checksums; return it without numbers of arrays."""
    with guarded_shard(path) as file:
        if not samples_of(file):
            return {"samples": []}
        labels, axes = file["entry/labels"], file["entry/axes"]
        return {
            "samples": samples_of(file),
            "labels": {n: labels[n][:] for n in (*LABELS, "made_with") if n in labels},
            "axes": {name: axes[name][:] for name in axes},
            "arrays": {name: _array(file, name) for name in fields_of(file)},
        }


def _array(file: Any, name: str) -> dict[str, Any]:
    """Type and shape of an array, where the samples of a ragged one begin, and rows that have
    numbers that are not finite; of depth maps, whose NaN is no depth, infinite ones."""
    spec = FIELDS[name]
    data = file[spec.place]
    step = max(1, BLOCK_BYTES // max(1, prod(data.shape[1:]) * data.dtype.itemsize))
    invalid: list[int] = []
    for at in range(0, len(data), step):
        block = data[at : at + step]
        block = block.reshape(len(block), -1)
        if block.dtype.kind in "fc":
            wrong = np.isinf(block) if name == "depth_map" else ~np.isfinite(block)
            invalid += (at + np.flatnonzero(wrong.any(axis=1))).tolist()
    first = file[spec.first_place][:] if spec.ragged else None
    return {"dtype": data.dtype.name, "shape": list(data.shape), "first": first, "invalid": invalid}


def _shard_problems(folder: Path, manifest: Manifest, number: int) -> Iterator[str]:
    path, plan = folder / shard_name(number), manifest.plan
    samples = plan.shard_samples(number)
    expected = [sample for sample in samples if sample not in manifest.aside]
    found = read_confined(_contents, path, size=len(samples) * data_bytes(plan))
    with reading(path, EXPECTED):
        for problem in _content_problems(found, plan, expected):
            yield f"{shard_name(number)}: {problem}"


def _content_problems(found: Mapping[str, Any], plan: Plan, samples: list[int]) -> Iterator[str]:
    if found["samples"] != samples:
        yield f"expected the samples {_listed(samples)}, got {_listed(found['samples'])}"
        return
    if not samples:
        return
    labels = found["labels"]
    recipes = [json.loads(text) for text in labels["recipe"]]
    makers = [json.loads(text)["clradar"] for text in labels["made_with"]]
    own = (own_version(), VERSION)
    if other := [
        sample
        for sample, stored, maker in zip(samples, recipes, makers, strict=True)
        if stored["sample"] != sample
        or ((maker, stored["version"]) == own and stored != recipe(plan, sample))
    ]:
        yield f"expected the plan's recipes, got others for the samples {_listed(other)}"
        return
    drawn = [read_recipe(stored_recipe(text, plan)) for text in labels["recipe"]]
    axes = axes_of(drawn[0].plan)
    for label, wanted in label_values(drawn).items():
        if label != "recipe" and not _same(labels.get(label), wanted):
            yield f"labels/{label}: expected the value of the recipes, got another"
    for axis, (values, _) in axes.items():
        if not _same(found["axes"][axis], values):
            yield f"axes/{axis}: expected the values of the recipe, got others"
    fields = fields_of_products(plan.output.products)
    if list(found["arrays"]) != fields:
        yield f"expected the arrays {', '.join(fields)}, got {', '.join(found['arrays'])}"
        return
    sizes = {axis: len(values) for axis, (values, _) in axes.items()}
    for name, array in found["arrays"].items():
        spec, rows, bad = FIELDS[name], len(samples), array["invalid"]
        place = f"{spec.group}/{spec.dataset}"
        if spec.ragged:
            first = array["first"]
            if len(first) != rows + 1 or first[0] != 0 or (np.diff(first) <= 0).any():
                yield f"{place}_first: expected ascending rows of {rows} samples"
                continue
            rows, bad = int(first[-1]), (np.searchsorted(first, bad, side="right") - 1).tolist()
        shape = (rows, *(sizes.get(axis, 3) for axis in spec.axes))
        if tuple(array["shape"]) != shape or array["dtype"] != spec.dtype:
            got = f"{array['dtype']} {tuple(array['shape'])}"
            yield f"{place}: expected {spec.dtype} {shape}, got {got}"
        elif bad and not (name == "joints" and plan.hands.rigs):  # a rig may lack some
            which = _listed(sorted({samples[row] for row in bad}))
            yield f"{place}: expected finite numbers, got others in the samples {which}"


def _same(stored: np.ndarray | None, wanted: Any) -> bool:
    if stored is None:
        return False
    if isinstance(wanted, np.ndarray):
        return stored.dtype == wanted.dtype and stored.tobytes() == wanted.tobytes()
    return [text.decode("utf-8") for text in stored] == list(wanted)


def _listed(numbers: Sequence[int]) -> str:
    more = len(numbers) - MOST_LISTED
    text = ", ".join(map(str, numbers[:MOST_LISTED]))
    return f"{text} and {more} more" if more > 0 else text or "none"
