"""Runs that go on where others stopped or were killed, and what is found to be damaged."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import psutil
import pytest
from command_line import exit_status
from dataset_plans import DEVICE, LIGHT, digests, flip_a_bit, light_file, light_plan, plan_of
from interrupted import interrupted_at
from nightly import nightly

from clradar.dataset import open_dataset, run, runs
from clradar.dataset.folder import (
    MANIFEST,
    check_dataset,
    describe_dataset,
    read_manifest,
)
from clradar.errors import ClradarWarning, ModelError, OutputError

pytestmark = [
    pytest.mark.usefixtures("quick_runs"),
    # Tested where it is given; elsewhere only what is made counts.
    pytest.mark.filterwarnings("ignore:.* made again", "ignore:sample . was set aside"),
]

SHARD = "shards/shard-00001.h5"


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
        (lambda f: flip_a_bit(f / SHARD), "shard-00001.h5: expected the SHA-256"),
        (unknown(lambda f: os.truncate(f / SHARD, 5000)), "delete the file, and the same"),
        (lambda f: (f / MANIFEST).write_text("{"), "manifest.json"),
        (lambda f: (f / MANIFEST).unlink(), "manifest.json"),
        (manifest(clradar_version=3), "expected version 2 or older, got 3; update clradar"),
        (manifest(plan={"samples": 0}), "manifest.json: samples: expected a whole number"),
        (
            manifest(set_aside=[{**ASIDE, "sample": "2"}]),
            "set_aside[0].sample: expected a valid integer",
        ),
        (manifest(set_aside=[ASIDE]), "expected the samples 4, 5, got 3, 4, 5"),
        (changed("sample", lambda a: a + 1), "the samples 3, 4, 5, got 4, 5, 6"),
        (changed("alpha", None), "alpha: expected one for each sample"),
        (changed("joints", with_nan), "joints: expected finite numbers"),
        (changed("joints", None), "shard-00001.h5: expected a shard of a data set"),
        (changed("mesh/4/vertices", with_nan), "mesh_vertices: expected finite"),
    ],
)
def test_damage_is_found(light_copy, damage, words):
    damage(light_copy)
    report = check_dataset(light_copy)
    assert not report.ok
    assert any(words in line for line in report.problems), report.problems


@pytest.mark.parametrize("stop", [2, 4, *nightly([0, 6])])
def test_a_stopped_run_is_reported_and_resumes_with_the_missing_shards(
    light, faults, tmp_path, capsys, stop
):
    folder = tmp_path / "set"
    faults({stop: "stop"})
    with pytest.raises(KeyboardInterrupt):
        run(LIGHT, folder, device=DEVICE)
    if stop == 4:
        assert [exit_status("inspect", folder, *more) for more in ([], ["--check"])] == [0, 1]
        out, err = capsys.readouterr()
        assert "samples    3 of 7" in out
        assert "not complete: shards 1, 2 are missing" in out
        assert "1 problem found" in err
        assert len(open_dataset(folder).sample) == 3
    (folder / "shards" / ".shard-00001.h5.abc.tmp").mkdir()  # what a killed process was writing
    faults({})
    assert run(LIGHT, folder, device=DEVICE).made == 7 - stop // 3 * 3
    assert digests(folder) == digests(light)


def test_a_kill_between_a_shard_and_the_manifest_loses_nothing(faults, tmp_path):
    faults({1: "raise"})
    run(LIGHT, tmp_path / "whole", device=DEVICE)
    with interrupted_at(runs, "write_manifest"), pytest.raises(KeyboardInterrupt):
        run(LIGHT, tmp_path / "killed", device=DEVICE)
    assert read_manifest(tmp_path / "killed").aside == {}
    faults({})
    run(LIGHT, tmp_path / "killed", device=DEVICE)
    assert digests(tmp_path / "killed") == digests(tmp_path / "whole")


@pytest.mark.parametrize("again", ["--retry", "--force"])
def test_what_fails_is_set_aside_and_tried_again_on_request(cli, light, faults, again):
    folder, aside = Path("set"), [0, 1, 2, 4]  # a whole shard, and one of another
    faults(dict.fromkeys(aside, "raise"))
    with pytest.warns(ClradarWarning, match="was set aside after 2 attempts: Value") as caught:
        result = run(LIGHT, folder, device=DEVICE)
    assert [int(str(w.message).split()[1]) for w in caught] == aside
    assert (result.made, [one.sample for one in result.aside]) == (3, aside)
    assert read_manifest(folder).aside[4].reason == "ValueError: sample 4 is poisoned"
    report = check_dataset(folder)
    assert report.ok, report.problems
    assert "set aside, with their reasons in the manifest: 0, 1, 2, 4" in report.checked
    assert "yes, but for 4 set aside" in str(describe_dataset(folder))
    assert open_dataset(folder).sample.values.tolist() == [3, 5, 6]
    faults({})
    assert run(LIGHT, folder, device=DEVICE) == runs.RunResult(0, 7, result.aside)
    retry = f"dataset {light_file(Path())} -o set {again}"
    faults({4: "raise"})
    status, _, err = cli(retry)
    assert status == 1
    assert "sample 4 was set aside after 2 attempts: ValueError: sample 4" in err
    assert "1 sample set aside; --retry tries again" in err
    faults({})
    assert cli(retry)[::2] == (0, "")
    assert digests(folder) == digests(light)


def test_a_starved_sample_is_warned_of_once_the_data_set_is_there(tmp_path):
    starved = plan_of(
        samples=2,
        simulation={"samples_per_mm2": 1e-6},
        impairments=None,
        image=None,
        output={"products": ["capture"]},
    )
    text = r"2 of 2 samples are probably not as intended, as sample 0: .*no ray"
    with pytest.warns(ClradarWarning, match=text) as caught:
        assert run(starved, tmp_path, device=DEVICE).made == 2
    assert len(caught) == 1
    assert not read_manifest(tmp_path).missing


def test_a_run_that_makes_nothing_leaves_nothing(light_copy, faults, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in light_copy.rglob("*")}
    faults({0: "full"})
    with pytest.raises(OutputError, match="No space left"):
        run(LIGHT, tmp_path / "new" / "set", device=DEVICE)
    assert not (tmp_path / "new" / "set").exists()
    rig = {"file": "none.glb", "handedness": "left", "sha256": 64 * "0"}
    other = light_plan(hands={"shape": "default", "rigs": [rig]})
    with pytest.raises(ModelError, match=r"none\.glb"):
        run(other, light_copy, device=DEVICE, force=True)
    assert {path: path.stat().st_mtime_ns for path in light_copy.rglob("*")} == before


def test_another_plan_is_one_error_unless_forced(light_copy):
    other = light_plan(seed=4, samples=4)
    with pytest.raises(OutputError, match="other settings: seed 3, now 4; samples 7, now 4"):
        run(other, light_copy, device=DEVICE)
    (light_copy / "thesis.tex").write_text("mine")
    assert run(other, light_copy, device=DEVICE, force=True).made == 4
    assert check_dataset(light_copy).ok
    assert (light_copy / "thesis.tex").read_text() == "mine"


def shortened(path):
    path.write_bytes(path.read_bytes()[:-1000])


def with_other_samples(path):
    path.write_bytes(path.with_name("shard-00000.h5").read_bytes())


@pytest.mark.parametrize("damage", [Path.unlink, with_other_samples, *nightly([shortened])])
def test_a_missing_shard_is_made_again(light, light_copy, damage):
    path = light_copy / "shards" / "shard-00001.h5"
    damage(path)
    facts = describe_dataset(light_copy)
    if not path.exists():
        assert facts.values["shards"]["closed"] == 2
        assert facts.values["complete"] is False
        assert facts.values["samples"] == {"stored": 4, "plan": 7}
        assert "shards 1 are missing" in facts.missing[0]
        assert run(LIGHT, light_copy, device=DEVICE).made == 3
    else:
        assert not check_dataset(light_copy).ok
        with pytest.warns(ClradarWarning, match=r"shard-00001\.h5.* its samples are made again"):
            assert run(LIGHT, light_copy, device=DEVICE).made == 3
    assert digests(light_copy) == digests(light)
    report = check_dataset(light_copy)
    assert report.ok, report.problems
    assert "shards: 3, 3 by their SHA-256: samples in order" in report.checked


MANY = 150
KILLS = int(os.environ.get("CLRADAR_TEST_KILLS", "25"))
SEED = int(os.environ.get("CLRADAR_TEST_KILLS_SEED", "1"))
LIMIT_S = 1800.0  # of waits for events that always come, on a machine however busy


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    output = {"shard_size": 2, "products": ["capture", "max_projection", "joints", "mesh"]}
    return light_file(folder, samples=MANY, output=output, radar={"every": 32, "steps": 4})


@pytest.fixture(scope="module")
def undisturbed(plan_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed") / "set"
    subprocess.run(command(plan_file, folder), check=True)
    return digests(folder)


def command(plan_file, folder, *more):
    start = [sys.executable, "-m", "clradar", "dataset", str(plan_file), "-o", str(folder)]
    return [*start, "--device", "pocl", *more]


@pytest.mark.slow
def test_kills_at_random_moments_change_no_byte(plan_file, undisturbed, tmp_path):
    draw = random.Random(SEED)
    folder, done = tmp_path / "set", 0
    while done < KILLS:
        left = {*folder.glob("shards/.*.tmp")}  # by what was killed before
        process = subprocess.Popen(  # in a process group of its own
            command(plan_file, folder, "--workers", "2"), text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        begun = draw.random() < 0.8
        # Until a shard is being made; else while everything starts.
        while begun and process.poll() is None and {*folder.glob("shards/.*.tmp")} <= left:
            time.sleep(0.01)
        time.sleep(draw.uniform(0.0, 4.0))
        victim = draw.choice(["client", "group", "worker", "interrupt"])
        children = psutil.Process(process.pid).children(True) if process.poll() is None else []
        workers = [c for c in children if victim == "worker" and "spawn_main" in str(c.cmdline())]
        if workers and process.poll() is None:
            draw.choice(workers).kill()
            done += 1
            time.sleep(draw.uniform(0.0, 6.0))
        if process.poll() is None:
            if victim == "interrupt":
                os.killpg(process.pid, signal.SIGINT)
                said = process.communicate(timeout=LIMIT_S)[1]
                if begun:  # Python itself has to start before it can report
                    assert process.returncode in (0, 130)
                    assert "Traceback" not in said, said
            elif victim == "group":
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
            done += 1
        process.communicate()
        _, alive = psutil.wait_procs(children, timeout=LIMIT_S)
        assert not alive, "workers outlived their client"
        if process.returncode == 0:
            assert digests(folder) == undisturbed
            folder = folder.with_name(f"set-{done}")
    subprocess.run(command(plan_file, folder), check=True)
    assert digests(folder) == undisturbed
