"""One image of several captures, such as those of clusters of antennas."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np

from clradar.model import AntennaArray, Capture
from clradar.model.range_profile import antenna_subset

Captures: TypeAlias = Capture | Sequence[Capture]
"""One capture, or several of which one image is formed."""

KEPT_PAIRS = 1024
"""Of each of several captures, for what is looked at beside the image: 1 MB of 128 frequencies."""


def captures_of(capture: Captures) -> tuple[Capture, ...]:
    """The captures whose pairs an image is the sum over."""
    return (capture,) if isinstance(capture, Capture) else tuple(capture)


class KeptCaptures:
    """What is kept of captures that pass one by one: all antennas, samples of some pairs."""

    def __init__(self) -> None:
        self.arrays: list[AntennaArray] = []
        self.captures: list[Capture] = []

    def add(self, capture: Capture) -> None:
        """Keep what is needed of one more."""
        self.arrays.append(capture.array)
        self.captures.append(antenna_subset(capture, KEPT_PAIRS))


def mean_over_pairs(images: Iterable[tuple[np.ndarray, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Return the image of all pairs of several captures: the mean of theirs, weighted by samples.

    Of each there is its image, complex64, and the number of its samples; only planes of it are
    copied at a time, to a result of `shape` (n_z, n_y, n_x). They are summed in their order: bits
    depend on it.
    """
    total, n_all = np.zeros(shape, np.complex128), 0
    for image, n_samples in images:
        for summed, plane in zip(total, image, strict=True):
            summed += plane * float(n_samples)
        n_all += n_samples
        del image  # before the next is formed
    mean = np.empty(shape, np.complex64)
    for plane, summed in zip(mean, total, strict=True):
        plane[...] = summed / max(n_all, 1)
    return mean
