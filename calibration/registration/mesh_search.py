"""Global search for the pose of a mesh by cross-correlation of its rendering with an image."""

from __future__ import annotations

import numpy as np
from scipy import fft

from calibration.registration.mesh_fit import POWER_FLOOR, MeshFit, fit_mesh, initial_log_brightness
from calibration.registration.mesh_rendering import Aperture, MeasuredImage, MeshRendering
from calibration.registration.rigid_motion import moved, rotation_about
from calibration.registration.search_space import TILTS, start_rotations
from clradar.compare.images import weighted_quantile
from clradar.model.progress import Progress
from clradar.tracing.visible_surface import VisibleSurface

COARSE_STEP_M = 4e-3  # pixels of the search: a resolution cell
COARSE_BLUR_M = 4e-3
COARSE_SAMPLES_PER_MM2 = 0.2  # three samples per pixel of the search
TRIED = 6  # candidates that are refined on the coarse image
_COARSE_STEPS = 12
_RANGE_SPREAD_M = 10e-3  # median range difference that cancels a perfect correlation


def search(
    surface: VisibleSurface,
    measured: MeasuredImage,
    aperture: Aperture,
    search_deg: float,
    progress: Progress | None = None,
    tried: int = TRIED,
) -> list[MeshFit]:
    """Coarse fits of a coarsely sampled mesh, best first, with pixels of about `COARSE_STEP_M`.

    For every rotation, up to `search_deg` about boresight, the lateral shift is the maximum of the
    cross-correlation of rendering and image in decibels, by FFT, and the range shift the median
    difference there. The best `tried` are refined.
    """
    image = MeshRendering(surface, measured, aperture, COARSE_BLUR_M)
    log_power = np.log1p(image.power / POWER_FLOOR)
    size = tuple(fft.next_fast_len(2 * n, real=True) for n in log_power.shape)
    spectrum = fft.rfft2(log_power, size)
    middle_m = surface.points_m.mean(axis=0)
    target_m = _median_point_m(measured, aperture)
    rotations = start_rotations(search_deg)
    per_tilt = len(rotations) // TILTS
    scored: list[tuple[float, np.ndarray]] = []
    # The pose as given is a candidate, too: the mesh may be in place already.
    image.update_visibility(np.eye(4))
    if image.n_visible:
        scored.append((_score(image, log_power, np.eye(4)), np.eye(4)))
    for done, rotation in enumerate(rotations):
        start = rotation_about(rotation, middle_m, target_m)
        # A rotation about boresight changes visibility little, a tilt more.
        if done % per_tilt == 0:
            image.update_visibility(start)
        if image.n_visible:
            start = _shifted(image, start, spectrum, size)
            scored.append((_score(image, log_power, start), start))
        if progress is not None:
            progress(done + 1, len(rotations))
    scored.sort(key=lambda pair: -pair[0])
    starts = [scored[i][1] for i in range(min(tried, len(scored)))]
    fits = []
    for start in starts:
        image.update_visibility(start)
        if image.n_visible:
            fits.append(fit_mesh(image, start, initial_log_brightness(), _COARSE_STEPS))
    return sorted(fits, key=lambda fit: fit.loss)


def _median_point_m(measured: MeasuredImage, aperture: Aperture) -> np.ndarray:
    """Amplitude-weighted median of the depth points, coordinate by coordinate, shape (3,)."""
    x, y = np.meshgrid(measured.x_m, measured.y_m)
    kept = np.isfinite(measured.range_m)
    weights = np.sqrt(measured.power[kept])
    lateral = np.stack([x[kept], y[kept]], axis=1) - aperture.centre_m[:2]
    depth = np.sqrt(np.maximum(measured.range_m[kept] ** 2 - (lateral**2).sum(axis=1), 0.0))
    points = np.concatenate([lateral, depth[:, None]], axis=1)
    middle = np.array([weighted_quantile(values, weights, 0.5) for values in points.T])
    return middle + aperture.centre_m


def _shifted(
    image: MeshRendering, start: np.ndarray, spectrum: np.ndarray, size: tuple[int, ...]
) -> np.ndarray:
    """`start` shifted to the maximum of the cross-correlation, and to the same range."""
    power, _ = image.render(start, initial_log_brightness())
    drawn = np.log1p(power / power.max() / POWER_FLOOR)
    product = fft.irfft2(spectrum * np.conj(fft.rfft2(drawn, size)), size)
    row, column = np.unravel_index(int(product.argmax()), size)
    rows, columns = (
        int(k) - n if k > n // 2 else int(k) for k, n in zip((row, column), size, strict=True)
    )
    step_x, step_y = image.measured.step_m
    shifted = start.copy()
    shifted[:2, 3] += [columns * step_x, rows * step_y]
    _, range_m, both = _compared(image, shifted)
    if both.any():
        away_m = np.median(image.measured.range_m[both] - range_m[both])
        middle = moved(shifted, image.surface.points_m).mean(axis=0) - image.aperture.centre_m
        shifted[:3, 3] += away_m * middle / np.linalg.norm(middle)
    return shifted


def _compared(
    image: MeshRendering, transform: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    power, range_m = image.render(transform, initial_log_brightness())
    power = power / power.max()
    return power, range_m, np.isfinite(image.measured.range_m) & (power > POWER_FLOOR)


def _score(image: MeshRendering, log_power: np.ndarray, transform: np.ndarray) -> float:
    """Correlation in decibels, minus a penalty for the range difference."""
    power, range_m, both = _compared(image, transform)
    drawn = np.log1p(power / POWER_FLOOR)
    correlation = (drawn * log_power).sum() / np.sqrt((drawn**2).sum() * (log_power**2).sum())
    if not both.any():
        return -1.0
    apart = np.abs(image.measured.range_m[both] - range_m[both])
    return float(correlation - min(1.0, np.median(apart) / _RANGE_SPREAD_M))
