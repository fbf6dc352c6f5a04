"""Each piece of work against a peer in the same run, and whether both agree: ratios, not seconds.

    python benchmarks/against_peers.py [--device pocl --device intel] [--only images] [--quick]

Needs the peers: pip install "clradar[bench]". docs/performance.md has the results.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from core import images, rays, sums
from core.work import Work, rows_of

import clradar
from clradar.files.json_file import write_json

SUITE: dict[str, Callable[[clradar.Device, bool], Iterable[Work]]] = {
    "visibility": lambda device, quick: rays.visibility(device, 8192 if quick else 65536),
    "bounces": lambda device, quick: rays.bounces(device, 200_000 if quick else 2_000_000),
    "trees": lambda device, quick: rays.trees(device, (224,) if quick else (224, 708)),
    "phasors": lambda device, quick: [sums.phasor_sum(device, 500_000 if quick else 5_000_000)],
    "images": lambda device, quick: [images.paper_volume(device, 5 if quick else 81)],
    "operators": lambda device, quick: [sums.forward(device, 500 if quick else 2000)],
    "exact": lambda device, quick: [images.exact_image(device)],
    "physical": lambda device, quick: [sums.physical(device, 1.2 if quick else 4.0)],
}
"""By name: what gives the work on a device, of smaller sizes if it is quick."""


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
            for work in SUITE[kind](device, chosen.quick):
                for row in rows_of(work, repeats):
                    print("{work}\n    ours  {ours}\n    peers {peer}".format_map(row))
                    print("    ratio {ratio:.1f} x   ({check})".format_map(row), flush=True)
                    rows.append(row)
        results.append({"device": dict(device.describe()), "cores": os.cpu_count(), "rows": rows})
    if chosen.json is not None:
        write_json(chosen.json, {"repeats": repeats, "results": results}, force=True)


if __name__ == "__main__":
    main()
