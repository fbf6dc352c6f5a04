"""Samples per hour: this process on one core, one and two workers of a core each.

    python benchmarks/dataset_throughput.py [PLAN.toml] [--samples N] [--rounds N]

Each round makes the same samples in the three ways, in four shards, with statistics and contact
sheet, after two samples that build the kernels; workers start and build theirs within the time.
Needs PoCL, two cores, and nothing else running: the load average is printed.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from statistics import median

from clradar.dataset import Plan, read_plan, run
from clradar.jobs import Where

LETTERS = Path(__file__).parents[1] / "examples" / "plans" / "letters.toml"
DEVICE = "pocl"
SHARDS = 4


def shortened(path: Path, samples: int) -> Plan:
    """Return a plan of fewer samples."""
    plan = read_plan(path)
    output = plan.output.model_copy(update={"shard_size": -(-samples // SHARDS)})
    return plan.model_copy(update={"samples": samples, "output": output})


def seconds(plan: Plan, where: Where) -> float:
    with tempfile.TemporaryDirectory() as name:
        begun_s = time.perf_counter()
        assert run(plan, Path(name) / "set", where=where).made == plan.samples
        return time.perf_counter() - begun_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("plan", nargs="?", type=Path, default=LETTERS)
    parser.add_argument("--samples", type=int, default=24)
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    # One core for PoCL and numpy of this process; workers get their own.
    os.environ |= {"POCL_MAX_PTHREAD_COUNT": "1", "POCL_CPU_MAX_CU_COUNT": "1"}
    ways = {
        "this process": Where(DEVICE),
        "one worker": Where(DEVICE, workers=1),
        "two workers": Where(DEVICE, workers=2),
    }
    print(f"load average {os.getloadavg()[0]:.2f}")
    seconds(shortened(options.plan, 2), ways["this process"])
    plan = shortened(options.plan, options.samples)
    times_s: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(options.rounds):
        for name, where in ways.items():
            times_s[name].append(seconds(plan, where))
    for name, each_s in times_s.items():
        rate = 3600 * plan.samples / median(each_s)
        print(f"{name}: {rate:.0f} samples/h ({', '.join(f'{t:.1f} s' for t in each_s)})")


if __name__ == "__main__":
    main()
