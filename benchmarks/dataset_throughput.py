"""Samples per hour: one process on one core, one and two workers of a core each; and what follows.

    python benchmarks/dataset_throughput.py [PLAN.toml] [--samples N] [--rounds N]

Each round makes the same samples in the three ways, one after the other, each after a run that
builds the kernels. Needs PoCL, two cores, and nothing else running: the load average is printed,
and processor time beside wall time, which other programs change less. Extrapolated numbers are
marked.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from clradar.dataset import Plan, Sample, make_sample, read_plan, recipe, run
from clradar.dataset.engine.part_making import Serial, made_with
from clradar.dataset.store.shard_writer import assemble, write_sample
from clradar.files.hashing import sha256_of
from clradar.jobs.resources import WorkerResources
from clradar.opencl import open_device

LETTERS = Path(__file__).parents[1] / "examples" / "plans" / "letters.toml"
DEVICE = "pocl"
CORES = (0, 1)
BLAS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
GPU_FACTORS = (10, 30)
"""How many times faster than one core a GPU may run the kernels: assumed, none was at hand."""

CLUSTER_CORES = (2, 32)
"""Of each of 100 machines."""

TRIVIAL_TASKS = 2000


def on_core(core: int) -> WorkerResources:
    return WorkerResources(DEVICE, (core,), 1)


def processor_time_s() -> float:
    """Return the processor time of the worker that runs this."""
    return time.process_time()


def trivial(number: int) -> int:
    return number


def shortened(path: Path, samples: int) -> Plan:
    """Return a plan of fewer samples, one shard."""
    plan = read_plan(path)
    return replace(plan, samples=samples, output=replace(plan.output, shard_size=samples))


def timed_run(plan: Plan, engine: Any, folder: Path) -> float:
    """Make a data set with statistics and contact sheet; return the seconds that it took."""
    start_s = time.perf_counter()
    result = run(plan, folder, engine=engine)
    assert result.made == plan.samples
    return time.perf_counter() - start_s


def alone(path: Path, samples: int) -> dict[str, float]:
    """Measure the serial run, and where its time goes; to be run by a process on one core."""
    plan = shortened(path, samples)
    with tempfile.TemporaryDirectory() as name:
        timed_run(shortened(path, 2), Serial(DEVICE), Path(name) / "warm")
        before_s = time.process_time()
        wall_s = timed_run(plan, Serial(DEVICE), Path(name) / "set")
        processor_s = time.process_time() - before_s
    device = open_device(DEVICE, profiling=True)
    make_sample(recipe(plan, 0), device, rigs=plan.folder)
    device.kernel_time_s()
    # Kernels run in PoCL's thread, all else in this one, since numpy has one thread.
    clocks = (time.perf_counter, time.process_time, time.thread_time)
    made = []
    begun_s = [clock() for clock in clocks]
    for sample in range(samples):
        made.append(make_sample(recipe(plan, sample), device, rigs=plan.folder))
    made_s, all_s, host_s = (clock() - begun for clock, begun in zip(clocks, begun_s, strict=True))
    events_s = device.kernel_time_s()
    close_s = closing_s(plan, made, made_with(device))
    return {
        "wall_s": wall_s / samples,
        "processor_s": processor_s / samples,
        "close_s": close_s / samples,
        "made_s": made_s / samples,
        "events_s": events_s / samples,
        "host_s": host_s / samples,
        "kernel_processor_s": (all_s - host_s) / samples,
    }


def closing_s(plan: Plan, made: Sequence[Sample], made_with: Mapping[str, Any]) -> float:
    """Return the time to assemble a shard from parts, which the client does."""
    level = plan.output.compression
    with tempfile.TemporaryDirectory() as name:
        parts = [Path(name) / f"{i}.h5" for i in range(len(made))]
        for part, sample in zip(parts, made, strict=True):
            write_sample(part, sample, made_with, compression=level, force=False)
        begun_s = time.perf_counter()
        assemble(Path(name) / "shard.h5", parts, compression=level)
        sha256_of(Path(name) / "shard.h5")
        return time.perf_counter() - begun_s


def on_one_core(path: Path, samples: int) -> dict[str, float]:
    """Run `alone` in a process that has one core; return its measurements."""
    done = subprocess.run(
        [sys.executable, __file__, str(path), "--samples", str(samples), "--alone"],
        env={**os.environ, **on_core(CORES[0]).environment(), **dict.fromkeys(BLAS, "1")},
        preexec_fn=lambda: os.sched_setaffinity(0, CORES[:1]),
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout)


def on_workers(path: Path, samples: int, workers: int) -> dict[str, float]:
    """Measure a run on so many workers of one core each."""
    from clradar.jobs.cluster import DEVICE as RESOURCE
    from clradar.jobs.cluster import local_cluster
    from clradar.jobs.distributed import Distributed

    begun_s = time.perf_counter()
    with (
        tempfile.TemporaryDirectory() as name,
        local_cluster([on_core(core) for core in CORES[:workers]]) as (client, _),
    ):
        start_s = time.perf_counter() - begun_s
        timed_run(shortened(path, 4 * workers), Distributed(client), Path(name) / "warm")
        before_s = sum(client.run(processor_time_s).values())
        wall_s = timed_run(shortened(path, samples), Distributed(client), Path(name) / "set")
        processor_s = sum(client.run(processor_time_s).values()) - before_s
        begun_s = time.perf_counter()
        futures = [
            client.submit(trivial, n, resources={RESOURCE: 1}, key=("trivial", n))
            for n in range(TRIVIAL_TASKS)
        ]
        client.gather(futures)
        task_s = (time.perf_counter() - begun_s) / TRIVIAL_TASKS
    return {
        "wall_s": wall_s / samples,
        "processor_s": processor_s / samples,
        "start_s": start_s,
        "task_s": task_s,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("plan", nargs="?", type=Path, default=LETTERS)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.alone:
        print(json.dumps(alone(given.plan, given.samples)))
        return
    rounds: dict[str, list[dict[str, float]]] = {"serial": [], "1 worker": [], "2 workers": []}
    for number in range(given.rounds):
        print(f"round {number}: load average {os.getloadavg()[0]:.1f}", flush=True)
        rounds["serial"].append(on_one_core(given.plan, given.samples))
        for workers in (1, 2):
            name = "1 worker" if workers == 1 else f"{workers} workers"
            rounds[name].append(on_workers(given.plan, given.samples, workers))
        for name, measured in rounds.items():
            print(f"  {name}: {json.dumps({k: round(v, 4) for k, v in measured[-1].items()})}")
    report(rounds)


def report(rounds: dict[str, list[dict[str, float]]]) -> None:
    """Print medians over rounds, and an extrapolation to other machines."""
    found = {
        name: {key: median(m[key] for m in measured) for key in measured[0]}
        for name, measured in rounds.items()
    }
    serial, two = found["serial"], found["2 workers"]
    print(f"\nmedians of {len(rounds['serial'])} rounds, measured")
    for name, values in found.items():
        ratios = [
            one["wall_s"] / other["wall_s"]
            for one, other in zip(rounds["serial"], rounds[name], strict=True)
        ]
        print(
            f"  {name:9}  {3600 / values['wall_s']:7.0f} samples/h  {median(ratios):.2f} x serial"
            f"  {values['processor_s']:.2f} s of processor time each"
        )
    processor_share = serial["kernel_processor_s"] / (
        serial["kernel_processor_s"] + serial["host_s"]
    )
    print(
        f"  kernels: {serial['events_s'] / serial['made_s']:.0%} of the wall time of making "
        f"samples by OpenCL's events, {processor_share:.0%} of processor time"
    )
    print(
        f"  workers start in {two['start_s']:.1f} s; the client takes {1e3 * two['task_s']:.2f} ms "
        f"for a task of Dask's, and {1e3 * serial['close_s']:.2f} ms per sample to close a shard"
    )
    free = 2 * serial["processor_s"] / two["processor_s"]
    print("computed")
    print(f"  two workers on two cores that nothing else uses: {free:.2f} x serial")
    host_s, kernel_s = serial["host_s"], serial["kernel_processor_s"]
    for factor in GPU_FACTORS:
        each_s = host_s + kernel_s / factor
        print(
            f"  4 GPUs, each {factor} times a core (assumed), a worker each: "
            f"{4 * 3600 / each_s:.0f} samples/h; the host's part of a sample is {host_s:.2f} s"
        )
    print(f"  4 GPUs, host part alone, two workers each: {8 * 3600 / host_s:.0f} samples/h at most")
    limit = 3600 / (two["task_s"] + serial["close_s"])
    for cores in CLUSTER_CORES:
        made = 100 * cores * 3600 / two["processor_s"]
        print(
            f"  100 machines of {cores} cores: {min(made, limit):.0f} samples/h; their workers "
            f"{made:.0f}, one client at most {limit:.0f}"
        )


if __name__ == "__main__":
    main()
