"""Fit of a hand by Fisher scoring on brightness, range and prior, from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_rendering import (
    ANGLES,
    N_GEOMETRY,
    N_PARAMETERS,
    SAMPLES_PER_MM2,
    SHAPE,
    HandRendering,
    stepped,
)
from calibration.hand_fit.hand_state import HIGHEST_RAD, LOWEST_RAD, HandState
from calibration.hand_fit.misfit import RANGE_CELLS, deviance, misfit
from calibration.hand_fit.prior import Prior
from calibration.registration.mesh_fit import FALL_PER_KNOT, MOST_DARK, SMOOTH, cell_pixels
from calibration.registration.mesh_rendering import Aperture, MeasuredImage
from clradar.model import DepthMap
from clradar.opencl import Device

BRIGHTNESS = slice(N_GEOMETRY, N_PARAMETERS)

FALLS = np.diff(np.eye(N_PARAMETERS)[BRIGHTNESS], axis=0)
"""Differences of the log brightness from knot to knot, as rows of all parameters."""

_MOST = np.zeros(N_PARAMETERS)
_MOST[:3], _MOST[3:6], _MOST[ANGLES], _MOST[SHAPE], _MOST[BRIGHTNESS] = 0.1, 6e-3, 0.35, 0.05, 1.5
"""Of one step."""

_BRIGHTNESS_ONLY = np.arange(N_PARAMETERS) >= N_GEOMETRY

_SETTLED = 0.05  # a fall of the deviance below which surfaces are not drawn anew
_DAMPING = 1e-2
_TRIALS = 4


@dataclass(frozen=True, slots=True)
class Level:
    """Pixels of a picture, its blur, the factor of the ranges' scatter, and the work on it.

    `surfaces`: how often the hand is meshed anew at most; `steps`, on each surface;
    `samples_per_mm2`, of it.
    """

    step_m: float
    blur_m: float
    range_scale: float
    surfaces: int
    steps: int
    samples_per_mm2: float = SAMPLES_PER_MM2


COARSE, MIDDLE, FINE = (
    Level(4e-3, 4e-3, 4.0, 3, 3, 0.25),
    Level(2e-3, 2e-3, 2.0, 3, 3, 0.4),
    Level(2e-3, 0.0, 1.0, 4, 3),
)
LEVELS = (COARSE, MIDDLE, FINE)


@dataclass(frozen=True, slots=True, eq=False)
class Missed:
    """What slopes of moving samples miss by the geometry, both of shape (37, n_pixels).

    `by_power`, of the logarithm of power and floor; `by_range`, of the range, metres.
    """

    by_power: np.ndarray
    by_range: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A state, its brightness, shape (7,), and deviance without and with that of the prior."""

    state: HandState
    log_brightness: np.ndarray
    misfit: float
    deviance: float


class HandFitter:
    """Fits states of a hand to one measured image, on pixels of about 2 mm or finer.

    `fitted`, (44,), tells the parameters that are fitted; the others stay. `levels` are those that
    it will be asked for.
    """

    def __init__(
        self,
        model: HandModel,
        depth: DepthMap,
        aperture: Aperture,
        device: Device,
        fitted: np.ndarray,
        levels: tuple[Level, ...] = LEVELS,
    ) -> None:
        self.model, self.fitted = model, fitted
        self.depth, self.aperture = depth, aperture
        self._pictures = {
            (level.step_m, level.blur_m): HandRendering(
                model,
                MeasuredImage.of(depth, level.step_m, aperture.centre_m),
                aperture,
                device,
                level.blur_m,
                level.samples_per_mm2,
            )
            for level in levels
        }

    def picture(self, level: Level) -> HandRendering:
        """The renderer of a level."""
        return self._pictures[level.step_m, level.blur_m]

    def descend(
        self,
        state: HandState,
        log_brightness: np.ndarray,
        prior: Prior,
        levels: tuple[Level, ...] = LEVELS,
        seed: int = 0,
    ) -> Fitted:
        """Fit from a start, level by level."""
        found = Fitted(state, log_brightness, np.inf, np.inf)
        for level in levels:
            for surface in range(level.surfaces):
                before = found
                found, fall = self._on_one_surface(before, prior, level, seed + surface)
                if fall < _SETTLED:
                    break
        return found

    def judged(self, found: Fitted, prior: Prior, level: Level = FINE, seed: int = 0) -> Fitted:
        """The same with its deviance on a freshly drawn surface, brightness fitted to that."""
        picture = self.picture(level)
        picture.draw_surface(found.state, seed)
        return self._stepped(found, prior, level, _BRIGHTNESS_ONLY)[0]

    def scaled(self, state: HandState, log_brightness: np.ndarray, level: Level) -> np.ndarray:
        """The brightness, scaled to the power of the measured image."""
        picture = self.picture(level)
        power, _ = picture.render(state, log_brightness)
        return log_brightness + np.log(picture.power.sum() / power.sum())

    def step(self, found: Fitted, prior: Prior, missed: Missed) -> tuple[np.ndarray, np.ndarray]:
        """A step of all fitted parameters, (44,), on the surface of `FINE` that was drawn last, and
        the centre of twists."""
        state = found.state
        information, score, centre_m = self.scoring(
            state, found.log_brightness, prior, FINE, missed=missed
        )
        return _step(information, score, _DAMPING, self.fitted, state.angles_rad), centre_m

    def _loss(
        self,
        state: HandState,
        log_brightness: np.ndarray,
        prior: Prior,
        level: Level,
        covered: np.ndarray | None = None,
    ) -> float:
        picture = self.picture(level)
        fall = np.diff(log_brightness) + FALL_PER_KNOT
        return (
            deviance(picture, picture.render(state, log_brightness), level.range_scale, covered)
            + prior.loss(state)
            + 0.5 * SMOOTH * float(fall @ fall)
        )

    def _on_one_surface(
        self, start: Fitted, prior: Prior, level: Level, seed: int
    ) -> tuple[Fitted, float]:
        """Steps on one surface, and by how much the deviance fell."""
        picture = self.picture(level)
        state, log_brightness = start.state, start.log_brightness
        picture.draw_surface(state, seed)
        if not np.isfinite(start.misfit):
            log_brightness = self.scaled(state, log_brightness, level)
        return self._stepped(replace(start, log_brightness=log_brightness), prior, level)

    def _stepped(
        self, start: Fitted, prior: Prior, level: Level, wanted: np.ndarray | None = None
    ) -> tuple[Fitted, float]:
        """Steps of the `wanted` parameters on the surface that was drawn last."""
        wanted = self.fitted if wanted is None else wanted
        state, log_brightness = start.state, start.log_brightness
        damping = _DAMPING
        fell = 0.0
        for _ in range(level.steps):
            information, score, centre_m = self.scoring(state, log_brightness, prior, level, wanted)
            covered = self._covered(state, log_brightness, level)
            loss = self._loss(state, log_brightness, prior, level, covered)
            for _ in range(_TRIALS):
                step = _step(information, score, damping, wanted, state.angles_rad)
                ahead = stepped(state, step[:N_GEOMETRY], centre_m)
                brighter = log_brightness + step[BRIGHTNESS]
                brighter = np.maximum(brighter, brighter.max() - MOST_DARK)
                fall = loss - self._loss(ahead, brighter, prior, level, covered)
                if fall > 0.0:
                    break
                damping *= 8.0
            else:
                break
            fell += fall
            state, log_brightness, damping = ahead, brighter, max(damping / 4.0, 1e-4)
            if fall < _SETTLED:
                break
        loss = self._loss(state, log_brightness, prior, level)
        return Fitted(state, log_brightness, loss - prior.loss(state), loss), fell

    def _covered(self, state: HandState, log_brightness: np.ndarray, level: Level) -> np.ndarray:
        """Weight of the ranges, which the score takes as given: with it free, steps that follow the
        score were refused, and those that follow its gradient brightened the hand to cover more."""
        picture = self.picture(level)
        return misfit(picture, picture.render(state, log_brightness)).covered

    def linearised(
        self,
        state: HandState,
        log_brightness: np.ndarray,
        level: Level,
        wanted: np.ndarray | None = None,
        missed: Missed | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals of all pixels, in brightness and in range, (n,), and their slopes, (44, n).

        Both in units of their scatter, with the robust weights and the pixels per resolution cell,
        so that the squares of the slopes are information; those of parameters that are not wanted,
        by default those that are not fitted, are 0; `missed` is added. Third, the centre of twists.
        """
        picture = self.picture(level)
        rendered = picture.render(state, log_brightness)
        points_m, _ = picture.samples.posed(picture.bones_at(state))
        centre_m = points_m.mean(axis=0)
        by_power, by_range = np.zeros((2, N_PARAMETERS, picture.power.size))
        wanted = self.fitted if wanted is None else wanted
        by_power[wanted], by_range[wanted] = picture.derivatives(
            state, log_brightness, centre_m, wanted, rendered
        )
        found = misfit(picture, rendered, level.range_scale)
        if missed is not None:
            by_power[:N_GEOMETRY] += missed.by_power * found.dark.ravel()
            by_range[:N_GEOMETRY] += missed.by_range
        per_cell = cell_pixels(picture)
        by_speckle = np.sqrt(found.speckle_weights / per_cell).ravel()
        by_scatter = np.sqrt(found.range_weights / per_cell / RANGE_CELLS) / found.range_std_m
        by_scatter = by_scatter.ravel()
        residual = np.concatenate(
            [by_speckle * found.speckle.ravel(), by_scatter * found.range_m.ravel()]
        )
        slopes = np.hstack([by_power * (by_speckle / found.dark.ravel()), by_range * by_scatter])
        return residual, slopes, centre_m

    def scoring(
        self,
        state: HandState,
        log_brightness: np.ndarray,
        prior: Prior,
        level: Level,
        wanted: np.ndarray | None = None,
        missed: Missed | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Information, (44, 44), and score, (44,), of all parameters, and the centre of twists."""
        residual, slopes, centre_m = self.linearised(state, log_brightness, level, wanted, missed)
        information = slopes @ slopes.T + prior.information + SMOOTH * FALLS.T @ FALLS
        score = slopes @ residual - prior.information @ prior.away(state)
        score -= SMOOTH * FALLS.T @ (np.diff(log_brightness) + FALL_PER_KNOT)
        return information, score, centre_m


def _step(
    information: np.ndarray,
    score: np.ndarray,
    damping: float,
    wanted: np.ndarray,
    angles_rad: np.ndarray,
) -> np.ndarray:
    """The step of the `wanted` parameters but those angles that would leave their limits."""
    damped = information + damping * np.diag(np.diag(information) + 1e-12)
    free = wanted.copy()
    lowest, highest = angles_rad <= LOWEST_RAD, angles_rad >= HIGHEST_RAD
    while True:
        moving = np.flatnonzero(free)
        step = np.zeros(N_PARAMETERS)
        step[moving] = np.linalg.solve(damped[np.ix_(moving, moving)], score[moving])
        out = (lowest & (step[ANGLES] < 0.0)) | (highest & (step[ANGLES] > 0.0))
        if not out.any():
            break
        free[ANGLES] &= ~out
    step /= max(1.0, float((np.abs(step) / _MOST).max()))
    return step


def fitted_parameters(shape: bool) -> np.ndarray:
    """Mask (44,) of the parameters of a fit, with or without the shape."""
    wanted = np.ones(N_PARAMETERS, dtype=bool)
    wanted[SHAPE] = shape
    return wanted
