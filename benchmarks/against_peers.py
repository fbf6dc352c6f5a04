"""Each piece of work against a peer in the same run, and whether both agree: ratios, not seconds.

    python benchmarks/against_peers.py [--device pocl --device intel] [--only images] [--quick]

Needs the peers: pip install "clradar[bench]". docs/performance.md has the results.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from core import images, operators, phasor_sums, physical, rays
from core.timing import Row

import clradar
from clradar.files.json_file import write_json

SUITE: dict[str, Callable[[clradar.Device, int, bool], list[Row]]] = {
    "visibility": lambda device, n, quick: rays.visibility(device, n, 8192 if quick else 65536),
    "bounces": lambda device, n, quick: rays.bounces(device, n, 200_000 if quick else 2_000_000),
    "trees": lambda device, n, quick: rays.trees(device, n, (224,) if quick else (224, 708)),
    "phasors": lambda device, n, quick: phasor_sums.phasor_sum(
        device, n, 500_000 if quick else 5_000_000
    ),
    "images": lambda device, n, quick: images.images(device, n, images.noise(), 5 if quick else 81),
    "operators": lambda device, n, quick: [operators.forward(device, n, 500 if quick else 2000)],
    "exact": lambda device, n, quick: [images.exact_image(device, n, images.noise())],
    "physical": lambda device, n, quick: physical.physical(device, n, 1.0 if quick else 4.0),
}
"""By name: what gives the rows on a device, of medians of n, with smaller sizes if it is quick."""


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
    repeats = min(chosen.repeats, 3) if chosen.quick else chosen.repeats
    results: list[dict[str, Any]] = []
    for name in chosen.device or [None]:
        device = clradar.open_device(name)
        where = f"{device.info.label}, {os.cpu_count()} cores, {platform.machine()}"
        print(f"{where}, medians of {repeats}", flush=True)
        rows = []
        for kind in chosen.only or list(SUITE):
            for row in SUITE[kind](device, repeats, chosen.quick):
                print_row(row)
                rows.append(asdict(row))
        results.append({"device": dict(device.describe()), "cores": os.cpu_count(), "rows": rows})
    if chosen.json is not None:
        write_json(chosen.json, {"repeats": repeats, "results": results}, force=True)


if __name__ == "__main__":
    main()
