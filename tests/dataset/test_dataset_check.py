"""Verification of data sets: `clradar inspect`, with and without --check."""

import json
import os

import h5py
import numpy as np
import pytest
from command_line import exit_status
from dataset_plans import DEVICE, LIGHT, flip_a_bit

from clradar.dataset import open_dataset, run
from clradar.dataset.check import check_dataset, describe_dataset
from clradar.dataset.folder import MANIFEST

SHARD = "shards/shard-00001.h5"


def test_a_whole_data_set_has_no_problems(light):
    report = check_dataset(light)
    assert report.ok, report.problems
    assert "shards: 3, 3 by their SHA-256: samples in order" in report.checked
    assert describe_dataset(light).values["samples"] == {"stored": 7, "plan": 7}


def manifest(**values):
    """Return a damage: some values of the manifest are others."""

    def damage(folder):
        content = json.loads((folder / MANIFEST).read_text())
        (folder / MANIFEST).write_text(json.dumps({**content, **values}))

    return damage


def changed(place, value):
    """Return a damage: an array of shard 1 is changed or gone, and the manifest has no SHA-256."""

    def damage(folder):
        manifest(sha256={})(folder)
        with h5py.File(folder / SHARD, "r+") as file:
            if value is None:
                del file[place]
            else:
                file[place][...] = value(file[place][...])

    return damage


def with_nan(array):
    array[1].flat[0] = np.nan
    return array


def unknown(damage):
    """Return a damage of a shard without a SHA-256."""
    return lambda folder: (manifest(sha256={})(folder), damage(folder))


ASIDE = {"sample": 3, "reason": "why", "attempts": 2}


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: (f / SHARD).unlink(), "shards 1 are missing"),
        (lambda f: (f / "shards" / "more.h5").write_bytes(b""), "can be removed by hand"),
        (lambda f: (f / "shards" / ".x.tmp").write_bytes(b""), "left over"),
        (lambda f: flip_a_bit(f / SHARD), "shard-00001.h5: expected the SHA-256"),
        (unknown(lambda f: os.truncate(f / SHARD, 5000)), "delete the file, and the same"),
        (lambda f: (f / MANIFEST).write_text("{"), "manifest.json"),
        (lambda f: (f / MANIFEST).unlink(), "manifest.json"),
        (manifest(clradar_version=3), "expected version 2 or older, got 3; update clradar"),
        (manifest(plan={"samples": 0}), "manifest.json: samples: expected a whole number"),
        (manifest(set_aside=[{**ASIDE, "sample": "2"}]), "set_aside[0].sample: expected a whole"),
        (manifest(set_aside=[ASIDE]), "expected the samples 4, 5, got 3, 4, 5"),
        (changed("entry/labels/sample", lambda a: a + 1), "the samples 3, 4, 5, got 4, 5, 6"),
        (changed("entry/labels/alpha", None), "labels/alpha: expected one for each sample"),
        (changed("entry/joints/data", with_nan), "joints: expected finite numbers"),
        (changed("entry/joints/data", None), "shard-00001.h5: expected a shard of a data set"),
        (changed("entry/mesh/vertices", with_nan), "mesh_vertices: expected finite"),
    ],
)
def test_damage_is_found(light_copy, damage, words):
    damage(light_copy)
    report = check_dataset(light_copy)
    assert not report.ok
    assert any(words in line for line in report.problems), report.problems


def test_an_incomplete_data_set_is_reported(faults, tmp_path, capsys):
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
