"""Verification of data sets: `clradar inspect`, with and without --check."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from command_line import exit_status
from dataset_plans import DEVICE, LIGHT, flip_a_bit

from clradar.dataset import open_dataset, replay, run
from clradar.dataset.check import check_dataset, describe_dataset
from clradar.dataset.folder import MANIFEST
from clradar.errors import MeasurementError


def test_a_whole_data_set_has_no_problems(made: Path) -> None:
    report = check_dataset(made)
    assert report.ok, report.problems
    assert describe_dataset(made).values["samples"] == {"stored": 5, "plan": 5}


def changed(place: str, value: Any) -> Any:
    """Return a damage: a dataset of shard 1 is changed, and has the checksum of what it is now."""

    def damage(folder: Path) -> None:
        path = folder / "shards" / "shard-00001.h5"
        with h5py.File(path, "r+") as file:
            if isinstance(value, h5py.ExternalLink):
                del file[place]
                file[place] = value
            else:
                file[place][...] = value(file[place][...])

    return damage


def set_aside(**values: Any) -> Any:
    """Return a damage: the manifest says that a sample was set aside."""

    def damage(folder: Path) -> None:
        manifest = json.loads((folder / MANIFEST).read_text())
        manifest["set_aside"] = [{"sample": 2, "reason": "why", "attempts": 2, **values}]
        (folder / MANIFEST).write_text(json.dumps(manifest))

    return damage


def with_nan(array: np.ndarray) -> np.ndarray:
    array[1].flat[0] = np.nan
    return array


OUTSIDE = h5py.ExternalLink("shard-00000.h5", "entry/joints/data")


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: (f / "shards" / "shard-00001.h5").unlink(), "shards 1 are missing"),
        (lambda f: (f / "shards" / "more.h5").write_bytes(b""), "can be removed by hand"),
        (lambda f: (f / "shards" / ".x.tmp").write_bytes(b""), "left over"),
        (lambda f: flip_a_bit(f / "shards" / "shard-00001.h5"), "delete the file, and the same"),
        (lambda f: (f / MANIFEST).write_text("{"), "manifest.json"),
        (lambda f: (f / MANIFEST).unlink(), "manifest.json"),
        (set_aside(sample="2"), "manifest.json: expected an entry"),
        (set_aside(), "expected the samples 3, got 2, 3"),
        (changed("entry/labels/sample", lambda a: a + 1), "expected the samples 2, 3, got 3, 4"),
        (changed("entry/labels/recipe", lambda a: a[::-1]), "recipes, got others for the samples"),
        (changed("entry/labels/alpha", lambda a: a + 0.1), "labels/alpha: expected the value"),
        (changed("entry/labels/pose", lambda a: a[::-1]), "labels/pose: expected the value"),
        (changed("entry/axes/x_m", lambda a: a + 0.001), "axes/x_m: expected the values"),
        (changed("entry/capture/data", with_nan), "finite numbers, got others in the samples 3"),
        (changed("entry/joints/data", with_nan), "joints/data: expected finite"),
        (changed("entry/joints/data", OUTSIDE), "shard-00001.h5"),
    ],
)
def test_damage_is_found(copy: Path, damage: Any, words: str) -> None:
    damage(copy)
    report = check_dataset(copy)
    assert not report.ok
    assert any(words in line for line in report.problems), report.problems


def test_replay_reads_nothing_outside_the_shard(copy: Path) -> None:
    changed("entry/joints/data", OUTSIDE)(copy)
    with pytest.raises(MeasurementError, match=r"shard-00001\.h5"):
        replay(copy, 3, device=DEVICE)


def test_an_incomplete_data_set_is_reported(
    faults: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faults({4: "stop"})
    with pytest.raises(KeyboardInterrupt):
        run(LIGHT, tmp_path, device=DEVICE)
    for arguments, status in (
        (["inspect", str(tmp_path)], 0),
        (["inspect", str(tmp_path), "--check"], 1),
    ):
        assert exit_status(*arguments) == status
    out, err = capsys.readouterr()
    assert "samples    3 of 7" in out
    assert "not complete: shards 1, 2 are missing" in out
    assert "1 problem found" in err
    assert len(open_dataset(tmp_path).sample) == 3


def test_inspect_of_an_empty_folder_mentions_data_sets(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_status("inspect", tmp_path) == 1
    assert "nor is it a data set, which has manifest.json" in capsys.readouterr().err
