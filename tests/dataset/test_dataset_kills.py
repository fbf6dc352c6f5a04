"""Runs of data sets that are killed at random moments and resumed. All slow."""

import os
import random
import signal
import subprocess
import sys
import time

import psutil
import pytest
from dataset_plans import digests, light_file
from test_dataset_engine import wait_for

pytestmark = pytest.mark.slow

MANY = 150
KILLS = int(os.environ.get("CLRADAR_TEST_KILLS", "25"))
SEED = int(os.environ.get("CLRADAR_TEST_KILLS_SEED", "1"))
LIMIT_S = 1800.0
"""Of waits for events that always come, on a machine however busy."""


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
        if begun:  # a shard is being made; else while everything starts
            wait_for(lambda: process.poll() is not None or {*folder.glob("shards/.*.tmp")} - left)  # noqa: B023
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
        if (folder / "contact-sheet.png").is_file():
            assert digests(folder) == undisturbed
            folder = folder.with_name(f"set-{done}")
    subprocess.run(command(plan_file, folder), check=True)
    assert digests(folder) == undisturbed
