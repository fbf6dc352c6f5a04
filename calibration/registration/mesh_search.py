"""Find roughly where a mesh stands in a measured picture, without a guess."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import fft

from calibration.registration.mesh_fit import FLOOR, MeshFit, first_brightness, fit_mesh
from calibration.registration.mesh_rendering import Aperture, MeshImage, Picture
from calibration.registration.rigid_motion import moved, rotation_about
from calibration.registration.starting_rotations import TILTS, start_rotations
from calibration.registration.surface import weighted_quantile
from clradar.tracing.visible_surface import VisibleSurface

COARSE_STEP_M = 4e-3
"""Pixels of the search: a resolution cell."""

COARSE_BLUR_M = 4e-3
COARSE_SAMPLES_PER_MM2 = 0.2
"""Three samples per pixel of the search."""

_TRIED = 6  # candidates that are refined on the coarse picture
_COARSE_STEPS = 12
_RANGE_SPREAD_M = 10e-3  # spread of the range differences at which a candidate scores nothing

Progress = Callable[[int, int], None]


def search(
    surface: VisibleSurface,
    picture: Picture,
    aperture: Aperture,
    search_deg: float,
    progress: Progress | None = None,
) -> list[MeshFit]:
    """Return coarse fits of the mesh, best first.

    Parameters
    ----------
    surface : VisibleSurface
        Coarsely sampled.
    picture : Picture
        With pixels of about `COARSE_STEP_M`.
    search_deg : float, degrees
        Largest rotation about boresight that is tried.
    progress : callable, optional
        Called with (done, total) rotations.

    Notes
    -----
    For every rotation the mesh's picture is slid over the measured one: the correlation of their
    decibels over all shifts comes from one Fourier transform, and the range from the median
    difference at the best shift.
    """
    image = MeshImage(surface, picture, aperture, COARSE_BLUR_M)
    measured = np.log1p(image.power / FLOOR)
    size = tuple(fft.next_fast_len(2 * n, real=True) for n in measured.shape)
    spectrum = fft.rfft2(measured, size)
    middle_m = surface.points_m.mean(axis=0)
    target_m = _middle_of(picture, aperture)
    rotations = start_rotations(search_deg)
    turns_per_tilt = len(rotations) // TILTS
    scored: list[tuple[float, np.ndarray]] = []
    # As given stays in the race: where the mesh is in place already, the search can only lose.
    image.look(np.eye(4))
    if image.n_seen:
        scored.append((_score(image, measured, np.eye(4)), np.eye(4)))
    for done, rotation in enumerate(rotations):
        start = rotation_about(rotation, middle_m, target_m)
        # A turn about boresight changes little of what is seen, a tilt does.
        if done % turns_per_tilt == 0:
            image.look(start)
        if image.n_seen:
            start = _slid(image, start, measured, spectrum, size)
            scored.append((_score(image, measured, start), start))
        if progress is not None:
            progress(done + 1, len(rotations))
    scored.sort(key=lambda pair: -pair[0])
    starts = [scored[i][1] for i in range(min(_TRIED, len(scored)))]
    fits = []
    for start in starts:
        image.look(start)
        if image.n_seen:
            fits.append(fit_mesh(image, start, first_brightness(), _COARSE_STEPS))
    return sorted(fits, key=lambda fit: fit.loss)


def _middle_of(picture: Picture, aperture: Aperture) -> np.ndarray:
    x, y = np.meshgrid(picture.x_m, picture.y_m)
    kept = np.isfinite(picture.range_m)
    weights = np.sqrt(picture.power[kept])
    lateral = np.stack([x[kept], y[kept]], axis=1) - aperture.centre_m[:2]
    depth = np.sqrt(np.maximum(picture.range_m[kept] ** 2 - (lateral**2).sum(axis=1), 0.0))
    points = np.concatenate([lateral, depth[:, None]], axis=1)
    middle = np.array([weighted_quantile(values, weights, 0.5) for values in points.T])
    return middle + aperture.centre_m


def _slid(
    image: MeshImage,
    start: np.ndarray,
    measured: np.ndarray,
    spectrum: np.ndarray,
    size: tuple[int, ...],
) -> np.ndarray:
    """Return `start` shifted to where the two pictures correlate best, and to the same range."""
    power, _ = image.of(start, first_brightness())
    drawn = np.log1p(power / power.max() / FLOOR)
    product = fft.irfft2(spectrum * np.conj(fft.rfft2(drawn, size)), size)
    row, column = np.unravel_index(int(product.argmax()), size)
    rows, columns = (
        int(k) - n if k > n // 2 else int(k) for k, n in zip((row, column), size, strict=True)
    )
    step_x, step_y = image.picture.step_m
    shifted = start.copy()
    shifted[:2, 3] += [columns * step_x, rows * step_y]
    _, range_m, both = _compared(image, shifted)
    if both.any():
        away_m = np.median(image.picture.range_m[both] - range_m[both])
        middle = moved(shifted, image.surface.points_m).mean(axis=0) - image.aperture.centre_m
        shifted[:3, 3] += away_m * middle / np.linalg.norm(middle)
    return shifted


def _compared(image: MeshImage, transform: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    power, range_m = image.of(transform, first_brightness())
    power = power / power.max()
    return power, range_m, np.isfinite(image.picture.range_m) & (power > FLOOR)


def _score(image: MeshImage, measured: np.ndarray, transform: np.ndarray) -> float:
    """Return the correlation of the decibels, less what the ranges disagree."""
    power, range_m, both = _compared(image, transform)
    drawn = np.log1p(power / FLOOR)
    likeness = (drawn * measured).sum() / np.sqrt((drawn**2).sum() * (measured**2).sum())
    if not both.any():
        return -1.0
    apart = np.abs(image.picture.range_m[both] - range_m[both])
    return float(likeness - min(1.0, np.median(apart) / _RANGE_SPREAD_M))
