"""What every metric of `clradar.compare` says of pairs whose difference is known: docs/metrics.md.

    python benchmarks/metric_evidence.py                 # about half an hour on two cores

Prints the tables of docs/metrics.md and draws docs/images/metrics.png. Images that are in the
folder already are used again: remove it after a change to the simulation or to the image.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import metric_images
from metric_images import HANDS, SHIFTS_MM, Hand, Shot, Store

import clradar

ALPHA = 0.3
OTHER_TRUTH = 0.6
SWEPT = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
MEASURED_SEEDS = (0, 1)
SIMULATED_SEEDS = (10, 11, 12)
MOVED = [metric_images.along(axis, mm) for axis in "xz" for mm in SHIFTS_MM]


def measured(hand: Hand, alpha: float) -> list[Shot]:
    return [Shot(hand, alpha, seed, noisy=True) for seed in MEASURED_SEEDS]


def simulated(hand: Hand, alpha: float) -> list[Shot]:
    return [Shot(hand, alpha, seed) for seed in SIMULATED_SEEDS]


def shots() -> Iterator[Shot]:
    for hand in HANDS:
        for alpha in (ALPHA, OTHER_TRUTH):
            yield from measured(hand, alpha)
            yield from simulated(hand, alpha)
        for shift_mm in MOVED:
            yield Shot(hand, ALPHA, SIMULATED_SEEDS[0], shift_mm)
        for alpha in SWEPT:
            if alpha not in (ALPHA, OTHER_TRUTH):
                yield Shot(hand, alpha, SIMULATED_SEEDS[0])


def make_images(store: Store) -> None:
    wanted = [shot for shot in shots() if not store.has(shot)]
    for i, shot in enumerate(wanted):
        start_s = time.perf_counter()
        store.make(shot)
        took_s = time.perf_counter() - start_s
        print(f"{i + 1} of {len(wanted)}: {shot.file_name}, {took_s:.1f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    here = Path(__file__).resolve().parent
    parser.add_argument("--images", type=Path, default=here / "metric_images", metavar="DIR")
    parser.add_argument("--figure", type=Path, default=here.parent / "docs/images/metrics.png")
    arguments = parser.parse_args()
    arguments.images.mkdir(parents=True, exist_ok=True)
    store = Store(arguments.images, clradar.open_device(None))
    make_images(store)


if __name__ == "__main__":
    main()
