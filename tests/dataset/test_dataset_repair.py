"""Data sets whose files are corrupt or lost: they are made again by the same command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import exit_status
from dataset_plans import DEVICE, LIGHT, Engine, digests, flip_a_bit, light_plan

from clradar.dataset import run
from clradar.dataset.store.check import check_dataset, describe_dataset
from clradar.dataset.store.folder import (
    MANIFEST,
    SUMMARIES,
    Aside,
    DatasetFolder,
    read_manifest,
)
from clradar.errors import ClradarWarning, MeasurementError

pytestmark = [
    pytest.mark.usefixtures("no_contact_sheet"),
    # Tested where it is given; elsewhere only what is made counts.
    pytest.mark.filterwarnings("ignore:.* made again", "ignore:sample . was set aside"),
]


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """A data set with one closed shard and the parts 3 and 4."""
    with pytest.raises(KeyboardInterrupt):
        run(LIGHT, tmp_path / "stopped", engine=Engine(5))
    return tmp_path / "stopped"


def shortened(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def zeroed(path: Path) -> None:
    path.write_bytes(bytes(path.stat().st_size))


def another(path: Path) -> None:
    shutil.copyfile(path.with_name("00000004.h5"), path)


def of_another_plan(path: Path) -> None:
    other = light_plan(seed=4, output={"shard_size": 7, "products": ["joints", "mesh"]})
    folder = path.parent.parent.parent / "other"
    with pytest.raises(KeyboardInterrupt):
        run(other, folder, engine=Engine(4))
    shutil.copyfile(folder / "parts" / path.name, path)


# Shards


@pytest.mark.parametrize("damage", [Path.unlink, shortened, emptied])
def test_a_missing_shard_is_made_again(
    light: Path, light_copy: Path, damage: Callable[[Path], Any]
) -> None:
    damage(light_copy / "shards" / "shard-00001.h5")
    facts = describe_dataset(light_copy)
    assert facts.values["shards"]["closed"] == 2
    assert facts.values["complete"] is False
    assert facts.values["samples"] == {"stored": 4, "plan": 7}
    assert any("shards/shard-00001.h5" in line for line in facts.missing)
    with pytest.warns(ClradarWarning, match=r"shard-00001\.h5.* its samples are made again"):
        assert run(LIGHT, light_copy, device=DEVICE).made == 3
    assert digests(light_copy) == digests(light)


def test_a_sample_that_was_set_aside_stays_so_when_its_shard_is_made_again(tmp_path: Path) -> None:
    run(LIGHT, tmp_path, engine=Engine(aside=(4,)))
    before = digests(tmp_path)
    (tmp_path / "shards" / "shard-00001.h5").unlink()
    result = run(LIGHT, tmp_path, device=DEVICE)
    assert (result.made, result.aside) == (2, (Aside(4, "poisoned", 2),))
    assert digests(tmp_path) == before


@pytest.mark.parametrize("at", [1, 2, 3, 4])
def test_a_kill_while_it_repairs_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    run(LIGHT, tmp_path, engine=Engine(aside=(4,)))
    before = digests(tmp_path)
    shortened(tmp_path / "shards" / "shard-00001.h5")
    write_manifest = DatasetFolder.write_manifest
    calls = []

    def killed(self: DatasetFolder) -> None:
        calls.append(self)
        if len(calls) == at:
            raise KeyboardInterrupt
        write_manifest(self)

    with monkeypatch.context() as patch:
        patch.setattr(DatasetFolder, "write_manifest", killed)
        with pytest.raises(KeyboardInterrupt):
            run(LIGHT, tmp_path, device=DEVICE)
    run(LIGHT, tmp_path, device=DEVICE)
    assert digests(tmp_path) == before


@pytest.mark.parametrize("damage", [None, shortened, flip_a_bit])
def test_a_manifest_without_sizes_is_read_and_its_shards_verified_once(
    light: Path, light_copy: Path, damage: Callable[[Path], None] | None
) -> None:
    record = json.loads((light_copy / MANIFEST).read_text())
    for entry in record["shards"]:
        del entry["size_bytes"]
    (light_copy / MANIFEST).write_text(json.dumps(record))
    if damage is not None:
        damage(light_copy / "shards" / "shard-00001.h5")
    assert run(LIGHT, light_copy, device=DEVICE).made == (0 if damage is None else 3)
    assert digests(light_copy) == digests(light)


def test_the_command_reports_a_shard_made_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(
        "samples = 4\n[poses]\nnames = ['A']\n[hands]\nedge_mm = 4\n"
        "[output]\nproducts = ['joints']\nshard_size = 2\n"
    )

    def called(*arguments: str) -> tuple[str, str]:
        assert exit_status("dataset", plan, "-o", tmp_path / "set", *arguments) == 0
        out, err = capsys.readouterr()
        return out, err

    assert "4 of them made now" in called()[0]
    before = digests(tmp_path / "set")
    (tmp_path / "set" / "shards" / "shard-00000.h5").unlink()
    out, err = called()
    assert "shard-00000.h5: is missing; its samples are made again" in err
    assert "4 of 4 samples, 2 of them made now" in out
    assert digests(tmp_path / "set") == before
    # The advice of inspect --check for a flipped bit: delete the file, and give the command again.
    flip_a_bit(tmp_path / "set" / "shards" / "shard-00001.h5")
    assert "0 of them made now" in called()[0]
    assert "4 of them made now" in called("--force")[0]
    assert digests(tmp_path / "set") == before


def test_force_begins_anew_and_leaves_other_files(light: Path, light_copy: Path) -> None:
    flip_a_bit(light_copy / "shards" / "shard-00001.h5")
    for name in ("mine.tex", "parts/mine.tex", "shards/mine.h5"):
        (light_copy / name).write_text("mine")
    assert run(LIGHT, light_copy, device=DEVICE, force=True).made == 7
    for name in ("mine.tex", "parts/mine.tex", "shards/mine.h5"):
        assert (light_copy / name).read_text() == "mine"
        (light_copy / name).unlink()
    assert digests(light_copy) == digests(light)


# Parts


@pytest.mark.parametrize(
    "damage", [flip_a_bit, shortened, zeroed, emptied, another, of_another_plan]
)
def test_a_part_that_is_damaged_is_made_again(
    light: Path, stopped: Path, damage: Callable[[Path], None]
) -> None:
    damage(stopped / "parts" / "00000003.h5")
    with pytest.warns(ClradarWarning, match=r"parts/00000003\.h5.* sample 3 is made again"):
        assert run(LIGHT, stopped, device=DEVICE).made == 3
    assert digests(stopped) == digests(light)


def test_every_flipped_byte_of_a_part_is_harmless(stopped: Path, light: Path) -> None:
    """Either it is found, or it is where nothing is stored: the shard has the same bytes."""
    part = stopped / "parts" / "00000003.h5"
    content = part.read_bytes()
    other = (stopped / "parts" / "00000004.h5").read_bytes()
    for at in range(100, len(content), len(content) // 6):
        damaged = bytearray(content)
        damaged[at] ^= 0x10
        part.write_bytes(damaged)
        (stopped / "parts" / "00000004.h5").write_bytes(other)
        folder = Path(shutil.copytree(stopped, stopped.parent / f"at-{at}"))
        run(LIGHT, folder, device=DEVICE)
        found, wanted = read_manifest(folder), read_manifest(light)
        assert found.shards[1] == wanted.shards[1], at


def test_a_note_that_is_damaged_is_forgotten(light: Path, stopped: Path) -> None:
    (stopped / "parts" / "00000005.json").write_text("{")
    (stopped / "parts" / "00000006.json").write_text('{"sample": 5, "reason": "", "attempts": 2}')
    assert run(LIGHT, stopped, device=DEVICE).made == 2
    assert digests(stopped) == digests(light)


def test_a_part_that_breaks_meanwhile_is_named(
    stopped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    close_shard = DatasetFolder.close_shard

    def breaking(self: DatasetFolder, number: int) -> None:
        if number == 1 and self.part(5).is_file():
            zeroed(self.part(3))
        close_shard(self, number)

    monkeypatch.setattr(DatasetFolder, "close_shard", breaking)
    with pytest.raises(MeasurementError, match=r"parts/00000003\.h5"):
        run(LIGHT, stopped, device=DEVICE)


def test_foreign_files_in_parts_are_left_alone(light_copy: Path) -> None:
    own, foreign = light_copy / "parts" / "00000001.h5", light_copy / "parts" / "1.csv"
    for path in (own, foreign):
        path.write_bytes(b"")
    problems = check_dataset(light_copy).problems
    assert any("00000001.h5: left over; the same command removes it" in p for p in problems)
    run(LIGHT, light_copy, device=DEVICE)
    assert [path.name for path in (light_copy / "parts").iterdir()] == ["1.csv"]
    (line,) = check_dataset(light_copy).problems
    assert line == "parts/1.csv: is not of this data set; it can be removed by hand"


def test_the_description_counts_samples_set_aside(tmp_path: Path) -> None:
    run(LIGHT, tmp_path, engine=Engine(aside=(4,)))
    text = str(describe_dataset(tmp_path))
    assert "yes, but for 1 set aside" in text
    assert all((tmp_path / name).is_file() for name in SUMMARIES)
