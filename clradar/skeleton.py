"""Which few of many antennas, or frequencies, can stand for all: interpolative decomposition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

QUANTUM = 2.0**-18
"""Samples are rounded to multiples of this (2e-6 RMS, far below any tolerance). Then their products
add up without rounding, up to 2^17 samples, so neither the order of summation nor the number of the
library's threads can change what is chosen between equals."""

SLACK = 1.25
"""How much larger the error may be on samples that had no part in the choice."""

ROUNDS = 6
"""How often the samples are doubled before all points are kept."""


@dataclass(frozen=True, slots=True)
class Skeleton:
    """Chosen points, and how the others follow from them.

    Attributes
    ----------
    index : ndarray, shape (n_chosen,), int
        Ascending.
    weights : ndarray, shape (n, n_chosen), float64
        f[i] is close to sum_j weights[i, j] f[index[j]] for every f of the kind that was sampled.
    """

    index: np.ndarray
    weights: np.ndarray


def skeleton(draw: Callable[[], np.ndarray], tolerance: float) -> Skeleton:
    """Return few of n points from which functions of one kind follow to `tolerance`.

    Parameters
    ----------
    draw : callable
        Returns new samples of the functions at the n points, shape (n_samples, n), complex, of
        modulus one. Their conjugates count as of the same kind, so the weights are real.
    tolerance : float
        RMS of the error over functions and points, checked on samples that had no part in the
        choice: as long as it fails there, they are added and the choice is made again.
    """
    samples = _rounded(draw())
    for _ in range(ROUNDS):
        found = decompose(samples, tolerance)
        fresh = _rounded(draw())
        error = fresh - fresh[:, found.index] @ found.weights.T
        if np.sqrt(np.mean(error.real**2 + error.imag**2)) <= SLACK * tolerance:
            return found
        samples = np.concatenate([samples, fresh])
    n = samples.shape[1]
    return Skeleton(np.arange(n), np.eye(n))


def decompose(samples: np.ndarray, tolerance: float) -> Skeleton:
    """Return the fewest points, taken greedily, from which the samples follow to `tolerance`.

    Pivoted Cholesky decomposition of the samples' Gram matrix, which makes the choices of the
    pivoted QR decomposition in the reference below.

    References
    ----------
    H. Cheng, Z. Gimbutas, P. G. Martinsson, V. Rokhlin, "On the compression of low rank matrices",
    SIAM J. Sci. Comput. 26 (2005) 1389.
    """
    from scipy.linalg import solve_triangular

    n_samples, n = samples.shape
    gram = (samples.real.T @ samples.real + samples.imag.T @ samples.imag) / n_samples
    left = np.diag(gram).copy()  # mean square of what does not follow yet, per point
    factor = np.zeros((n, n))
    chosen: list[int] = []
    while len(chosen) < n and (not chosen or left.sum() > n * tolerance**2):
        pivot = int(left.argmax())
        if left[pivot] <= 0:
            break
        known = factor[: len(chosen)]
        row = gram[pivot] - np.einsum("r,rn->n", known[:, pivot], known)
        factor[len(chosen)] = row / np.sqrt(left[pivot])
        left = np.maximum(left - factor[len(chosen)] ** 2, 0.0)
        chosen.append(pivot)
        left[chosen] = 0.0
    index = np.array(chosen)
    known = factor[: len(chosen)]
    weights = solve_triangular(known[:, index], known, check_finite=False).T
    weights[index] = np.eye(len(index))
    order = np.argsort(index)
    return Skeleton(index[order], weights[:, order])


def _rounded(samples: np.ndarray) -> np.ndarray:
    return (np.round(samples.real / QUANTUM) + 1j * np.round(samples.imag / QUANTUM)) * QUANTUM
