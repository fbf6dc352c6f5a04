"""Verification of shards and parts against the plan, and of notes on samples set aside."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.plan.plan import Plan
from clradar.dataset.plan.recipe import EARLIER_SETTINGS, recipe
from clradar.dataset.store.confined_reader import ArrayContents, ShardContents, read_contents
from clradar.dataset.store.shard_reader import EXPECTED
from clradar.dataset.store.shard_schema import (
    FIELDS,
    Field,
    axes_of,
    data_bytes,
    fields_of_products,
    label_values,
)
from clradar.errors import MeasurementError
from clradar.files.failures import fail, reading, shown
from clradar.files.json_file import read_json_object

MOST_LISTED = 10
"""Samples listed in a problem."""


def check_part(path: Path, plan: Plan, sample: int) -> None:
    """Verify a part; reading all of it verifies its checksums.

    Raises
    ------
    MeasurementError
        Damaged, or not this sample of this plan.
    """
    for problem in content_problems(path, shown(path), plan, [sample]):
        raise MeasurementError(problem)


def content_problems(path: Path, name: str, plan: Plan, samples: list[int]) -> Iterator[str]:
    """Read all of a shard or part in a confined process, and yield what differs from the plan.

    The file is called `name` in problems; `samples` are the expected ones, in order.

    Raises
    ------
    MeasurementError
        It cannot be read.
    """
    recipes = [recipe(plan, sample) for sample in samples]
    contents = read_contents(path, len(samples) * data_bytes(recipes[0]))
    with reading(path, EXPECTED):
        for problem in _problems(contents, plan, samples, recipes):
            yield f"{name}: {problem}"


def _problems(
    contents: ShardContents, plan: Plan, expected: list[int], recipes: list[dict[str, Any]]
) -> Iterator[str]:
    found = contents.labels["sample"].tolist()
    if found != expected:
        yield f"expected the samples {listed(expected)}, got {listed(found)}"
        return
    stored = [_of_its_time(json.loads(text)) for text in contents.labels["recipe"]]
    other = [s for s, one, two in zip(expected, recipes, stored, strict=True) if one != two]
    if other:
        yield f"expected the plan's recipes, got others for the samples {listed(other)}"
        return
    for label, wanted in label_values(recipes).items():
        if label not in contents.labels or not _same(contents.labels[label], wanted):
            yield f"labels/{label}: expected the value of the recipes, got another"
    axes = axes_of(recipes[0])
    for axis, wanted_axis in axes.items():
        if not _same(contents.axes[axis], wanted_axis.values):
            yield f"axes/{axis}: expected the values of the recipe, got others"
    wanted_fields = fields_of_products(plan.output.products)
    if list(contents.arrays) != wanted_fields:
        got = ", ".join(contents.arrays)
        yield f"expected the arrays {', '.join(wanted_fields)}, got {got}"
        return
    sizes = {axis: len(value.values) for axis, value in axes.items()}
    for field, array in contents.arrays.items():
        if plan.hands.rigs and field == "joints":  # a rig does not have all of them
            array = replace(array, invalid=[])
        problem = _array_problem(array, FIELDS[field], expected, sizes)
        if problem is not None:
            yield f"{FIELDS[field].group}/{FIELDS[field].dataset}{problem}"


def _of_its_time(stored: dict[str, Any]) -> dict[str, Any]:
    return stored | {"simulation": {**EARLIER_SETTINGS, **stored["simulation"]}}


def _array_problem(
    array: ArrayContents, spec: Field, expected: Sequence[int], sizes: dict[str, int]
) -> str | None:
    rest = tuple(sizes.get(axis, 3) for axis in spec.axes)
    rows = len(expected)
    first = array.first
    if first is not None:
        rows = int(first[-1])
        if len(first) != len(expected) + 1 or first[0] != 0 or (np.diff(first) <= 0).any():
            return f"_first: expected ascending rows of {len(expected)} samples"
    if tuple(array.shape) != (rows, *rest) or array.dtype != spec.dtype:
        wanted = f"{spec.dtype} {(rows, *rest)}"
        return f": expected {wanted}, got {array.dtype} {tuple(array.shape)}"
    if not array.invalid:
        return None
    bad = array.invalid
    if first is not None:
        bad = (np.searchsorted(first, bad, side="right") - 1).tolist()
    which = listed(sorted({expected[row] for row in bad}))
    return f": expected finite numbers, got others in the samples {which}"


def _same(stored: np.ndarray, wanted: Any) -> bool:
    if isinstance(wanted, np.ndarray):
        return stored.dtype == wanted.dtype and stored.tobytes() == wanted.tobytes()
    return [text.decode("utf-8") for text in stored] == list(wanted)


def listed(numbers: Sequence[int]) -> str:
    more = len(numbers) - MOST_LISTED
    text = ", ".join(map(str, numbers[:MOST_LISTED]))
    return f"{text} and {more} more" if more > 0 else text or "none"


def check_note(path: Path, sample: int) -> None:
    """Verify a note on why a sample was set aside.

    Raises
    ------
    MeasurementError
        Damaged, or of another sample.
    """
    record = read_json_object(path)
    with reading(path, "why a sample was set aside"):
        if record["sample"] != sample or set(record) != {"sample", "reason", "attempts"}:
            fail(path, f"why sample {sample} was set aside", "something else")
