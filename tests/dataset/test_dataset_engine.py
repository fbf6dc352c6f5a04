"""Data sets made by several processes, and what becomes of them when something fails."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import command_line
import faulty_samples
import pytest
from dataset_plans import LIGHT, digests, light_file, light_plan
from two_devices import findings_of

from clradar.dataset import run
from clradar.dataset.runs import STOP_AFTER, ShardMaker
from clradar.errors import DeviceError, ModelError, OutputError
from clradar.jobs import Where
from clradar.jobs.workers import Share, own_cores, partition
from clradar.opencl import DeviceInfo, devices_like

CORES = own_cores()
SAMPLES = LIGHT.samples


pytestmark = [
    pytest.mark.usefixtures("quick_runs"),
    # What is set aside is compared by the results.
    pytest.mark.filterwarnings("ignore:sample . was set aside"),
]


@pytest.fixture
def undisturbed(light: Path) -> dict[str, str]:
    """The files of the data set as this process makes it, one sample after the other."""
    return digests(light)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A Dask client of two workers whose samples can be made to fail."""
    import dask

    from clradar.jobs.workers import local_client

    faulty_samples.plan_faults({})
    preload = [str(Path(faulty_samples.__file__))]
    with (
        dask.config.set({"distributed.worker.preload": preload}),
        local_client(partition(min(2, len(CORES)), devices_like("pocl"), CORES)) as client,
    ):
        yield client


def workers(client: Any) -> Where:
    return Where(scheduler=client.scheduler.address)


# Partition of a machine


def info(selector: str, kind: str) -> DeviceInfo:
    return DeviceInfo(selector, "name", "platform", "version", kind, 2**30, 2**28, 4)


def test_cores_are_partitioned() -> None:
    found = partition(3, [info("1:0", "cpu")], [0, 1, 2, 5, 6, 7, 8])
    assert [one.cores for one in found] == [(0, 1, 2), (5, 6), (7, 8)]
    assert [one.threads for one in found] == [3, 2, 2]
    with pytest.raises(ModelError, match="at most 2, one per core"):
        partition(3, [info("1:0", "cpu")], [0, 1])


def test_gpus_are_assigned_in_turn() -> None:
    found = partition(3, [info("0:0", "gpu"), info("0:1", "gpu")], [0, 1])
    assert [one.device for one in found] == ["0:0", "0:1", "0:0"]
    assert {one.threads for one in found} == {1}


@pytest.mark.slow
def test_workers_with_a_device_each_make_the_same(tmp_path: Path) -> None:
    found = findings_of("cluster", tmp_path)
    assert found["devices"] == ["0:0", "0:1"]
    assert found["same"]


def test_pocl_keeps_to_its_threads() -> None:
    code = "from clradar.opencl import open_device; print(open_device().info.compute_units)"
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **Share("pocl", (0,), 1).environment()},
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(found.stdout) == 1


# This process


def test_a_full_disk_ends_the_run_and_is_no_fault_of_a_sample(
    undisturbed: dict[str, str], cluster: Any, faults: Any, tmp_path: Path
) -> None:
    faults({4: "full"})
    with pytest.raises(OutputError, match=r"shard-00001.h5: cannot be written: No space left"):
        run(LIGHT, tmp_path, where=workers(cluster))
    assert "shards/shard-00001.h5" not in digests(tmp_path)
    faults({})
    assert run(LIGHT, tmp_path, device="pocl").aside == ()
    assert digests(tmp_path) == undisturbed


def test_a_device_that_refuses_all_ends_the_run(faults: Any, tmp_path: Path) -> None:
    faults(dict.fromkeys(range(40), "device"))
    with pytest.raises(DeviceError, match=f"{STOP_AFTER} samples in a row"):
        run(light_plan(samples=40), tmp_path, device="pocl")


# Several processes


def test_two_workers_make_the_same_bytes_though_one_is_killed(
    undisturbed: dict[str, str], cluster: Any, faults: Any, tmp_path: Path
) -> None:
    faults({2: "raise once", 4: "device once", 6: "cut once"})
    seen: list[tuple[int, int]] = []
    result = run(LIGHT, tmp_path, where=workers(cluster), progress=lambda *done: seen.append(done))
    # The killed worker may have put another shard in place without a word: it counts as there.
    assert (result.made, result.aside) in [(SAMPLES, ()), (SAMPLES - 3, ())]
    assert seen == [(n + 1, 3) for n in range(3)]
    assert digests(tmp_path) == undisturbed


def test_workers_set_aside_what_one_process_does(cluster: Any, faults: Any, tmp_path: Path) -> None:
    faults({1: "raise", 3: "device"})
    few = light_plan(samples=4)
    run(few, tmp_path / "serial", device="pocl")
    run(few, tmp_path / "cluster", where=workers(cluster))
    assert digests(tmp_path / "cluster") == digests(tmp_path / "serial")


def test_a_run_ends_after_samples_that_are_made_twice(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask reschedules what a dead worker held, and does not wait for it."""
    from clradar.jobs.workers import Workers

    begun, released, ended = (tmp_path / name for name in ("begun", "released", "ended"))

    def slowly(begun: Path, released: Path, ended: Path) -> None:
        begun.touch()
        while not released.exists():
            time.sleep(0.01)
        ended.touch()

    arguments = (begun, released, ended)
    key = ("item", "run", 1)
    future = cluster.submit(slowly, *arguments, key=key, resources={"DEVICE": 1})
    wait_for(begun.exists)
    future.cancel()
    Workers(cluster)._await_late("another run")
    assert not ended.exists()
    # It ends only once it is waited for.
    monkeypatch.setattr("clradar.jobs.workers.sleep", lambda _: released.touch())
    Workers(cluster)._await_late("run")
    assert ended.exists()


def test_the_error_of_an_unsuitable_worker_names_the_reason(tmp_path: Path) -> None:
    from clradar.jobs.workers import Terms, run_item, worker_facts

    facts = worker_facts("pocl")
    terms = Terms(json.dumps(facts), "pocl", (str(tmp_path),), str(tmp_path))
    assert terms.breach() is None
    assert "cannot see /none" in str(replace(terms, files=("/none",)).breach())
    older = replace(terms, made_with=json.dumps({**facts, "clradar": "0.0.1"}))
    error, _ = run_item(ShardMaker(tmp_path, LIGHT).run, None, older)
    assert "device of the other workers: clradar 0.0.1, now" in str(error)


@pytest.mark.slow
def test_a_sample_that_kills_its_worker_is_set_aside_and_no_other(
    undisturbed: dict[str, str], cluster: Any, faults: Any, tmp_path: Path
) -> None:
    faults({4: "kill"})
    result = run(LIGHT, tmp_path, where=workers(cluster))
    assert (result.made, [a.sample for a in result.aside]) == (SAMPLES - 1, [4])
    assert "worker process died" in result.aside[0].reason
    faults({})
    assert run(LIGHT, tmp_path, where=workers(cluster), retry=True).made == 1
    assert digests(tmp_path) == undisturbed


def test_an_address_without_a_scheduler_is_one_error(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan_file = light_file(tmp_path)
    monkeypatch.setattr("clradar.jobs.workers.CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        arguments = ("dataset", plan_file, "-o", tmp_path / "x", "--scheduler", address)
        status, _, err = command_line.run(capsys, *arguments)
        assert (status, err.count("\n")) == (1, 1)
        assert f"{address}: expected the address of a Dask scheduler" in err
    assert not (tmp_path / "x").exists()
    # Nor do tracebacks come of a scheduler that is lost later: they go through these.
    for name in ("distributed", "distributed.client", "tornado.application"):
        assert not logging.getLogger(name).isEnabledFor(logging.ERROR), name


def wait_for(condition: Callable[[], bool], limit_s: float = 1800.0) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "waited in vain"
        time.sleep(0.01)
