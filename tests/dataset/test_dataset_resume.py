"""Runs that go on where others stopped, that repair, and what they refuse."""

from pathlib import Path

import command_line
import pytest
from dataset_plans import DEVICE, LIGHT, digests, light_file, light_plan, plan_of
from nightly import nightly

from clradar.dataset import open_dataset, run
from clradar.dataset.check import check_dataset, describe_dataset
from clradar.dataset.folder import CONTACT_SHEET, read_manifest
from clradar.errors import ClradarWarning, ModelError, OutputError
from clradar.jobs.outcome import ATTEMPTS, Aside

pytestmark = [
    pytest.mark.usefixtures("quick_runs"),
    # Tested where it is given; elsewhere only what is made counts.
    pytest.mark.filterwarnings("ignore:.* made again", "ignore:sample . was set aside"),
]

POISONED = Aside(4, "ValueError: sample 4 is poisoned", ATTEMPTS)


@pytest.mark.parametrize("stop", [2, *nightly([0, 4, 6])])
def test_a_stopped_run_resumes_with_the_missing_shards(light, faults, tmp_path, stop):
    folder = tmp_path / "set"
    faults({stop: "stop"})
    with pytest.raises(KeyboardInterrupt):
        run(LIGHT, folder, device=DEVICE)
    assert not (folder / CONTACT_SHEET).exists()
    (folder / "shards" / ".shard-00001.h5.abc.tmp").mkdir()  # what a killed process was writing
    faults({})
    assert run(LIGHT, folder, device=DEVICE).made == 7 - stop // 3 * 3
    assert digests(folder) == digests(light)


def test_a_kill_between_a_shard_and_the_manifest_loses_nothing(faults, tmp_path, monkeypatch):
    faults({1: "raise"})
    run(LIGHT, tmp_path / "whole", device=DEVICE)

    def killed(*args):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("clradar.dataset.runs.write_manifest", killed)
        with pytest.raises(KeyboardInterrupt):
            run(LIGHT, tmp_path / "killed", device=DEVICE)
    assert read_manifest(tmp_path / "killed").aside == {}
    faults({})
    run(LIGHT, tmp_path / "killed", device=DEVICE)
    assert digests(tmp_path / "killed") == digests(tmp_path / "whole")


def test_what_fails_is_set_aside_and_tried_again_on_request(light, faults, tmp_path, capsys):
    folder, aside = tmp_path / "set", [0, 1, 2, 4]  # a whole shard, and one of another
    faults(dict.fromkeys(aside, "raise"))
    with pytest.warns(ClradarWarning, match="was set aside after 2 attempts: Value") as caught:
        result = run(LIGHT, folder, device=DEVICE)
    assert [int(str(w.message).split()[1]) for w in caught] == aside
    assert (result.made, [one.sample for one in result.aside]) == (3, aside)
    assert read_manifest(folder).aside[4] == POISONED
    report = check_dataset(folder)
    assert report.ok, report.problems
    assert "set aside, with their reasons in the manifest: 0, 1, 2, 4" in report.checked
    assert "yes, but for 4 set aside" in str(describe_dataset(folder))
    assert (folder / CONTACT_SHEET).is_file()
    assert open_dataset(folder).sample.values.tolist() == [3, 5, 6]
    faults({})
    again = run(LIGHT, folder, device=DEVICE)
    assert (again.made, again.aside) == (0, result.aside)
    retry = ("dataset", light_file(tmp_path), "-o", folder, "--retry", "--device", DEVICE)
    faults({4: "raise"})
    status, _, err = command_line.run(capsys, *retry)
    assert status == 1
    assert "sample 4 was set aside after 2 attempts: ValueError: sample 4" in err
    assert "1 sample set aside; --retry tries again" in err
    faults({})
    assert command_line.run(capsys, *retry)[::2] == (0, "")
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
