"""Messages about damaged plans, manifests and pose files: short, printable, counted if several."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import pytest

from clradar.dataset import PlanError, read_plan
from clradar.dataset.check import check_dataset
from clradar.dataset.folder import Manifest
from clradar.dataset.plan.plan import plan_from
from clradar.errors import MeasurementError

LONGEST_LINE = 600
"""A path, a key of 80 characters, what was expected, and a quoted value of 200."""

LONG = "x" * 5000
PLAN: dict[str, Any] = {"samples": 4, "poses": {"names": ["A", "B"]}}


def assert_short(text: str) -> None:
    for line in text.split("\n"):
        assert len(line) <= LONGEST_LINE
        assert line.isprintable()


@pytest.mark.parametrize(
    "odd", [LONG, "a\nb\n" * 1000, "\x1b[31m\u2028", {f"k\n{LONG}": 1}, [LONG] * 9]
)
@pytest.mark.parametrize("key", ["samples", "poses", "alpha", "output", "impairments"])
def test_what_is_odd_is_told_shortly(odd: Any, key: str) -> None:
    with pytest.raises(PlanError) as caught:
        plan_from({**PLAN, key: odd}, "plan.toml", Path())
    assert_short(str(caught.value))


@pytest.mark.parametrize("sample", ["1", [1]])
def test_entries_of_a_manifest_that_cannot_be_sorted(tmp_path: Path, sample: Any) -> None:
    record = Manifest(plan_from(PLAN, "plan.toml", tmp_path), {"clradar": "1"}).record()
    record["set_aside"] = [{"sample": own, "reason": "why", "attempts": 1} for own in (3, sample)]
    (tmp_path / "manifest.json").write_text(json.dumps(record))
    (problem,) = check_dataset(tmp_path).problems
    assert "manifest.json: set_aside[1].sample: expected a whole number" in problem
    assert "TypeError" not in problem


def test_several_mistakes_are_counted_and_not_all_listed(tmp_path: Path) -> None:
    one = {"samples": 2, "poses": {"names": ["A"]}, "alpha": 2}
    many = {**one, **{f"key{i}": 1 for i in range(40)}}
    with pytest.raises(PlanError) as caught:
        plan_from(many, "plan.toml", tmp_path)
    lines = str(caught.value).splitlines()
    assert lines[0] == "41 mistakes, one per line:"
    assert lines[-1] == "and 21 more"
    assert (len(lines), len(caught.value.mistakes)) == (22, 41)
    again = pickle.loads(pickle.dumps(caught.value))
    assert again.mistakes == caught.value.mistakes


def test_a_plan_file_with_long_keys(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(f'samples = 1\nposes.names = "letters"\n[{LONG}]\n{LONG} = 1\n')
    with pytest.raises(MeasurementError) as caught:
        read_plan(path)
    assert_short(str(caught.value))
