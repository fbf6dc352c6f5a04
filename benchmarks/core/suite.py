"""The benchmarks by name, and running some of them on a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import clradar
from core import commands, images, operators, phasor_sums, physical, rays
from core.timing import Row


@dataclass(frozen=True, slots=True)
class Effort:
    """How much work: smaller sizes for a quick run, and how often each is timed."""

    quick: bool
    repeats: int


SUITE: dict[str, Callable[[clradar.Device, int, bool], list[Row]]] = {
    "visibility": lambda device, n, quick: rays.visibility(device, n, 8192 if quick else 65536),
    "bounces": lambda device, n, quick: rays.bounces(device, n, 200_000 if quick else 2_000_000),
    "trees": lambda device, n, quick: rays.trees(device, n, (224,) if quick else (224, 708)),
    "growth": lambda device, n, quick: rays.growth(
        device, n, (50, 158) if quick else (158, 500, 1581)
    ),
    "phasors": lambda device, n, quick: phasor_sums.phasor_sum(
        device, n, 500_000 if quick else 5_000_000
    ),
    "images": lambda device, n, quick: images.images(device, n, images.noise(), 5 if quick else 81),
    "operators": lambda device, n, quick: operators.operators(
        device, n, 5 if quick else 81, 500 if quick else 2000
    ),
    "exact": lambda device, n, quick: [images.exact_image(device, n, images.noise())],
    "physical": lambda device, n, quick: physical.physical(device, n, 1.0 if quick else 4.0),
    "commands": lambda device, n, quick: [] if quick else commands.commands(device),
}


def run_suite(device: clradar.Device, names: Sequence[str], effort: Effort) -> Iterator[Row]:
    """Yield the rows of some benchmarks, each as it is done."""
    for name in names:
        yield from SUITE[name](device, effort.repeats, effort.quick)
