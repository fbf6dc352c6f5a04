"""Derivatives of a drawn picture by parameters that move its samples."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from calibration.registration.mesh_rendering import KNOTS_RAD, Canvas

_LEAST_SINE = 1e-6  # of the angle of incidence: what faces the radar is as bright from either side


def drawn_rates(
    canvas: Canvas,
    points_m: np.ndarray,
    normals: np.ndarray,
    rates: tuple[np.ndarray, np.ndarray],
    share: np.ndarray,
    log_brightness: np.ndarray,
) -> np.ndarray:
    """Derivatives of what `Canvas.splat` draws of samples, by k parameters, (k, 2, n_y, n_x).

    `rates` are the derivatives, (n, 3, k), of points and unit normals, (n, 3); `share`, (n,), is a
    factor of every sample's brightness.
    """
    inside, corners = canvas.corners(points_m)
    d_points, d_normals = rates
    if not inside.all():
        points_m, normals, share = points_m[inside], normals[inside], share[inside]
        d_points, d_normals = d_points[inside], d_normals[inside]
    range_m, angle = canvas.sight(points_m, normals)
    bright = share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
    d_range, d_angle = _sight_rates(canvas, points_m, normals, d_points, d_normals)
    n, k = d_range.shape
    # Power and power times range; by brightness, and by the place in pixels along x and y.
    columns = np.empty((3, n, 2, k))
    np.multiply(d_angle, (bright * _slope(angle, log_brightness))[:, None], out=columns[0, :, 0])
    for axis, step_m in enumerate(canvas.measured.step_m):
        np.multiply(d_points[:, axis], (bright / step_m)[:, None], out=columns[1 + axis, :, 0])
    np.multiply(columns[:, :, 0], range_m[:, None], out=columns[:, :, 1])
    columns[0, :, 1] += bright[:, None] * d_range
    n_y, n_x = canvas.measured.power.shape
    drawn = _weights(corners, n_y * n_x) @ columns.reshape(3 * n, 2 * k)
    return drawn.reshape(n_y, n_x, 2, k).transpose(3, 2, 0, 1)


def _sight_rates(
    canvas: Canvas,
    points_m: np.ndarray,
    normals: np.ndarray,
    d_points: np.ndarray,
    d_normals: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of range, metres, and angle of incidence, as of `Canvas.sight`, (n, k)."""
    sight_m = points_m - canvas.aperture.centre_m
    from_centre_m = np.linalg.norm(sight_m, axis=1, keepdims=True)
    sight = sight_m / from_centre_m
    cosine = (normals * sight).sum(axis=1, keepdims=True)
    d_range = np.einsum("nik,ni->nk", d_points, sight)
    d_cosine = np.einsum("nik,ni->nk", d_normals, sight)
    d_cosine += np.einsum("nik,ni->nk", d_points, (normals - cosine * sight) / from_centre_m)
    d_cosine *= -np.sign(cosine) / np.sqrt(np.maximum(1.0 - cosine**2, _LEAST_SINE**2))
    return d_range, d_cosine


def _slope(angle: np.ndarray, log_brightness: np.ndarray) -> np.ndarray:
    """Derivative of the interpolated log brightness by the angle, (n,)."""
    slopes = np.concatenate([[0.0], np.diff(log_brightness) / np.diff(KNOTS_RAD), [0.0]])
    return slopes[np.searchsorted(KNOTS_RAD, angle, side="right")]


def _weights(corners: list[tuple[np.ndarray, np.ndarray]], n_pixels: int) -> csc_array:
    """Matrix (n_pixels, 3 n): samples' bilinear shares, and their derivatives along x and y.

    The derivatives are by the place in pixels.
    """
    pixels = np.stack([pixel for pixel, _ in corners], axis=1)
    shares = np.stack([share for _, share in corners], axis=1)
    right, high = shares[:, 1] + shares[:, 3], shares[:, 2] + shares[:, 3]
    by_x = np.stack([high - 1.0, 1.0 - high, -high, high], axis=1)
    by_y = np.stack([right - 1.0, -right, 1.0 - right, right], axis=1)
    values = np.concatenate([shares, by_x, by_y])
    return csc_array(
        (values.ravel(), np.tile(pixels.ravel(), 3), 4 * np.arange(len(values) + 1)),
        shape=(n_pixels, len(values)),
    )
