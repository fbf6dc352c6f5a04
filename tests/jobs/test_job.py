"""Folders of long work: what they resume, refuse and leave; and batches over several devices."""

import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from systems import posix_only
from two_devices import N, findings_of

from clradar import ClradarWarning, DeviceError, MeasurementError, ModelError, OutputError
from clradar.cli.commands import lists
from clradar.errors import handled_warnings, warn
from clradar.files.atomic import write_file
from clradar.jobs import FolderStore, Job, Where
from clradar.jobs.job import KEY
from clradar.jobs.lock import LOCK, held, scratch_folder
from clradar.opencl import Device, DeviceInfo, choice, device, open_device

HERE = Where("pocl")


@dataclass(frozen=True)
class Steps:
    """Write the square of an item; one fails, and each warns."""

    folder: Path
    fails: int = -1

    def run(self, item: int, device: Any, progress: Any) -> int:
        warn("each says this")
        if item == self.fails:
            raise MeasurementError("item 2 cannot be read")
        write_file(self.folder / "done" / str(item), str(item**2).encode(), force=True)
        return item**2


def job(folder: Path, key: Any = None, **more: Any) -> Job:
    more = {"own": (KEY, "done"), "resumable": lambda at: any(at.glob("done/*")), **more}
    return Job(folder=folder, work="sweep", key=key or {"a": 1}, **more)


def done(one: Job, steps: Steps, **more: Any) -> list[tuple[int, int]]:
    with one.held():
        (one.folder / "done").mkdir(exist_ok=True)
        there = one.folder / "done"
        return list(
            one.each(steps.run, range(4), HERE, done=lambda i: (there / str(i)).is_file(), **more)
        )


@pytest.mark.device
@pytest.mark.filterwarnings("ignore:each says this")
def test_what_is_done_is_not_done_again(tmp_path):
    at, said = tmp_path / "out", []
    with pytest.raises(MeasurementError, match="item 2"):
        done(job(at), Steps(at, fails=2))
    assert sorted(path.name for path in at.rglob("*")) == ["0", "1", "done", KEY]
    (at / "done" / ".2.0.tmp").mkdir()  # as a kill leaves it
    found = done(job(at), Steps(at), say=said.append)
    assert (found, said) == ([(2, 4), (3, 9)], [f"{at}: resumes with 2 of 4 items done before"])
    assert sorted(path.name for path in (at / "done").iterdir()) == ["0", "1", "2", "3"]


@pytest.mark.device
def test_an_error_of_one_item_alone_is_a_warning(tmp_path):
    steps = Steps(tmp_path, fails=2)
    with pytest.warns(ClradarWarning) as said:
        found = done(job(tmp_path), steps, name="{}: ".format, tolerated=lambda error: True)
    assert [item for item, _ in found] == [0, 1, 3]
    assert [str(one.message) for one in said] == ["0: each says this", "2: item 2 cannot be read"]


def refused(words: str, one: Job) -> None:
    with pytest.raises(OutputError, match=words), one.held():
        pass


def test_a_folder_takes_one_key(tmp_path):
    at = tmp_path / "deep" / "out"
    one, other = {"a": {"b": 1, "c": 2}}, {"a": {"b": 3, "c": 2}}
    more: dict[str, Any] = {"resumable": lambda at: True, "own": (KEY, "result", "work")}
    for _ in range(2):
        with job(at, one, **more).held():
            (at / "result").touch()
            FolderStore(at / "work")["one"] = {"x": np.arange(3)}
    refused(r"a\.b 1, now 3", job(at, other, **more))
    (at / "thesis.tex").touch()
    store = FolderStore(at / "work")
    assert np.array_equal(store["one"]["x"], [0, 1, 2])
    assert (list(store), "one" in store, "two" in store) == (["one"], True, False)
    with job(at, other, force=True, **more).held():
        assert {p.name for p in at.iterdir()} == {KEY, LOCK, "thesis.tex"}
        refused("another sweep", job(at))
    with pytest.raises(OutputError, match="got a file"), held(at / "thesis.tex", "sweep"):
        pass


def test_inputs_count_by_what_they_hold(tmp_path):
    at, mesh = tmp_path / "out", tmp_path / "a.ply"
    more: dict[str, Any] = {"inputs": {"--mesh": [mesh]}, "resumable": lambda at: True}
    for _ in range(2):  # another file of the same content
        mesh.unlink(missing_ok=True)
        mesh.write_bytes(b"one")
        with job(at, **more).held():
            pass
    mesh.write_bytes(b"two")
    refused(r"--mesh '.*a\.ply' holds something else", job(at, **more))
    more["inputs"] = {}
    refused("--mesh of 1 file, now of 0", job(at, **more))


def test_a_folder_of_somebody_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").touch()
    refused("no begun sweep", job(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_damaged_settings_are_an_error_and_can_be_replaced(tmp_path):
    (tmp_path / KEY).write_text("[1")
    with (
        pytest.raises(ValueError, match="settings of a begun sweep"),
        job(tmp_path, resumable=lambda at: True).held(),
    ):
        pass
    with job(tmp_path, force=True, resumable=lambda at: True).held():
        assert json.loads((tmp_path / KEY).read_text()) == {"a": 1}


def test_what_fails_before_there_is_anything_leaves_nothing(tmp_path):
    with pytest.raises(OutputError, match="refused"), job(tmp_path / "out").held():
        raise OutputError("refused")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.device
def test_an_item_of_a_scheduler_is_made_in_the_folder_of_the_client(tmp_path, monkeypatch):
    workers = pytest.importorskip("clradar.jobs.workers")
    monkeypatch.setattr(workers, "breach", lambda terms: None)
    before = os.getcwd()
    for here, there in ((str(tmp_path), str(tmp_path)), ("/seen/by/the/client/alone", before)):
        terms = workers.Terms("{}", "pocl", (), here)
        made = workers.run_item(lambda *_: os.getcwd(), 0, terms)
        assert (made, os.getcwd()) == ((there, []), before)


HOLDING = """
import sys, time
from pathlib import Path
from clradar.jobs.lock import held
with held(Path(sys.argv[1]), "sweep"):
    print("held", flush=True)
    time.sleep(600)
"""


@posix_only
def test_a_killed_holder_holds_nothing(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLDING, tmp_path], stdout=subprocess.PIPE)
    assert process.stdout is not None
    with process, process.stdout:
        process.stdout.readline()
        refused("another sweep", job(tmp_path))
        process.kill()
    assert (tmp_path / LOCK).exists()
    with job(tmp_path).held():
        pass
    assert not (tmp_path / LOCK).exists()


def test_a_file_stands_for_a_lock_where_there_are_none(tmp_path, monkeypatch):
    """As on Lustre and NFS by some of their options: no other process is blamed."""
    import errno

    import filelock

    def without_locks(self: Any) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(filelock.FileLock, "_acquire", without_locks)
    one = job(tmp_path / "out", resumable=lambda at: True)
    said: list[str] = []
    with handled_warnings(said.append), one.held():
        refused(r"another sweep .*: process [0-9]+ of ", one)
    assert "its file system has no locks" in said[0]
    assert [path.name for path in (tmp_path / "out").iterdir()] == [KEY]


@posix_only
def test_scratch_folders_of_killed_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left, system = tmp_path / f"clradar-scratch-{os.getpid()}", Path("/dev/shm")
    left.mkdir()
    (left / LOCK).touch()
    listed = sys.platform == "linux"
    if listed:
        (system / f"sem.{left.name}-a").touch()
    with scratch_folder() as one:
        assert list(tmp_path.iterdir()) == [one]
        assert not any(system.glob(f"sem.{left.name}-*"))
        _semaphore = multiprocessing.get_context("spawn").Semaphore()
        assert any(system.glob(f"sem.{one.name}-*")) is listed
        with scratch_folder() as other:
            assert set(tmp_path.iterdir()) == {one, other}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.device
def test_results_come_in_order_from_both(tmp_path):
    found = findings_of("batches", tmp_path)
    assert [number for number, _ in found["made"]] == list(range(N))
    assert sorted({selector for _, selector in found["made"]}) == ["0:0", "0:1"]
    assert found["warned"] == ["each says this"]
    assert found["shown"] == [[i + 1, N] for i in range(N)]
    assert "expected devices, each once, got 0:0" in found["twice"]
    assert "expected one device, got 'all'" in found["single"]


@pytest.mark.device
def test_errors_of_workers_name_the_device(monkeypatch):
    workers = pytest.importorskip("clradar.jobs.workers")
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")

    def full(item: int, device: Device, progress: object) -> None:
        raise DeviceError(f"device {device.info.label}: out of memory")

    own = open_device().info
    wanted = f"device {own.selector} {own.label}: out of memory"
    assert str(workers.run_item(full, 0, None)[0]) == wanted


@pytest.mark.device
@pytest.mark.slow
def test_a_process_that_dies_is_named_with_its_item(tmp_path):
    found = findings_of("killed", tmp_path)
    assert re.match(r"DeviceError: device 0:1 .* its process died at item", found)


def listed(selector: str, name: str, kind: str) -> DeviceInfo:
    return DeviceInfo(selector, name, f"platform {selector[0]}", "1", kind, 2**30, 2**30, 4)


def test_the_list_marks_all_that_would_be_used(monkeypatch, capsys):
    there = [(listed(f"0:{i}", "A", "cpu"), None) for i in range(2)]
    monkeypatch.setattr(device, "_found", lambda: there)
    for module in (choice, lists):
        monkeypatch.setattr(module, "fault", lambda selector: None)
    monkeypatch.setenv("CLRADAR_DEVICE", "all")
    lists.devices_command()
    assert (out := capsys.readouterr().out).count("*") == 2
    assert out.endswith("used: 0:0 A [platform 0], 0:1 A [platform 0]\n")


@pytest.mark.device
def test_devices_of_two_kinds_are_not_alike():
    devices = Where("pocl")
    devices.__dict__["infos"] = (devices.first.info, listed("1:0", "B", "gpu"))
    with pytest.raises(DeviceError, match=r"one name and driver for a sweep.*1:0 B"):
        devices.check_alike("a sweep")
    with pytest.raises(ModelError, match="a device by its name"):
        Where(devices.first, scheduler="tcp://127.0.0.1:1")
