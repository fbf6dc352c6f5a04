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
"""How often samples are added before all points are kept."""

ONE_THREAD = 2**18
"""Multiplications up to which OpenBLAS keeps to one thread. Products here are small: waking others,
and waiting for them where the cores are busy, took four times as long as all else together."""

LEAST_SLICE = 8
"""Rows of a slice below which the products are large enough for threads."""

TIGHTEN = 0.5
"""Least factor by which the aim of one round is below that of the round before."""


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
    """Return few of n points from which functions of some kinds follow to `tolerance`.

    Parameters
    ----------
    draw : callable
        Returns new samples of the functions at the n points, float64, shape
        (n_kinds, n_samples, n): real and imaginary parts of functions of modulus one, as samples by
        themselves, so the weights are real.
    tolerance : float
        RMS of the error over functions and points, for every kind by itself, checked on samples
        that had no part in the choice: as long as it fails there, they are added and the choice is
        made again, for a smaller error where one kind is harder than the others.
    """
    samples = _rounded(draw())
    n = samples.shape[-1]
    aim = tolerance
    for _ in range(ROUNDS):
        found = decompose(samples.reshape(-1, n), aim)
        fresh = _rounded(draw())
        error = float(rms(fresh - product(fresh[..., found.index], found.weights.T)).max())
        if error <= SLACK * tolerance:
            return found
        samples = np.concatenate([samples, fresh], axis=1)
        aim *= max(TIGHTEN, tolerance / error)
    return Skeleton(np.arange(n), np.eye(n))


def rms(error: np.ndarray) -> np.ndarray:
    """Return the RMS of every kind, shape (n_kinds,), of errors (n_kinds, n_samples, n) in samples
    whose RMS is that of a real or imaginary part, relative to the modulus one of the whole.
    """
    return np.sqrt(2.0 * np.mean(error * error, axis=(1, 2)))


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b, for b of two dimensions, in slices that the library does with one thread."""
    rows = a.reshape(-1, a.shape[-1])
    at_once = max(1, ONE_THREAD // b.size)
    if at_once < LEAST_SLICE:
        return a @ b
    out = np.empty((len(rows), b.shape[1]))
    for start in range(0, len(rows), at_once):
        part = slice(start, start + at_once)
        np.matmul(rows[part], b, out=out[part])
    return out.reshape(*a.shape[:-1], b.shape[1])


def _gram(samples: np.ndarray) -> np.ndarray:
    n_samples, n = samples.shape
    at_once = max(1, ONE_THREAD // (n * n))
    if at_once < LEAST_SLICE:
        at_once = n_samples
    out = np.zeros((n, n))
    for start in range(0, n_samples, at_once):
        part = samples[start : start + at_once]
        out += part.T @ part
    return out


def decompose(samples: np.ndarray, tolerance: float) -> Skeleton:
    """Return the fewest points, taken greedily, from which the samples follow to `tolerance`.

    Pivoted Cholesky decomposition of the samples' Gram matrix, which makes the choices of the
    pivoted QR decomposition in the reference below.

    References
    ----------
    H. Cheng, Z. Gimbutas, P. G. Martinsson, V. Rokhlin, "On the compression of low rank matrices",
    SIAM J. Sci. Comput. 26 (2005) 1389.
    """
    n_samples, n = samples.shape
    gram = 2.0 / n_samples * _gram(samples)
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
    solved, triangle = known.copy(), known[:, index]
    for row in reversed(range(len(index))):
        solved[row] /= triangle[row, row]
        solved[:row] -= np.outer(triangle[:row, row], solved[row])
    weights = solved.T
    weights[index] = np.eye(len(index))
    order = np.argsort(index)
    return Skeleton(index[order], weights[:, order])


def _rounded(samples: np.ndarray) -> np.ndarray:
    return np.round(samples / QUANTUM) * QUANTUM
