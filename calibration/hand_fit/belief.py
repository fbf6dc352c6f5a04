"""What the frames so far tell of the next one: a Kalman filter of angles, shape and velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.hand_rendering import ANGLES, N_PARAMETERS, SHAPE
from calibration.hand_fit.hand_shape_vector import shape_covariance, vector_of
from calibration.hand_fit.hand_state import HIGHEST_RAD, LOWEST_RAD, N_ANGLES, HandState
from calibration.hand_fit.prior import Prior, angle_covariance

SPEED_STD_DEG_S = 100.0
"""Standard deviation of the angular velocity of a joint's flexion. A finger that closes in a second
turns by 90 degrees in each of two joints, at up to 170 degrees per second."""

SPEED_LASTS_S = 0.5  # time constant by which a velocity is forgotten: about half of such a movement
SHAPE_FRAMES = 2.0
"""The information of frames on the shape adds up to at most that of so many frames: most of what
they get wrong is the same in all of them. Without a limit the girth of a synthetic hand went from
-7 to -16 % within ten frames (docs/hand-movement.md)."""

MOST_STD_RAD = (HIGHEST_RAD - LOWEST_RAD) / np.sqrt(12.0)
"""Of an angle that is equally likely anywhere within its limits, shape (23,)."""

_ANGLES = slice(0, N_ANGLES)


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Normal distribution of a hand's angles, its shape where that is fitted, and its velocities.

    `mean`, shape (n,), and `covariance`, (n, n): 23 angles, radians; 8 logarithms of the shape's
    factors, or none; 23 angular velocities, radians per second. `nominal_shape`, (8,), is what is
    believed of the shape before any frame. The information of frames on the shape adds up (Tkach
    et al., ACM TOG 36(6), 2017), to at most that of `SHAPE_FRAMES`; the velocities are an
    Ornstein-Uhlenbeck process with `SPEED_STD_DEG_S` and `SPEED_LASTS_S`.
    """

    mean: np.ndarray
    covariance: np.ndarray
    nominal_shape: np.ndarray

    @classmethod
    def of_start(cls, state: HandState, angle_std_deg: float, fit_shape: bool) -> Belief:
        """About a starting pose and a shape, before any measurement."""
        means = [state.angles_rad, np.zeros(N_ANGLES)]
        blocks = [angle_covariance(angle_std_deg), angle_covariance(SPEED_STD_DEG_S)]
        if fit_shape:
            means.insert(1, vector_of(state.shape))
            blocks.insert(1, shape_covariance())
        mean = np.concatenate(means)
        covariance = np.zeros((len(mean), len(mean)))
        first = 0
        for block in blocks:
            own = slice(first, first + len(block))
            covariance[own, own] = block
            first = own.stop
        return cls(mean, covariance, vector_of(state.shape))

    def restarted(self, state: HandState, angle_std_deg: float) -> Belief:
        """About another starting pose, with what the frames before tell of the shape."""
        fresh = Belief.of_start(state, angle_std_deg, self.known.stop > N_ANGLES)
        fresh.mean[self._shape] = self.mean[self._shape]
        fresh.covariance[self._shape, self._shape] = self.covariance[self._shape, self._shape]
        return Belief(fresh.mean, fresh.covariance, self.nominal_shape)

    @property
    def known(self) -> slice:
        """Angles and shape, which a frame measures."""
        return slice(0, len(self.mean) - N_ANGLES)

    @property
    def _shape(self) -> slice:
        return slice(N_ANGLES, self.known.stop)

    @property
    def _velocities(self) -> slice:
        return slice(len(self.mean) - N_ANGLES, len(self.mean))

    def after(self, time_s: float) -> Belief:
        """The same hand some time later, not measured again."""
        lasts = float(np.exp(-time_s / SPEED_LASTS_S))
        step = np.eye(len(self.mean))
        step[_ANGLES, self._velocities] = lasts * time_s * np.eye(N_ANGLES)
        step[self._velocities, self._velocities] = lasts * np.eye(N_ANGLES)
        enters = np.zeros((len(self.mean), N_ANGLES))
        enters[_ANGLES] = time_s * np.eye(N_ANGLES)
        enters[self._velocities] = np.eye(N_ANGLES)
        noise = (1.0 - lasts**2) * angle_covariance(SPEED_STD_DEG_S)
        covariance = step @ self.covariance @ step.T + enters @ noise @ enters.T
        mean = step @ self.mean
        mean[_ANGLES] = np.clip(mean[_ANGLES], LOWEST_RAD, HIGHEST_RAD)
        # What is not measured for long is no less certain than within the joint's limits.
        std = np.sqrt(np.diag(covariance))
        shrink = np.ones(len(mean))
        shrink[_ANGLES] = np.minimum(1.0, MOST_STD_RAD / std[_ANGLES])
        covariance *= np.outer(shrink, shrink)
        shape = self._shape
        if shape.stop > shape.start:
            mean[shape], covariance[shape, shape] = self._shape_with_less_information()
        return Belief(mean, covariance, self.nominal_shape)

    def _shape_with_less_information(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the shape, with a part of what the frames told of it."""
        kept = 1.0 - 1.0 / SHAPE_FRAMES
        before = np.linalg.inv(shape_covariance())
        now = np.linalg.inv(self.covariance[self._shape, self._shape])
        covariance = np.linalg.inv(before + kept * (now - before))
        away = kept * now @ (self.mean[self._shape] - self.nominal_shape)
        return self.nominal_shape + covariance @ away, covariance

    def prior(self, state: HandState) -> Prior:
        """Of the fit of the next frame; a shape that is not fitted is that of `state`."""
        mean = self.mean[self.known]
        information = np.zeros((N_PARAMETERS, N_PARAMETERS))
        information[SHAPE, SHAPE] = np.linalg.inv(shape_covariance())  # where it is not fitted
        own = slice(ANGLES.start, ANGLES.start + len(mean))
        information[own, own] = np.linalg.inv(self.covariance[self.known, self.known])
        shape = mean[N_ANGLES:] if len(mean) > N_ANGLES else vector_of(state.shape)
        return Prior(mean[_ANGLES], shape, information)

    def measured(self, state: HandState, covariance: np.ndarray) -> Belief:
        """After a fit whose prior was this one; its `covariance`, as large as `known`, includes it.

        The velocities follow by their covariance with the angles: with the gain K = C_vx / C_xx
        their mean grows by K times the change of the known, and C_vv by K (C - C_xx) K^T.
        """
        before = self.covariance
        known, velocities = self.known, self._velocities
        gain = np.linalg.solve(before[known, known], before[known, velocities]).T
        found = state.angles_rad
        if known.stop > N_ANGLES:
            found = np.concatenate([found, vector_of(state.shape)])
        mean = np.concatenate([found, self.mean[velocities] + gain @ (found - self.mean[known])])
        after = np.empty_like(before)
        after[known, known] = covariance
        after[velocities, known] = gain @ covariance
        after[known, velocities] = (gain @ covariance).T
        less = before[known, known] - covariance
        after[velocities, velocities] = before[velocities, velocities] - gain @ less @ gain.T
        return Belief(mean, after, self.nominal_shape)

    @property
    def shape_std(self) -> np.ndarray:
        """Standard deviations of the shape's logarithms, (8,); empty where it is not fitted."""
        return np.sqrt(np.diag(self.covariance)[self._shape])
