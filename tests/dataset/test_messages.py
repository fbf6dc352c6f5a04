"""Messages about damaged plans, manifests and pose files: short, printable, counted if several."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from clradar.dataset import PlanError, read_plan
from clradar.dataset.check import check_dataset, describe_dataset
from clradar.dataset.folder import Manifest
from clradar.dataset.plan.plan import plan_from
from clradar.errors import MeasurementError
from clradar.hand import pose_by_name, read_pose, write_pose
from clradar.jobs.outcome import Aside

LONGEST_LINE = 600
"""A path, a key of 80 characters, what was expected, and a quoted value of 200."""

LONG = "x" * 5000
ODD: tuple[Any, ...] = (
    None, "", LONG, "a\nb\n" * 1000, "\x1b[31m\u2028", -1, 2**70, 1e308, float("nan"),
    [], {}, [LONG] * 50, {LONG: 1}, [[None]], [1e308] * 3,
)  # fmt: skip

PLAN: dict[str, Any] = {
    "samples": 4,
    "poses": {"names": ["A", "B"], "kind": "interpolation", "share": {"uniform": [0, 1]}},
    "hands": {"shape": "list", "shapes": [{"length_m": 0.19, "finger_lengths": [1, 1, 1, 1, 1]}]},
    "placement": {"rotation_z_deg": {"normal": [0, 10]}},
    "alpha": {"uniform": [0.1, 0.9]},
    "impairments": {
        "snr_db": 20,
        "channels": {"dead_tx": [1, 2]},
        "walls": [{"point_mm": [0, 0, 900], "normal": [0, 0, -1]}],
    },
    "radar": {"every": 2, "steps": 64},
    "image": {"x_mm": [-50, 50], "step_mm": 2},
    "output": {"products": ["joints", "depth_map"], "shard_size": 2},
}  # fmt: skip
RIG = {"file": "hand.glb", "sha256": "0" * 64, "handedness": "right", "betas": [0.5]}


def altered(value: Any) -> Iterator[Any]:
    """Every copy of a JSON value in which one entry is odd, missing, or under a long key."""
    places = list(_places(value))
    for number, place in enumerate(places):
        # Each value at every seventh place: all of them at all kinds of places, at a bounded cost.
        for odd in ODD[number % 7 :: 7] if len(places) > 60 else ODD[number % 3 :: 3]:
            copied, node = _at(value, place)
            node[place[-1]] = copy.deepcopy(odd)
            yield copied
        copied, node = _at(value, place)
        taken = node.pop(place[-1])
        yield copied
        if isinstance(node, dict):
            copied, node = _at(value, place)
            node[f"{place[-1]}\n{LONG}"] = taken
            yield copied


def _places(value: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    keys = value.keys() if isinstance(value, dict) else range(len(value) * isinstance(value, list))
    for key in keys:
        yield (*above, key)
        if isinstance(value[key], dict | list):
            yield from _places(value[key], (*above, key))


def _at(value: Any, place: tuple[Any, ...]) -> tuple[Any, Any]:
    copied = copy.deepcopy(value)
    node = copied
    for key in place[:-1]:
        node = node[key]
    return copied, node


def assert_short(text: str, lines: int = 1) -> None:
    found = text.split("\n")
    assert len(found) == lines
    for line in found:
        assert len(line) <= LONGEST_LINE
        assert line.isprintable()


def manifest_of(folder: Path, hands: dict[str, Any]) -> dict[str, Any]:
    manifest = Manifest(plan_from(PLAN, "plan.toml", folder), {"clradar": "1"})
    manifest.aside[3] = Aside(3, "why", 2)
    record: dict[str, Any] = json.loads(json.dumps(manifest.record()))
    for pose in record["plan"]["poses"]["resolved"]:
        pose["joints_rad"] = dict(list(pose["joints_rad"].items())[:1])
    record["plan"]["hands"] = hands or record["plan"]["hands"]
    return record


def pose_of(folder: Path) -> dict[str, Any]:
    write_pose(folder / "pose.json", pose_by_name("L"))
    record: dict[str, Any] = json.loads((folder / "pose.json").read_text())
    return record


def read_manifest_of(path: Path) -> None:
    """By the check, which goes on where the manifest is sound, and by the description."""
    report = check_dataset(path.parent)
    for problem in report.problems:
        assert_short(problem)
    if not report.checked:
        raise MeasurementError(report.problems[0])
    describe_dataset(path.parent)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("made", "name", "read"),
    [
        (pose_of, "pose.json", read_pose),
        (
            lambda folder: PLAN,
            "plan.json",
            lambda path: plan_from(json.loads(path.read_text()), path.name, path.parent),
        ),
        (lambda folder: manifest_of(folder, {}), "manifest.json", read_manifest_of),
        (
            lambda folder: manifest_of(folder, {"rigs": [RIG], "handedness": "as it is"}),
            "manifest.json",
            read_manifest_of,
        ),
    ],
    ids=["pose", "plan", "manifest", "rigs"],
)
def test_what_is_odd_anywhere_is_told_shortly(
    tmp_path: Path, made: Any, name: str, read: Any
) -> None:
    (tmp_path / "shards").mkdir()
    (tmp_path / "shards" / "shard-00000.h5").write_bytes(bytes(100))
    record, refused = made(tmp_path), 0
    (tmp_path / name).write_text(json.dumps(record))
    read(tmp_path / name)
    for wrong in altered(record):
        (tmp_path / name).write_text(json.dumps(wrong))
        try:
            read(tmp_path / name)
        except MeasurementError as error:
            assert_short(str(error), len(error.mistakes) + (len(error.mistakes) > 1) or 1)
            refused += 1
    assert refused > 100


@pytest.mark.parametrize("sample", ["1", [1]])
def test_entries_of_a_manifest_that_cannot_be_sorted(tmp_path: Path, sample: Any) -> None:
    record = manifest_of(tmp_path, {})
    record["set_aside"].append({"sample": sample, "reason": "why", "attempts": 1})
    (tmp_path / "manifest.json").write_text(json.dumps(record))
    (problem,) = check_dataset(tmp_path).problems
    assert "manifest.json: expected " in problem
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
