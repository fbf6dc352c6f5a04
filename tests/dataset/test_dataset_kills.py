"""Runs of data sets that are killed at random moments and resumed. All slow."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from dataset_plans import digests
from test_dataset_engine import PLAN, SAMPLES, wait_for

pytestmark = pytest.mark.slow

MANY = 150
KILLS = int(os.environ.get("CLRADAR_TEST_KILLS", "25"))
SEED = int(os.environ.get("CLRADAR_TEST_KILLS_SEED", "1"))
LIMIT_S = 1800.0
"""Of waits for events that always come, on a machine however busy."""


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    text = PLAN.replace(f"samples = {SAMPLES}", f"samples = {MANY}")
    text = text.replace('["joints"', '["capture", "max_projection", "joints"')
    path.write_text(text.replace("shard_size = 3", "shard_size = 2"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def undisturbed(plan_file: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("undisturbed") / "set"
    subprocess.run(command(plan_file, folder), check=True)
    return digests(folder)


def command(plan_file: Path, folder: Path, *more: str) -> list[str]:
    start = [sys.executable, "-m", "clradar.cli", "dataset", str(plan_file), "-o", str(folder)]
    return [*start, "--device", "pocl", *more] if "--scheduler" not in more else [*start, *more]


def started(arguments: list[str]) -> subprocess.Popen[str]:
    """Start a command in a process group of its own."""
    return subprocess.Popen(
        arguments,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for_work(process: subprocess.Popen[str], folder: Path) -> None:
    """Until a shard is being made, or the command has ended."""
    wait_for(lambda: process.poll() is not None or any(folder.glob("shards/.*.tmp")))


def test_kills_at_random_moments_change_no_byte(
    plan_file: Path, undisturbed: dict[str, str], tmp_path: Path
) -> None:
    draw = random.Random(SEED)
    folder, done, there = tmp_path / "set", 0, []
    while done < KILLS:
        process = started(command(plan_file, folder, "--workers", "2"))
        begun = draw.random() < 0.8
        if begun:  # else while everything starts
            wait_for_work(process, folder)
        time.sleep(draw.uniform(0.0, 4.0))
        victim = draw.choice(["client", "group", "worker", "interrupt"])
        children = psutil.Process(process.pid).children(recursive=True)
        if victim == "worker":
            workers = [c for c in children if "spawn_main" in " ".join(c.cmdline())]
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
        there.append(len(digests(folder)) if folder.is_dir() else 0)
        if (folder / "contact-sheet.png").is_file():
            assert digests(folder) == undisturbed
            folder = folder.with_name(f"set-{done}")
    subprocess.run(command(plan_file, folder), check=True)
    assert digests(folder) == undisturbed
    print(f"{done} kills in {len(there)} runs, files there after each: {there}")


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """A scheduler with three workers on this machine's loopback."""
    environment = {**os.environ, "POCL_MAX_PTHREAD_COUNT": "1", "CLRADAR_DEVICE": "pocl"}
    file = tmp_path / "scheduler.json"
    place = ["--scheduler-file", str(file)]
    host = ["--host", "127.0.0.1", "--no-dashboard"]
    options = ["--nthreads", "1", "--memory-limit", "0", "--resources", "DEVICE=1"]
    dask = [sys.executable, "-m", "dask"]
    with open(tmp_path / "log", "w", encoding="utf-8") as log:
        streams: dict[str, Any] = {"stdout": log, "stderr": log}
        processes = [
            subprocess.Popen([*dask, "scheduler", "--port", "0", *host, *place], **streams)
        ]
        processes += [
            subprocess.Popen(
                [*dask, "worker", *place, *host, *options],
                env=environment,
                start_new_session=True,
                cwd=tmp_path,
                **streams,
            )
            for _ in range(3)
        ]
        try:
            wait_for(file.is_file)
            import json

            yield json.loads(file.read_text())["address"], processes
        finally:
            for process in processes:
                for child in psutil.Process(process.pid).children(recursive=True):
                    with suppress(psutil.NoSuchProcess):
                        child.kill()
                process.kill()
                process.wait()


def test_a_scheduler_with_three_workers(
    plan_file: Path,
    undisturbed: dict[str, str],
    scheduler: tuple[str, list[subprocess.Popen[str]]],
    tmp_path: Path,
) -> None:
    address, processes = scheduler
    folder = tmp_path / "set"
    run = command(plan_file, folder, "--scheduler", address)
    process = started(run)
    wait_for(lambda: any(folder.glob("shards/*.h5")))
    # One worker with its nanny for good, one worker that its nanny starts anew, and the client.
    os.killpg(processes[1].pid, signal.SIGKILL)
    time.sleep(1)
    for child in psutil.Process(processes[2].pid).children(recursive=True):
        child.kill()
    time.sleep(1)
    process.kill()
    process.communicate()
    subprocess.run(run, check=True)
    assert digests(folder) == undisturbed
