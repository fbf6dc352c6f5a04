"""One image of several captures, such as those of clusters of antennas."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def mean_over_pairs(images: Iterable[tuple[np.ndarray, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Return the image of all pairs of several captures: the mean of theirs, weighted by samples.

    Parameters
    ----------
    images : iterable of (ndarray, int)
        Of each capture its image, complex64, and the number of its samples.
    shape : tuple of int
        (n_z, n_y, n_x), of which only planes are copied.

    Returns
    -------
    ndarray, complex64
        Summed in the order of the captures: bits depend on it.
    """
    total, n_all = np.zeros(shape, np.complex128), 0
    for image, n_samples in images:
        for summed, plane in zip(total, image, strict=True):
            summed += plane * float(n_samples)
        n_all += n_samples
        del image  # before the next is formed
    mean = np.empty(shape, np.complex64)
    for plane, summed in zip(mean, total, strict=True):
        plane[...] = summed / n_all
    return mean
