"""Tx/Rx symmetry of an array, and a test for swapped axes where few antennas break it.

Data whose axes are swapped are imaged with the path segments (rx_i, tx_j) in place of (tx_i, rx_j).
If an isometry g of space has g(tx_i) = rx_i and g(rx_j) = tx_j, every path length to g(v) is that
to v: the image is the right one, moved by g, and exactly as sharp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.conventions.search_region import window_of
from clradar.backproject import frequency_weights
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Capture

SAME_PLACE = 1 / 200
"""Antennas that the isometry maps closer than this many wavelengths coincide: path segments that
differ by so little differ in phase by 0.03 rad at most."""

TRIMMING_ROUNDS = 5

RIDGE = 1e-2
"""Ridge (Tikhonov) term of the fit of point reflectivities, relative to the mean diagonal of its
normal matrix: the responses of neighbouring voxels are nearly collinear."""


@dataclass(frozen=True, slots=True, eq=False)
class SwapIsometry:
    """The isometry g(v) = matrix v + shift that maps most Tx on Rx and Rx on Tx.

    `matrix`, shape (3, 3), is orthogonal with determinant 1 or -1; `shift_m`, shape (3,);
    `moved_tx`, `moved_rx`, shape (n,), antennas i for which g(tx_i) is not rx_i, g(rx_i) not tx_i.
    """

    matrix: np.ndarray
    shift_m: np.ndarray
    moved_tx: np.ndarray
    moved_rx: np.ndarray

    @property
    def exact(self) -> bool:
        return not (self.moved_tx.any() or self.moved_rx.any())

    def apply(self, points_m: np.ndarray) -> np.ndarray:
        return points_m @ self.matrix.T + self.shift_m


def swap_isometry(array: AntennaArray, wavelength_m: float) -> SwapIsometry | None:
    """Find the isometry that maps at least half of the antennas, None if there is none.

    Trimmed orthogonal Procrustes fit, iterated on the better half of the antennas; reflections are
    allowed, but none that maps what is in front of the array behind it.
    """
    if array.n_tx != array.n_rx:
        return None
    source = np.concatenate([array.tx_m, array.rx_m])
    target = np.concatenate([array.rx_m, array.tx_m])
    kept = np.ones(len(source), dtype=bool)
    for _ in range(TRIMMING_ROUNDS):
        matrix, shift_m = _procrustes(source[kept], target[kept])
        off_m = np.linalg.norm(source @ matrix.T + shift_m - target, axis=1)
        kept = off_m <= max(float(np.median(off_m)), 1e-9)
    moved = off_m > SAME_PLACE * wavelength_m
    if matrix[2, 2] <= 0 or 2 * np.count_nonzero(moved) > len(moved):
        return None
    n = array.n_tx
    return SwapIsometry(matrix, shift_m, moved[:n], moved[n:])


def _procrustes(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, stretch, vt = np.linalg.svd((target - b).T @ (source - a))
    matrix = u @ vt
    # For antennas in one plane a reflection at that plane is free: keep boresight in front.
    flat = stretch[2] <= 1e-9 * max(float(stretch[0]), 1e-30)
    if flat and matrix[2, 2] < 0:
        matrix = u @ np.diag([1.0, 1.0, -1.0]) @ vt
    return matrix, b - matrix @ a


def swap_sigma(capture: Capture, isometry: SwapIsometry, points_m: np.ndarray) -> float:
    """Test statistic for swapped axes, in standard errors.

    The pairs that the isometry maps record the same under both hypotheses. The reflectivities of a
    few points, fitted to these pairs alone, predict the other pairs under either, p and p', and the
    real part of <s, p - p'> is positive if the axes are right and negative if they are swapped. Its
    standard error comes from the residuals of the better prediction, summed channel by channel, so
    that scatter among the channels counts whatever its cause (a cluster-robust error).

    Parameters
    ----------
    capture : Capture
        Axes as in the file; phase sign and frequency order corrected.
    isometry : SwapIsometry
        Not an exact one.
    points_m : ndarray, shape (n, 3), metres
        Bright voxels of the image with the axes as they are.

    Returns
    -------
    float
        Positive if the axes are right as they are.
    """
    array = capture.array
    weights = frequency_weights(window_of(capture.waveform), capture.waveform.n_freq)
    stay_tx, stay_rx = ~isometry.moved_tx, ~isometry.moved_rx
    changed = isometry.moved_tx[:, None] | isometry.moved_rx[None]
    there_m = isometry.apply(points_m)
    segments_m = [
        (_lengths(array.tx_m, points_m), _lengths(array.rx_m, points_m)),
        (_lengths(array.rx_m, there_m), _lengths(array.tx_m, there_m)),
    ]
    k = 2 * np.pi * capture.waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    s = np.ascontiguousarray(np.moveaxis(capture.data * weights, 2, 0)).astype(np.complex64)
    projected = np.zeros(len(points_m), dtype=np.complex128)
    normal = np.zeros((len(points_m), len(points_m)), dtype=np.complex128)
    for n, kn in enumerate(k):
        a, b = _phases(kn, segments_m[0][0])[stay_tx], _phases(kn, segments_m[0][1])[stay_rx]
        part = s[n][np.ix_(stay_tx, stay_rx)]
        projected += weights[n] * (a.conj() * (part @ b.conj())).sum(axis=0)
        normal += weights[n] ** 2 * (a.conj().T @ a) * (b.conj().T @ b)
    normal += RIDGE * float(np.trace(normal).real) / len(normal) * np.eye(len(normal))
    points = np.linalg.solve(normal, projected).astype(np.complex64)
    predicted = np.zeros((2, len(k), *changed.shape), dtype=np.complex64)
    for n, kn in enumerate(k):
        for i, (first, second) in enumerate(segments_m):
            predicted[i, n] = weights[n] * ((_phases(kn, first) * points) @ _phases(kn, second).T)
    predicted *= changed
    s = s * changed
    energy = (np.abs(predicted) ** 2).sum(axis=(1, 2, 3), dtype=np.float64)
    if not energy.all():
        return 0.0
    predicted /= np.sqrt(energy)[:, None, None, None]
    fits = [np.vdot(p, s) for p in predicted]
    better = int(fits[1].real > fits[0].real)
    difference = predicted[0] - predicted[1]
    left = s - fits[better] * predicted[better]
    statistic = float(np.vdot(difference, s).real)
    # Sums per channel: moved Tx, then moved Rx with the Tx that stay.
    score = (difference.conj() * left).real.sum(axis=0, dtype=np.float64)
    channels = np.concatenate(
        [score[isometry.moved_tx].sum(axis=1), score[stay_tx][:, isometry.moved_rx].sum(axis=0)]
    )
    scatter = (channels**2).sum() * len(channels) / max(1, len(channels) - 1)
    error = float(np.sqrt(max(scatter, (score**2).sum())))
    return statistic / error if error > 0 else 0.0


def _lengths(antennas_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    return np.linalg.norm(antennas_m[:, None] - points_m[None], axis=2)


def _phases(k: float, lengths_m: np.ndarray) -> np.ndarray:
    return np.exp(-1j * k * lengths_m).astype(np.complex64)
