"""Search for the pose of one digit after the other, over many angles at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.descent import HandFitter, Level
from calibration.hand_fit.digit_chain import DigitChain, bones_of_digit
from calibration.hand_fit.hand_rendering import ANGLES, HandRendering
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, HIGHEST_RAD, LOWEST_RAD, HandState
from calibration.hand_fit.layers import HandSkin, LayeredRendering, on_digit
from calibration.hand_fit.misfit import deviance_map, misfit
from calibration.hand_fit.prior import LAST_SHARE, Prior
from calibration.hand_fit.result import APART_M, DIGITS
from calibration.hand_fit.skinned import SkinnedSamples
from calibration.registration.mesh_fit import cell_pixels

FLEXION_DEG, ABDUCTION_DEG = (-40.0, -20.0, 0.0, 20.0, 40.0), (-12.0, 0.0, 12.0)
"""Tried about the start: a tip moves by 15 to 30 mm from one to the next, half of that lies within
the reach of the descent."""

THUMB_DEG = (-25.0, 0.0, 25.0)


def finger_grid() -> np.ndarray:
    """Changes of knuckle's flexion and abduction, of middle and last joint, (75, 4), radians."""
    knuckle, spread, middle = (
        a.ravel() for a in np.meshgrid(FLEXION_DEG, ABDUCTION_DEG, FLEXION_DEG)
    )
    return np.radians(np.stack([knuckle, spread, middle, LAST_SHARE * middle], axis=1))


def thumb_grid() -> np.ndarray:
    """Changes of the thumb's angles, (81, 5), radians; the last two joints bend together."""
    bend, out, twist, tip = (a.ravel() for a in np.meshgrid(*[THUMB_DEG] * 4))
    return np.radians(np.stack([bend, out, twist, tip, LAST_SHARE * tip], axis=1))


def refinements(digit: str, step: float) -> np.ndarray:
    """Steps from a pose to its neighbours, (n, 4 or 5), radians; `step` in that of the grid."""
    flexion, spread = np.radians([20.0, 12.0]) * step
    if digit == "thumb":
        moves = np.radians(25.0) * step * np.eye(5)[:4]
        moves[3, 4] = LAST_SHARE * moves[3, 3]
    else:
        moves = np.array(
            [
                [flexion, 0, 0, 0],
                [0, spread, 0, 0],
                [0, 0, flexion, LAST_SHARE * flexion],
                [flexion, 0, -flexion, -LAST_SHARE * flexion],
                [0, 0, 0, 2 * flexion],
            ]
        )
    return np.concatenate([moves, -moves])


STEPS = (0.5, 0.25)  # of the refinement of the best, in those of the grid
REFINED = 4

WORSE = 10.0
"""Deviance by which another pose may be worse and is kept: what a picture of layers errs by."""


@dataclass(frozen=True, slots=True, eq=False)
class Pictured:
    """A state as the search judges it: deviance with that of the prior."""

    state: HandState
    deviance: float


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """Poses of one digit, the present one first: `angles_rad`, (n, 23), of the hand; `deviance`,
    (n,), with that of the prior; `tips_m`, (n, 3), in the antenna frame."""

    angles_rad: np.ndarray
    deviance: np.ndarray
    tips_m: np.ndarray

    def apart(self, worse: float) -> list[int]:
        """Those whose tips are `APART_M` apart, best first, down to so much worse than the best."""
        tips_m, kept = self.tips_m, list[int]()
        for k in np.argsort(self.deviance, kind="stable"):
            if self.deviance[k] > self.deviance.min() + worse:
                break
            if all(np.linalg.norm(tips_m[k] - tips_m[j]) > APART_M for j in kept):
                kept.append(int(k))
        return kept

    def best_elsewhere(self) -> int | None:
        """The best whose tip is `APART_M` from the present one."""
        away_m = np.linalg.norm(self.tips_m - self.tips_m[0], axis=1)
        judged = np.where(away_m > APART_M, self.deviance, np.inf)
        best = int(judged.argmin())
        return best if np.isfinite(judged[best]) else None


@dataclass(frozen=True, slots=True, eq=False)
class Other:
    """A state in which one digit has another pose, and how much worse that pictures."""

    state: HandState
    worse: float
    digit: str


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """The state to which a sweep over the digits leads, and the poses that it did not take."""

    state: HandState
    others: tuple[Other, ...]


class DigitSearch:
    """Judges many poses of one digit of a hand, at the pixels and scatter of a `level`."""

    def __init__(self, fitter: HandFitter, skin: HandSkin, prior: Prior, level: Level) -> None:
        self.fitter, self.skin, self.prior, self.level = fitter, skin, prior, level
        self._picture: HandRendering = fitter.picture(level)

    def judged(
        self,
        state: HandState,
        log_brightness: np.ndarray,
        whole: SkinnedSamples,
        digit: str,
        angles_rad: np.ndarray,
    ) -> np.ndarray:
        """Deviance, (n,), of the hand with other angles of one digit, rows of (n, 23).

        `whole`: samples of the hand, drawn near the state.
        """
        picture = self._picture
        rest = whole[~on_digit(whole, digit)]
        layers = LayeredRendering(picture, rest, picture.bones_at(state), log_brightness)
        chain = DigitChain(self.fitter.model, state, digit)
        found = self._prior_loss(angles_rad)
        for rows, samples in self.skin.of_digit(digit, angles_rad):
            sums = []
            for rendered in layers.pictures(samples, chain.places(angles_rad[rows])):
                residuals = misfit(picture, rendered, self.level.range_scale)
                sums.append(deviance_map(picture, rendered, residuals).sum(axis=(1, 2)))
            found[rows] += np.concatenate(sums) / cell_pixels(picture)
        return found

    def _prior_loss(self, angles_rad: np.ndarray) -> np.ndarray:
        away = angles_rad - self.prior.mean_rad
        information = self.prior.information[ANGLES, ANGLES]
        return 0.5 * np.einsum("ni,ij,nj->n", away, information, away)

    def sweep(self, start: HandState, log_brightness: np.ndarray) -> Swept:
        """Every digit in turn takes its best pose."""
        whole = self.skin.drawn(start.pose, start.shape)
        state, others = start, []
        for digit in DIGITS:
            found = self.digit(state, log_brightness, whole, digit)
            best = found[0]
            others += [
                Other(other.state, other.deviance - best.deviance, digit) for other in found[1:]
            ]
            state = best.state
        return Swept(state, tuple(others))

    def digit(
        self, state: HandState, log_brightness: np.ndarray, whole: SkinnedSamples, digit: str
    ) -> list[Pictured]:
        """The best poses of a digit, best first, whose tips are `APART_M` apart."""
        tried = self.tried(state, log_brightness, whole, digit)
        return [
            Pictured(state.with_angles(tried.angles_rad[k]), float(tried.deviance[k]))
            for k in tried.apart(WORSE)
        ]

    def tried(
        self, state: HandState, log_brightness: np.ndarray, whole: SkinnedSamples, digit: str
    ) -> Tried:
        """A digit as it is and in many other poses about the prior's mean, judged."""
        own = ANGLES_OF_DIGIT[digit]

        def judge(angles_rad: np.ndarray) -> np.ndarray:
            return self.judged(state, log_brightness, whole, digit, angles_rad)

        grid = thumb_grid() if digit == "thumb" else finger_grid()
        tried = np.repeat(state.angles_rad[None], len(grid) + 1, axis=0)
        tried[1:, own] = self.prior.mean_rad[own] + grid
        tried = _within_limits(tried)
        judged = judge(tried)
        for step in STEPS:
            best = tried[np.argsort(judged, kind="stable")[:REFINED]]
            moves = refinements(digit, step)
            near = np.repeat(best, len(moves), axis=0)
            near[:, own] += np.tile(moves, (len(best), 1))
            near = _within_limits(near)
            tried = np.concatenate([tried, near])
            judged = np.concatenate([judged, judge(near)])
        chain = DigitChain(self.fitter.model, state, digit)
        return Tried(tried, judged, chain.places(tried).origin_m[:, bones_of_digit(digit).stop - 1])


def _within_limits(angles_rad: np.ndarray) -> np.ndarray:
    """Clipped, without the rows that are then equal; the first stays the first."""
    clipped = np.clip(angles_rad, LOWEST_RAD, HIGHEST_RAD)
    _, first = np.unique(clipped.round(6), axis=0, return_index=True)
    return clipped[np.sort(first)]
