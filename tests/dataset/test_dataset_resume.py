"""Runs that go on where others stopped, and what they refuse."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from dataset_plans import (
    DEVICE,
    LIGHT,
    Engine,
    digests,
    light_plan,
    plan_of,
)

from clradar.dataset import open_dataset, run
from clradar.dataset.store.check import check_dataset
from clradar.dataset.store.folder import (
    CONTACT_SHEET,
    MANIFEST,
    Aside,
    DatasetFolder,
    read_manifest,
)
from clradar.errors import ClradarWarning, ModelError, OutputError

pytestmark = pytest.mark.usefixtures("no_contact_sheet")


def test_a_stopped_run_resumes_with_the_missing_samples(light: Path, tmp_path: Path) -> None:
    for stop in (0, 3, 5):
        folder = tmp_path / f"stopped-{stop}"
        first, second = Engine(stop), Engine()
        with pytest.raises(KeyboardInterrupt):
            run(LIGHT, folder, engine=first)
        assert not (folder / CONTACT_SHEET).exists()
        # What a killed process was writing.
        (folder / "parts" / ".00000003.h5.abc.tmp").write_bytes(b"half")
        (folder / "shards" / ".shard-00001.h5.abc.tmp").write_bytes(b"half")
        run(LIGHT, folder, engine=second)
        assert sorted(first.made + second.made) == list(range(7))
        assert digests(folder) == digests(light)


@pytest.mark.parametrize("step", ["assemble", "write_manifest", "_remove_parts"])
def test_a_kill_while_a_shard_is_closed_loses_nothing(
    light: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    write_manifest = DatasetFolder.write_manifest

    def killed(*args: Any, **kwargs: Any) -> None:
        if step == "write_manifest" and not args[0].manifest.shards:
            write_manifest(args[0])  # that of the new data set
            return
        raise KeyboardInterrupt

    first, second = Engine(), Engine()
    with monkeypatch.context() as patch:
        if step == "assemble":
            patch.setattr("clradar.dataset.store.folder.assemble", killed)
        else:
            patch.setattr(DatasetFolder, step, killed)
        with pytest.raises(KeyboardInterrupt):
            run(LIGHT, tmp_path / "killed", engine=first)
    run(LIGHT, tmp_path / "killed", engine=second)
    assert sorted(first.made + second.made) == list(range(7))
    assert digests(tmp_path / "killed") == digests(light)


def test_a_data_set_is_complete_without_samples_that_fail(tmp_path: Path) -> None:
    # A whole shard, and one of another.
    with pytest.warns(ClradarWarning, match="was set aside after 2 attempts: poisoned") as caught:
        result = run(LIGHT, tmp_path, engine=Engine(aside=(0, 1, 2, 4)))
    assert [str(w.message).split()[1] for w in caught] == ["0", "1", "2", "4"]
    assert [aside.sample for aside in result.aside] == [0, 1, 2, 4]
    assert read_manifest(tmp_path).aside[4] == Aside(4, "poisoned", 2)
    report = check_dataset(tmp_path)
    assert report.ok
    assert "set aside, with their reasons in the manifest: 0, 1, 2, 4" in report.checked
    assert open_dataset(tmp_path).sample.values.tolist() == [3, 5, 6]
    with pytest.warns(ClradarWarning, match="was set aside"):
        assert run(LIGHT, tmp_path, device=DEVICE).aside == result.aside


def test_a_starved_sample_is_warned_of_once_the_data_set_is_there(tmp_path: Path) -> None:
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
    assert read_manifest(tmp_path).complete


class FullDisk(Engine):
    """The disk is full after some samples."""

    def __init__(self, samples: int) -> None:
        super().__init__()
        self.samples = samples

    def outcomes(self, samples: Sequence[int], make: Any) -> Iterator[Any]:
        yield from super().outcomes(samples[: self.samples], make)
        raise OutputError("the disk is full")


def test_a_run_that_fails_leaves_what_it_can_resume_with(light: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    with pytest.raises(OutputError, match="disk is full"):
        run(LIGHT, folder, engine=FullDisk(4))
    assert ".lock" not in {path.name for path in folder.iterdir()}
    run(LIGHT, folder, engine=Engine())
    assert digests(folder) == digests(light)


def test_a_run_that_makes_nothing_leaves_nothing(light_copy: Path, tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in light_copy.rglob("*")}
    engine = FullDisk(0)
    with pytest.raises(OutputError, match="disk is full"):
        run(LIGHT, tmp_path / "new" / "set", engine=engine)
    assert not (tmp_path / "new" / "set").exists()
    with pytest.raises(OutputError, match="another plan"):
        run(light_plan(seed=4), light_copy, engine=engine)
    rig = {"file": "none.glb", "handedness": "left", "sha256": 64 * "0"}
    with pytest.raises(ModelError, match=r"none\.glb"):
        run(
            light_plan(hands={"shape": "default", "rigs": [rig]}),
            light_copy,
            engine=engine,
            force=True,
        )
    assert {path: path.stat().st_mtime_ns for path in light_copy.rglob("*")} == before


def test_another_plan_is_one_error_unless_forced(light_copy: Path) -> None:
    other = light_plan(seed=4, samples=4)
    with pytest.raises(OutputError, match="another plan: seed 3, now 4; samples 7, now 4"):
        run(other, light_copy, device=DEVICE)
    (light_copy / "thesis.tex").write_text("mine")
    assert run(other, light_copy, device=DEVICE, force=True).made == 4
    assert check_dataset(light_copy).ok
    assert (light_copy / "thesis.tex").read_text() == "mine"


def test_what_differs_is_named_down_to_its_key(light_copy: Path) -> None:
    manifest = json.loads((light_copy / MANIFEST).read_text())
    rig = {"file": "/somewhere/" + 80 * "a" + "/one.glb", "handedness": "left", "sha256": 64 * "0"}
    manifest["plan"]["hands"] |= {"shape": "default", "rigs": [rig, rig]}
    (light_copy / MANIFEST).write_text(json.dumps(manifest))
    rigs = [rig, {**rig, "sha256": 64 * "1"}]
    hands = {"shape": "default", "rigs": rigs}
    with pytest.raises(OutputError, match=r"another plan: hands.rigs\[1\].sha256 0+…, now 1+…\. "):
        run(light_plan(hands=hands), light_copy, device=DEVICE)
    rigs[1] = {**rig, "file": rig["file"].replace("one", "two")}
    with pytest.raises(OutputError, match=r"rigs\[1\].file …a+/one.glb, now …a+/two.glb\. "):
        run(light_plan(hands=hands), light_copy, device=DEVICE)
    rigs.pop()
    with pytest.raises(OutputError, match=r"another plan: hands.rigs of 2, now of 1\. "):
        run(light_plan(hands=hands), light_copy, device=DEVICE)


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match=r"holds files \(.*thesis.tex"):
        run(LIGHT, tmp_path, device=DEVICE)
