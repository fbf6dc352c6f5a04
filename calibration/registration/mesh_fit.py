"""Fit the picture of a mesh to a measured one: Fisher scoring on speckle and on range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.registration.mesh_rendering import KNOTS_RAD, MeshImage
from calibration.registration.rigid_motion import exp_twist, orthonormal

FLOOR = 10.0 ** (-15.0 / 10.0)
"""Power below which a pixel counts as dark, relative to the maximum: sidelobes of the brightest
parts are there, and no measurement has to follow the mesh further down."""

RANGE_STD_M = 2e-3
"""Scatter of the range of bright pixels. The surface inside a resolution cell, 4 x 4 x 15 mm,
interferes, and its maximum is found up to some millimetres off (docs/calibration.md)."""

RANGE_HALF_POWER = 0.05
"""Power at which the variance of the range has doubled."""

TUKEY_CUTOFF = 4.0
CAUCHY_SCALE = 2.0
"""Of the speckle's residual m / I - 1, whose standard deviation is 1: glints that the picture
does not know can be ten."""

MOST_DARK = 8.0
"""No knot is darker than e^-8 (-35 dB) of the brightest: nothing there tells how dark."""

SMOOTH = 0.2
FALL_PER_KNOT = 0.7
"""Weak prior of the logarithmic brightness: neighbouring knots fall by 0.7, give or take 2.2."""

TURN_STEP_RAD, SHIFT_STEP_M = 2e-3, 1e-4
_LOOK_AGAIN_M = 2e-4
_MOST_TURN_RAD, _MOST_SHIFT_M, _MOST_LOG = 0.07, 4e-3, 1.5
TURN_TOLERANCE_RAD, SHIFT_TOLERANCE_M = 2e-4, 1e-5
"""Converged below: a twentieth of the smallest standard deviation that was seen."""


def first_brightness() -> np.ndarray:
    """Return a guess of the logarithmic brightness: a glint of 20 degrees over a faint rest."""
    return np.log(np.exp(-((KNOTS_RAD / 0.35) ** 2)) + 0.02)


@dataclass(frozen=True, slots=True, eq=False)
class MeshFit:
    """Where a mesh came to rest.

    Attributes
    ----------
    transform : ndarray, shape (4, 4)
        From where the mesh was given.
    log_brightness : ndarray, shape (n_knots,)
    centre_m : ndarray, shape (3,), metres
        Mean of the visible samples, about which `information` turns.
    information : ndarray, shape (6, 6)
        Inverse covariance of a further twist (radians, metres), brightness unknown.
    loss : float
        Robust deviance per resolution cell; smaller is better.
    iterations : int
    converged : bool
    """

    transform: np.ndarray
    log_brightness: np.ndarray
    centre_m: np.ndarray
    information: np.ndarray
    loss: float
    iterations: int
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Residuals of every pixel, with what they are relative to."""

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
        """Return the sum of both robust losses over the pixels."""
        half = 0.5 * CAUCHY_SCALE**2
        speckle = half * np.log1p((self.speckle / CAUCHY_SCALE) ** 2)
        inside = np.maximum(1.0 - (self.range_m / self.range_std_m / TUKEY_CUTOFF) ** 2, 0.0)
        # What no mesh covers costs as much as what is off it.
        off = TUKEY_CUTOFF**2 / 6.0 * (1.0 - self.covered * inside**3)
        return float(speckle.sum() + off[self.measured].sum())


def misfit(image: MeshImage, power: np.ndarray, range_m: np.ndarray) -> Misfit:
    """Return how the measured picture differs from that of the mesh."""
    dark = power + FLOOR
    measured = np.isfinite(image.picture.range_m)
    return Misfit(
        speckle=(image.power - power) / dark,
        dark=dark,
        range_m=np.where(measured, image.picture.range_m - range_m, 0.0),
        range_std_m=RANGE_STD_M * np.sqrt(1.0 + RANGE_HALF_POWER / np.maximum(image.power, 1e-4)),
        covered=np.minimum(power / FLOOR, 1.0),
        measured=measured,
    )


def fit_mesh(
    image: MeshImage,
    transform: np.ndarray,
    log_brightness: np.ndarray,
    max_iterations: int,
    held: np.ndarray | None = None,
) -> MeshFit:
    """Move the mesh from `transform` until its picture fits best.

    Parameters
    ----------
    held : ndarray, shape (6, k), optional
        Twists (radians, metres) along which it must not move.
    """
    pixels_per_cell = cell_pixels(image)
    looked = np.full((4, 4), np.inf)
    scaled = False
    converged, iteration = False, 0
    n = 6 + len(KNOTS_RAD)
    while not converged and iteration < max_iterations:
        if np.abs(transform - looked).max() > _LOOK_AGAIN_M:
            image.look(transform)
            looked = transform
        power, range_m = image.of(transform, log_brightness)
        if not scaled:
            log_brightness = log_brightness + np.log(image.power.sum() / power.sum())
            power, range_m = image.of(transform, log_brightness)
            scaled = True
        centre_m = image.seen_points_m(transform).mean(axis=0)
        found = misfit(image, power, range_m)
        by_power, by_range = _derivatives(
            image, transform, log_brightness, centre_m, power, range_m
        )
        by_power = by_power / found.dark.ravel()
        speckle_weights = found.speckle_weights.ravel() / pixels_per_cell
        range_weights = (found.range_weights / found.range_std_m**2).ravel() / pixels_per_cell
        information = (by_power * speckle_weights) @ by_power.T
        information += (by_range * range_weights) @ by_range.T
        slope = (by_power * speckle_weights) @ found.speckle.ravel()
        slope += (by_range * range_weights) @ found.range_m.ravel()
        fall = np.diff(np.eye(n)[6:], axis=0)
        information += SMOOTH * fall.T @ fall
        slope -= SMOOTH * fall.T @ (np.diff(log_brightness) + FALL_PER_KNOT)
        free = np.eye(n) if held is None else _without(held, n)
        step = free @ np.linalg.solve(free.T @ information @ free, free.T @ slope)
        turn_rad, shift_m = np.linalg.norm(step[:3]), np.linalg.norm(step[3:6])
        step = step / max(
            1.0,
            turn_rad / _MOST_TURN_RAD,
            shift_m / _MOST_SHIFT_M,
            np.abs(step[6:]).max() / _MOST_LOG,
        )
        transform = orthonormal(exp_twist(step[:6], centre_m) @ transform)
        log_brightness = log_brightness + step[6:]
        log_brightness = np.maximum(log_brightness, log_brightness.max() - MOST_DARK)
        iteration += 1
        converged = bool(turn_rad < TURN_TOLERANCE_RAD and shift_m < SHIFT_TOLERANCE_M)
    return MeshFit(
        transform=transform,
        log_brightness=log_brightness,
        centre_m=centre_m,
        information=marginal(information),
        loss=found.loss() / pixels_per_cell,
        iterations=iteration,
        converged=converged,
    )


def shared_information(image: MeshImage, fit: MeshFit) -> np.ndarray:
    """Return the information on the motion that two halves of the samples agree on, (6, 6).

    A sphere that turns looks the same, but its samples wander, and their pattern looks like
    something to hold on to. It is another one in either half, and so is not in the product.
    """
    image.look(fit.transform)
    found = misfit(image, *image.of(fit.transform, fit.log_brightness))
    halves = []
    for every in (slice(0, None, 2), slice(1, None, 2)):
        image.look(fit.transform, every)
        brightness = fit.log_brightness + np.log(2.0)
        power, range_m = image.of(fit.transform, brightness)
        by_power, by_range = _derivatives(
            image, fit.transform, brightness, fit.centre_m, power, range_m
        )
        halves.append((by_power / found.dark.ravel(), by_range))
    image.look(fit.transform)
    (power_a, range_a), (power_b, range_b) = halves
    weight = found.range_weights / found.range_std_m**2
    product = (power_a * found.speckle_weights.ravel()) @ power_b.T
    product = (product + (range_a * weight.ravel()) @ range_b.T) / cell_pixels(image)
    fall = np.diff(np.eye(len(product))[6:], axis=0)
    return marginal(0.5 * (product + product.T) + SMOOTH * fall.T @ fall)


def cell_pixels(image: MeshImage) -> float:
    """Return how many pixels a resolution cell has, at least one."""
    step_x, step_y = image.picture.step_m
    return max(1.0, image.aperture.cell_m2(image.reference_m) / (step_x * step_y))


def marginal(information: np.ndarray) -> np.ndarray:
    """Return the information on the six of the motion, whatever the brightness is."""
    motion, mixed, rest = information[:6, :6], information[:6, 6:], information[6:, 6:]
    return motion - mixed @ np.linalg.solve(rest, mixed.T)


def _without(held: np.ndarray, n: int) -> np.ndarray:
    """Return a basis, shape (n, n - k), of all steps that have no part along `held`, (6, k)."""
    rows = np.zeros((held.shape[1], n))
    rows[:, :6] = held.T
    return np.linalg.svd(rows)[2][held.shape[1] :].T


def _derivatives(
    image: MeshImage,
    transform: np.ndarray,
    log_brightness: np.ndarray,
    centre_m: np.ndarray,
    power: np.ndarray,
    range_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of power and range by the twist and the brightness, (13, n_pixels)."""
    by_power, by_range = [], []
    for k in range(6):
        step = TURN_STEP_RAD if k < 3 else SHIFT_STEP_M
        twist = np.zeros(6)
        twist[k] = step
        ahead = image.of(exp_twist(twist, centre_m) @ transform, log_brightness)
        by_power.append((ahead[0] - power) / step)
        by_range.append((ahead[1] - range_m) / step)
    for d_power, d_moment in image.by_brightness(transform, log_brightness):
        by_power.append(d_power)
        by_range.append((d_moment - (range_m - image.reference_m) * d_power) / power)
    rows = 6 + len(KNOTS_RAD)
    return np.array(by_power).reshape(rows, -1), np.array(by_range).reshape(rows, -1)
