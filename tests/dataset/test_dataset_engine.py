"""Data sets made by several processes, and what becomes of them when something fails."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import faulty_samples
import pytest
from dataset_plans import LIGHT, digests, light_file
from two_devices import findings_of

from clradar.dataset import run
from clradar.dataset.runs import ShardMaker, attempts_at
from clradar.errors import DeviceError, ModelError, OutputError
from clradar.jobs import Where
from clradar.jobs.outcome import silent
from clradar.jobs.workers import own_cores, partition
from clradar.opencl import DeviceInfo, devices_like, open_device

CORES = own_cores()
SAMPLES = LIGHT.samples

pytestmark = [
    pytest.mark.usefixtures("quick_runs"),
    # What is set aside is compared by the results.
    pytest.mark.filterwarnings("ignore:sample . was set aside"),
]


@pytest.fixture(scope="module")
def cluster():
    """A Dask client of two workers whose samples can be made to fail."""
    import dask

    from clradar.jobs.workers import local_client

    faulty_samples.plan_faults({})
    preload = [str(Path(faulty_samples.__file__))]
    with (
        dask.config.set({"distributed.worker.preload": preload}),
        local_client(shares()) as client,
    ):
        yield client


def shares():
    return partition(min(2, len(CORES)), devices_like("pocl"), CORES)


def workers(client):
    return Where(scheduler=client.scheduler.address)


# Partition of a machine


def test_cores_are_partitioned_and_gpus_assigned_in_turn():
    def info(selector, kind):
        return DeviceInfo(selector, "name", "platform", "version", kind, 2**30, 2**28, 4)

    found = partition(3, [info("1:0", "cpu")], [0, 1, 2, 5, 6, 7, 8])
    assert [one.cores for one in found] == [(0, 1, 2), (5, 6), (7, 8)]
    assert [one.threads for one in found] == [3, 2, 2]
    with pytest.raises(ModelError, match="at most 2, one per core"):
        partition(3, [info("1:0", "cpu")], [0, 1])
    found = partition(3, [info("0:0", "gpu"), info("0:1", "gpu")], [0, 1])
    assert [(one.device, one.threads) for one in found] == [("0:0", 1), ("0:1", 1), ("0:0", 1)]


@pytest.mark.slow
def test_workers_with_a_device_each_make_the_same(tmp_path):
    found = findings_of("cluster", tmp_path)
    assert found["devices"] == ["0:0", "0:1"]
    assert found["same"]


def test_pocl_keeps_to_its_threads(cluster):
    found = cluster.run(lambda: open_device("pocl").info.compute_units)
    assert sorted(found.values()) == sorted(share.threads for share in shares())


# This process


def test_a_full_disk_ends_the_run_and_is_no_fault_of_a_sample(light, cluster, faults, tmp_path):
    faults({4: "full"})
    with pytest.raises(OutputError, match=r"shard-00001.h5: cannot be written: No space left"):
        run(LIGHT, tmp_path, where=workers(cluster))
    assert "shards/shard-00001.h5" not in digests(tmp_path)
    faults({})
    assert run(LIGHT, tmp_path, device="pocl").aside == ()
    assert digests(tmp_path) == digests(light)


def test_a_device_that_refuses_all_ends_the_run(faults, tmp_path, monkeypatch):
    monkeypatch.setattr("clradar.dataset.runs.STOP_AFTER", 3)
    faults(dict.fromkeys(range(6), "device"))
    with pytest.raises(DeviceError, match="3 samples in a row"):
        run(LIGHT, tmp_path, device="pocl")


# Several processes


def test_two_workers_make_the_same_bytes_though_one_is_killed(cluster, faults, tmp_path):
    faults({1: "raise"})
    run(LIGHT, tmp_path / "serial", device="pocl")
    faults({1: "raise", 2: "raise once", 4: "device once", 6: "cut once"})
    seen, folder = [], tmp_path / "cluster"
    where = workers(cluster)
    result = run(LIGHT, folder, where=where, progress=lambda *done: seen.append(done))
    # The killed worker may have put another shard in place without a word: it counts as there.
    assert result.made in (SAMPLES - 1, SAMPLES - 3, SAMPLES - 4)
    assert [aside.sample for aside in result.aside] == [1]
    assert seen == [(n + 1, 3) for n in range(3)]
    assert digests(folder) == digests(tmp_path / "serial")


def test_the_error_of_an_unsuitable_worker_names_the_reason(tmp_path):
    from clradar.jobs.workers import Terms, breach, run_item, worker_facts

    facts = worker_facts("pocl")
    terms = Terms(json.dumps(facts), "pocl", (str(tmp_path),), str(tmp_path))
    assert breach(terms) is None
    assert "cannot see /none" in str(breach(replace(terms, files=("/none",))))
    older = replace(terms, made_with=json.dumps({**facts, "clradar": "0.0.1"}))
    error, _ = run_item(ShardMaker(tmp_path, LIGHT).run, None, older)
    assert "device of the other workers: clradar 0.0.1, now" in str(error)


@pytest.mark.slow
def test_a_sample_that_kills_its_worker_is_set_aside_and_no_other(light, cluster, faults, tmp_path):
    faults({4: "kill"})
    result = run(LIGHT, tmp_path, where=workers(cluster))
    assert [aside.sample for aside in result.aside] == [4]
    assert "worker process died" in result.aside[0].reason
    faults({})
    assert run(LIGHT, tmp_path, where=workers(cluster), retry=True).made == 1
    assert digests(tmp_path) == digests(light)


def test_a_sample_at_which_two_workers_died_is_left_out(tmp_path):
    for name in ("parts", "shards"):
        (tmp_path / name).mkdir()
    attempts_at(tmp_path, 4).write_bytes(b"..")
    assert ShardMaker(tmp_path, LIGHT).run(1, open_device("pocl"), silent).count == 2


def test_an_address_without_a_scheduler_is_one_error(cli, monkeypatch):
    light_file(Path())
    monkeypatch.setattr("clradar.jobs.workers.CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        said = f"{address}: expected the address of a Dask scheduler"
        cli.fails(f"dataset plan.toml -o x --scheduler {address}", said)
    assert not Path("x").exists()
    # Nor do tracebacks come of a scheduler that is lost later: they go through these.
    for name in ("distributed", "distributed.client", "tornado.application"):
        assert not logging.getLogger(name).isEnabledFor(logging.ERROR), name
