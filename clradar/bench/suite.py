"""The benchmarks by name, and running some of them on a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import clradar
from clradar.bench import rays, rows
from clradar.bench.rows import ARRAY, WAVEFORM, Row


@dataclass(frozen=True, slots=True)
class Effort:
    """How much work: smaller sizes for a quick run, and how often each is timed."""

    quick: bool
    repeats: int


def noise() -> clradar.Capture:
    """A capture of noise: all voxels of its images have the same expected power."""
    rng = np.random.default_rng(1)
    re, im = rng.normal(size=(2, ARRAY.n_tx, ARRAY.n_rx, WAVEFORM.n_freq)).astype(np.float32)
    return clradar.Capture(re + 1j * im, ARRAY, WAVEFORM)


SUITE: dict[str, Callable[[clradar.Device, int, bool], list[Row]]] = {
    "visibility": lambda device, n, quick: rays.visibility(device, n, 8192 if quick else 65536),
    "bounces": lambda device, n, quick: rays.bounces(device, n, 200_000 if quick else 2_000_000),
    "trees": lambda device, n, quick: rays.trees(device, n, (224,) if quick else (224, 708)),
    "growth": lambda device, n, quick: rays.growth(
        device, n, (50, 158) if quick else (158, 500, 1581)
    ),
    "phasors": lambda device, n, quick: rows.phasor_sum(device, n, 500_000 if quick else 5_000_000),
    "images": lambda device, n, quick: rows.images(device, n, noise(), 5 if quick else 81),
    "exact": lambda device, n, quick: [rows.exact_image(device, n, noise())],
    "commands": lambda device, n, quick: [] if quick else rows.commands(device),
}


def run_suite(device: clradar.Device, names: Sequence[str], effort: Effort) -> Iterator[Row]:
    """Yield the rows of some benchmarks, each as it is done."""
    for name in names:
        yield from SUITE[name](device, effort.repeats, effort.quick)
