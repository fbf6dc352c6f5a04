"""Interpolative decomposition: a few points of a family of functions give the values at the rest.

H. Cheng, Z. Gimbutas, P. G. Martinsson, V. Rokhlin, "On the compression of low rank matrices",
SIAM J. Sci. Comput. 26 (2005) 1389.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

QUANTUM = 2.0**-18
"""Samples are rounded to multiples of this (2e-6 RMS, far below any tolerance). Then their products
add up without rounding, up to 2^17 samples, so neither the order of summation nor the number of the
library's threads can change which of two equal points is chosen."""

SLACK = 1.25  # how much larger the error may be on samples that the decomposition was not made from
SAMPLE_ROUNDS = 6  # how often samples are added before all points are kept
ONE_THREAD = 2**18
"""Multiplications up to which OpenBLAS keeps to one thread. Products here are small: waking other
threads, and waiting for them where the cores are busy, took four times as long as the rest."""

LEAST_SLICE = 8  # rows of a slice below which the products are large enough for threads
TIGHTEN = 0.5  # least factor by which the tolerance of one round is below that of the round before


@dataclass(frozen=True, slots=True)
class Decomposition:
    """The skeleton points, and the weights that interpolate from them.

    f[i] is close to sum_j weights[i, j] f[skeleton[j]] for every function f of the family.
    """

    skeleton: np.ndarray  # (n_chosen,), int: indices of the skeleton points, ascending
    weights: np.ndarray  # (n, n_chosen), float64


def decompose_sampled(draw: Callable[[], np.ndarray], tolerance: float) -> Decomposition:
    """Return the decomposition of families of functions that are known by random samples.

    `draw` returns new samples of the functions at the n points, float64, shape (n_families,
    n_samples, n): real and imaginary parts of functions of modulus one as separate samples, so the
    weights are real. `tolerance` is the RMS of the error over functions and points, for each family
    alone, checked on new samples: while it is exceeded, they are added and the decomposition is
    made again, for a smaller error where one family is harder than the rest.
    """
    samples = _rounded(draw())
    n = samples.shape[-1]
    target = tolerance
    for _ in range(SAMPLE_ROUNDS):
        found = decompose(samples.reshape(-1, n), target)
        fresh = _rounded(draw())
        interpolated = matrix_product(fresh[..., found.skeleton], found.weights.T)
        error = float(phasor_rms(fresh - interpolated).max())
        if error <= SLACK * tolerance:
            return found
        samples = np.concatenate([samples, fresh], axis=1)
        target *= max(TIGHTEN, tolerance / error)
    return Decomposition(np.arange(n), np.eye(n))


def decompose(samples: np.ndarray, tolerance: float) -> Decomposition:
    """Return the decomposition of a matrix, shape (n_samples, n), to an RMS error of `tolerance`.

    Pivoted Cholesky decomposition of the Gram matrix, which chooses the columns that a pivoted QR
    decomposition of the samples does.
    """
    n_samples, n = samples.shape
    gram = 2.0 / n_samples * _gram_matrix(samples)
    rest = np.diag(gram).copy()  # mean square of what the chosen points do not explain, per point
    factor = np.zeros((n, n))
    chosen: list[int] = []
    while len(chosen) < n and (not chosen or rest.sum() > n * tolerance**2):
        pivot = int(rest.argmax())
        if rest[pivot] <= 0:
            break
        known = factor[: len(chosen)]
        row = gram[pivot] - np.einsum("r,rn->n", known[:, pivot], known)
        factor[len(chosen)] = row / np.sqrt(rest[pivot])
        rest = np.maximum(rest - factor[len(chosen)] ** 2, 0.0)
        chosen.append(pivot)
        rest[chosen] = 0.0
    if not chosen:  # functions that are zero everywhere
        return Decomposition(np.zeros(1, int), np.eye(n)[:, :1])
    index = np.array(chosen)
    solved = factor[: len(chosen)].copy()
    triangle = factor[: len(chosen), index]
    for at in reversed(range(len(index))):
        solved[at] /= triangle[at, at]
        solved[:at] -= np.outer(triangle[:at, at], solved[at])
    weights = solved.T
    weights[index] = np.eye(len(index))
    order = np.argsort(index)
    return Decomposition(index[order], weights[:, order])


def phasor_rms(error: np.ndarray) -> np.ndarray:
    """Return the RMS error of each family, shape (n_families,), relative to phasors of modulus one.

    `error` has real and imaginary parts as separate samples, shape (n_families, n_samples, n).
    """
    return np.sqrt(2.0 * np.mean(error * error, axis=(1, 2)))


def matrix_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b, for b of two dimensions, in slices that OpenBLAS computes with one thread."""
    rows = a.reshape(-1, a.shape[-1])
    at_once = max(1, ONE_THREAD // b.size)
    if at_once < LEAST_SLICE:
        return a @ b
    out = np.empty((len(rows), b.shape[1]))
    for start in range(0, len(rows), at_once):
        part = slice(start, start + at_once)
        np.matmul(rows[part], b, out=out[part])
    return out.reshape(*a.shape[:-1], b.shape[1])


def _gram_matrix(samples: np.ndarray) -> np.ndarray:
    n_samples, n = samples.shape
    at_once = max(1, ONE_THREAD // (n * n))
    if at_once < LEAST_SLICE:
        at_once = n_samples
    out = np.zeros((n, n))
    for start in range(0, n_samples, at_once):
        part = samples[start : start + at_once]
        out += part.T @ part
    return out


def _rounded(samples: np.ndarray) -> np.ndarray:
    return np.round(samples / QUANTUM) * QUANTUM
