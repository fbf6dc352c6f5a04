"""Each piece of work against a peer in the same run, and whether both agree: ratios, not seconds.

    python benchmarks/against_peers.py [--device pocl --device intel] [--only images] [--quick]

Needs the peers: pip install "clradar[bench]". docs/performance.md has the results.
"""

from __future__ import annotations

import argparse
import os
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

from core.suite import SUITE, Effort, run_suite
from core.timing import Row

import clradar
from clradar.files.json_file import write_json


def print_row(row: Row) -> None:
    """Print one piece of work: ours, the peer's, the ratio."""
    print(f"{row.work}\n    ours  {row.ours}", flush=True)
    if row.peer:
        print(f"    peer  {row.peer}\n    ratio {row.ratio:.1f} x   ({row.check})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", action="append", help="repeat to compare several")
    parser.add_argument("--only", action="append", choices=list(SUITE), help="repeat for several")
    parser.add_argument("--quick", action="store_true", help="smaller sizes")
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the median counts")
    parser.add_argument("--json", type=Path, help="also write the figures")
    chosen = parser.parse_args()
    effort = Effort(chosen.quick, min(chosen.repeats, 3) if chosen.quick else chosen.repeats)
    results: list[dict[str, Any]] = []
    for name in chosen.device or [None]:
        device = clradar.open_device(name)
        where = f"{device.info.label}, {os.cpu_count()} cores, {platform.machine()}"
        print(f"{where}, medians of {effort.repeats}", flush=True)
        rows = []
        for row in run_suite(device, chosen.only or list(SUITE), effort):
            print_row(row)
            rows.append(asdict(row))
        results.append({"device": dict(device.describe()), "cores": os.cpu_count(), "rows": rows})
    if chosen.json is not None:
        write_json(chosen.json, {"repeats": effort.repeats, "results": results}, force=True)


if __name__ == "__main__":
    main()
