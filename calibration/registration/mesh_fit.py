"""Fit of a mesh rendering to a measured image by Fisher scoring on speckle and range.

Brightness has the exponential distribution of fully developed speckle: J. W. Goodman, "Speckle
Phenomena in Optics", 2007.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.registration.depth_surface import not_aligned
from calibration.registration.mesh_rendering import KNOTS_RAD, Canvas, MeshRendering
from calibration.registration.rigid_motion import exp_twist, orthonormal

POWER_FLOOR = 10.0 ** (-15.0 / 10.0)
"""Power added to both images, relative to the maximum: the level of the sidelobes, below which the
mesh does not determine the measurement."""

RANGE_STD_M = 2e-3
"""Scatter of the range of bright pixels: the interference of the surface in a resolution cell,
4 x 4 x 15 mm, moves its maximum by up to some millimetres (docs/registration-method.md)."""

RANGE_HALF_POWER = 0.05  # power at which the variance of the range is doubled
TUKEY_CUTOFF = 4.0
CAUCHY_SCALE = 2.0
"""Of the speckle residual m / I - 1, whose standard deviation is 1: for unmodelled glints it can be
ten."""

MOST_DARK = 8.0
"""Largest fall of the log brightness below its maximum, e^-8 (-35 dB): more is unobservable."""

SMOOTH = 0.2
FALL_PER_KNOT = 0.7  # weak prior of the log brightness: it falls by 0.7 +- 2.2 from knot to knot
_ROTATION_STEP_RAD, _SHIFT_STEP_M = 2e-3, 1e-4  # of the numerical derivatives
_VISIBILITY_STEP_M = 2e-4  # after which visibility is updated
_MOST_ROTATION_RAD, _MOST_SHIFT_M, _MOST_LOG = 0.07, 4e-3, 1.5  # of one step
ROTATION_TOLERANCE_RAD, SHIFT_TOLERANCE_M = 2e-4, 1e-5
"""Converged below: a twentieth of the smallest standard deviation in simulations."""


def initial_log_brightness() -> np.ndarray:
    """Initial log brightness at `KNOTS_RAD`: a specular lobe of 20 degrees over a faint rest."""
    return np.log(np.exp(-((KNOTS_RAD / 0.35) ** 2)) + 0.02)


@dataclass(frozen=True, slots=True, eq=False)
class MeshFit:
    """The fitted pose and brightness.

    `transform`, shape (4, 4), of the mesh as given; `log_brightness`, shape (n_knots,); `centre_m`,
    shape (3,), the mean of the visible samples and centre of twists; `loss`, robust deviance per
    resolution cell, smaller is better.
    """

    transform: np.ndarray
    log_brightness: np.ndarray
    centre_m: np.ndarray
    loss: float
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of every pixel and their scales."""

    speckle: np.ndarray
    dark: np.ndarray
    range_m: np.ndarray
    range_std_m: np.ndarray
    covered: np.ndarray
    measured: np.ndarray

    @property
    def speckle_weights(self) -> np.ndarray:
        return 1.0 / (1.0 + (self.speckle / CAUCHY_SCALE) ** 2)

    @property
    def range_weights(self) -> np.ndarray:
        tukey = np.maximum(1.0 - (self.range_m / self.range_std_m / TUKEY_CUTOFF) ** 2, 0.0) ** 2
        return np.where(self.measured, tukey * self.covered, 0.0)

    def loss(self) -> float:
        """Sum of both robust losses over the pixels."""
        half = 0.5 * CAUCHY_SCALE**2
        speckle = half * np.log1p((self.speckle / CAUCHY_SCALE) ** 2)
        inside = np.maximum(1.0 - (self.range_m / self.range_std_m / TUKEY_CUTOFF) ** 2, 0.0)
        # A measured pixel that the mesh does not cover costs as much as an outlier.
        off = TUKEY_CUTOFF**2 / 6.0 * (1.0 - self.covered * inside**3)
        return float(speckle.sum() + off[self.measured].sum())


def residuals(image: Canvas, power: np.ndarray, range_m: np.ndarray) -> Residuals:
    """Residuals of the measured image against a rendering."""
    dark = power + POWER_FLOOR
    measured = np.isfinite(image.measured.range_m)
    return Residuals(
        speckle=(image.power - power) / dark,
        dark=dark,
        range_m=np.where(measured, image.measured.range_m - range_m, 0.0),
        range_std_m=RANGE_STD_M * np.sqrt(1.0 + RANGE_HALF_POWER / np.maximum(image.power, 1e-4)),
        covered=np.minimum(power / POWER_FLOOR, 1.0),
        measured=measured,
    )


def fit_mesh(
    image: MeshRendering,
    transform: np.ndarray,
    log_brightness: np.ndarray,
    max_iterations: int,
    constrained: np.ndarray | None = None,
) -> MeshFit:
    """Fit pose and brightness from a start.

    Parameters
    ----------
    constrained : ndarray, shape (6, k), optional
        Twists (radians, metres) along which the mesh does not move.
    """
    pixels_per_cell = cell_pixels(image)
    updated_at = np.full((4, 4), np.inf)
    scaled = False
    converged, iteration = False, 0
    n = 6 + len(KNOTS_RAD)
    while not converged and iteration < max_iterations:
        if np.abs(transform - updated_at).max() > _VISIBILITY_STEP_M:
            image.update_visibility(transform)
            updated_at = transform
        power, range_m = image.render(transform, log_brightness)
        if not scaled:
            log_brightness = log_brightness + np.log(image.power.sum() / power.sum())
            power, range_m = image.render(transform, log_brightness)
            scaled = True
        centre_m = image.visible_points_m(transform).mean(axis=0)
        found = residuals(image, power, range_m)
        by_power, by_range = _derivatives(
            image, transform, log_brightness, centre_m, power, range_m
        )
        by_power = by_power / found.dark.ravel()
        speckle_weights = found.speckle_weights.ravel() / pixels_per_cell
        range_weights = (found.range_weights / found.range_std_m**2).ravel() / pixels_per_cell
        information = (by_power * speckle_weights) @ by_power.T
        information += (by_range * range_weights) @ by_range.T
        score = (by_power * speckle_weights) @ found.speckle.ravel()
        score += (by_range * range_weights) @ found.range_m.ravel()
        fall = np.diff(np.eye(n)[6:], axis=0)
        information += SMOOTH * fall.T @ fall
        score -= SMOOTH * fall.T @ (np.diff(log_brightness) + FALL_PER_KNOT)
        basis = np.eye(n) if constrained is None else _unconstrained(constrained, n)
        try:
            step = basis @ np.linalg.solve(basis.T @ information @ basis, basis.T @ score)
        except np.linalg.LinAlgError as error:
            raise not_aligned("the fit of the mesh to the image has no unique step") from error
        angle_rad, shift_m = np.linalg.norm(step[:3]), np.linalg.norm(step[3:6])
        longest = max(angle_rad / _MOST_ROTATION_RAD, shift_m / _MOST_SHIFT_M)
        step = step / max(1.0, longest, np.abs(step[6:]).max() / _MOST_LOG)
        transform = orthonormal(exp_twist(step[:6], centre_m) @ transform)
        log_brightness = log_brightness + step[6:]
        log_brightness = np.maximum(log_brightness, log_brightness.max() - MOST_DARK)
        iteration += 1
        converged = bool(angle_rad < ROTATION_TOLERANCE_RAD and shift_m < SHIFT_TOLERANCE_M)
    return MeshFit(
        transform=transform,
        log_brightness=log_brightness,
        centre_m=centre_m,
        loss=found.loss() / pixels_per_cell,
        iterations=iteration,
        converged=converged,
    )


def shared_information(image: MeshRendering, fit: MeshFit) -> np.ndarray:
    """Information on the motion that two halves of the samples share, (6, 6).

    The rendering of a rotating sphere is constant but for the pattern of its samples, which would
    count as information. The patterns of the two halves are independent: their product is unbiased.
    """
    image.update_visibility(fit.transform)
    found = residuals(image, *image.render(fit.transform, fit.log_brightness))
    halves = []
    for every in (slice(0, None, 2), slice(1, None, 2)):
        image.update_visibility(fit.transform, every)
        brightness = fit.log_brightness + np.log(2.0)
        power, range_m = image.render(fit.transform, brightness)
        by_power, by_range = _derivatives(
            image, fit.transform, brightness, fit.centre_m, power, range_m
        )
        halves.append((by_power / found.dark.ravel(), by_range))
    image.update_visibility(fit.transform)
    (power_a, range_a), (power_b, range_b) = halves
    weight = found.range_weights / found.range_std_m**2
    product = (power_a * found.speckle_weights.ravel()) @ power_b.T
    product = (product + (range_a * weight.ravel()) @ range_b.T) / cell_pixels(image)
    fall = np.diff(np.eye(len(product))[6:], axis=0)
    information = 0.5 * (product + product.T) + SMOOTH * fall.T @ fall
    # Marginal over the brightness: the Schur complement.
    motion, mixed, rest = information[:6, :6], information[:6, 6:], information[6:, 6:]
    return motion - mixed @ np.linalg.solve(rest, mixed.T)


def cell_pixels(image: Canvas) -> float:
    """Pixels per resolution cell, at least one."""
    step_x, step_y = image.measured.step_m
    return max(1.0, image.aperture.cell_m2(image.reference_m) / (step_x * step_y))


def _unconstrained(constrained: np.ndarray, n: int) -> np.ndarray:
    """Basis, shape (n, n - k), of the steps orthogonal to `constrained`, (6, k)."""
    rows = np.zeros((constrained.shape[1], n))
    rows[:, :6] = constrained.T
    return np.linalg.svd(rows)[2][constrained.shape[1] :].T


def _derivatives(
    image: MeshRendering,
    transform: np.ndarray,
    log_brightness: np.ndarray,
    centre_m: np.ndarray,
    power: np.ndarray,
    range_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of power and range by the twist and the brightness, (13, n_pixels)."""
    by_power, by_range = [], []
    for k in range(6):
        step = _ROTATION_STEP_RAD if k < 3 else _SHIFT_STEP_M
        twist = np.zeros(6)
        twist[k] = step
        ahead = image.render(exp_twist(twist, centre_m) @ transform, log_brightness)
        by_power.append((ahead[0] - power) / step)
        by_range.append((ahead[1] - range_m) / step)
    for d_power, d_moment in image.brightness_derivatives(transform, log_brightness):
        by_power.append(d_power)
        by_range.append((d_moment - (range_m - image.reference_m) * d_power) / power)
    rows = 6 + len(KNOTS_RAD)
    return np.array(by_power).reshape(rows, -1), np.array(by_range).reshape(rows, -1)
