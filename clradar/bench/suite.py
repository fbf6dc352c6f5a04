"""Which benchmarks there are, and running some of them on a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import clradar
from clradar.bench import rays, rows
from clradar.bench.rows import ARRAY, WAVEFORM, Row


@dataclass(frozen=True, slots=True)
class Effort:
    """How much work: smaller sizes for a first look, and how often each is timed."""

    quick: bool
    repeats: int


def noise() -> clradar.Capture:
    """Return a capture of noise: every voxel of its images matters alike."""
    rng = np.random.default_rng(1)
    re, im = rng.normal(size=(2, ARRAY.n_tx, ARRAY.n_rx, WAVEFORM.n_freq)).astype(np.float32)
    return clradar.Capture(re + 1j * im, ARRAY, WAVEFORM)


def _visibility(device: clradar.Device, effort: Effort) -> list[Row]:
    return rays.visibility(device, effort.repeats, 8192 if effort.quick else 65536)


def _bounces(device: clradar.Device, effort: Effort) -> list[Row]:
    return rays.bounces(device, effort.repeats, 200_000 if effort.quick else 2_000_000)


def _trees(device: clradar.Device, effort: Effort) -> list[Row]:
    return rays.trees(device, effort.repeats, (224,) if effort.quick else (224, 708))


def _growth(device: clradar.Device, effort: Effort) -> list[Row]:
    return rays.growth(device, effort.repeats, (50, 158) if effort.quick else (158, 500, 1581))


def _phasor_sum(device: clradar.Device, effort: Effort) -> list[Row]:
    return rows.phasor_sum(device, effort.repeats, 500_000 if effort.quick else 5_000_000)


def _images(device: clradar.Device, effort: Effort) -> list[Row]:
    return rows.images(device, effort.repeats, noise(), 5 if effort.quick else 81)


def _exact(device: clradar.Device, effort: Effort) -> list[Row]:
    return [rows.exact_image(device, effort.repeats, noise())]


def _commands(device: clradar.Device, effort: Effort) -> list[Row]:
    return [] if effort.quick else rows.commands(device)


SUITE: dict[str, Callable[[clradar.Device, Effort], list[Row]]] = {
    "visibility": _visibility,
    "bounces": _bounces,
    "trees": _trees,
    "growth": _growth,
    "phasors": _phasor_sum,
    "images": _images,
    "exact": _exact,
    "commands": _commands,
}


def run(device: clradar.Device, names: Sequence[str], effort: Effort) -> Iterator[Row]:
    """Yield the rows of some benchmarks, each as it is done."""
    for name in names:
        yield from SUITE[name](device, effort)
