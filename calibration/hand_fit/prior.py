"""Prior of the angles and the shape of a hand: about the start, correlated as hands move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.hand_rendering import ANGLES, N_PARAMETERS, SHAPE
from calibration.hand_fit.hand_shape_vector import shape_covariance, vector_of
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, FITTED_ANGLES, N_ANGLES, HandState
from clradar.hand.joints import FINGERS

FLEXION_STD_DEG, ABDUCTION_STD_DEG, ARCH_STD_DEG = 12.0, 7.0, 5.0
"""Of a hand about the pose that it means to make, before the measurement."""

KNUCKLE_CORRELATION = 0.6
"""Of knuckle and middle joint (`clradar.hand.random_pose` has the sources)."""

LAST_SHARE = 2.0 / 3.0
"""The last joint follows the middle one by this share."""


def angle_covariance(flexion_std_deg: float = FLEXION_STD_DEG) -> np.ndarray:
    """Covariance of `FITTED_ANGLES`, (23, 23), radians squared."""
    std = np.array(
        [
            ARCH_STD_DEG
            if joint.endswith("finger-metacarpal")
            else ABDUCTION_STD_DEG
            if angle == "abduction" and not joint.startswith("thumb")
            else FLEXION_STD_DEG
            for joint, angle in FITTED_ANGLES
        ]
    )
    correlation = np.eye(N_ANGLES)
    for finger in FINGERS:
        knuckle, _, middle, last = range(N_ANGLES)[ANGLES_OF_DIGIT[finger]]
        for one, other, value in (
            (knuckle, middle, KNUCKLE_CORRELATION),
            (middle, last, LAST_SHARE),
            (knuckle, last, KNUCKLE_CORRELATION * LAST_SHARE),
        ):
            correlation[one, other] = correlation[other, one] = value
    std = np.radians(std) * flexion_std_deg / FLEXION_STD_DEG
    return correlation * np.outer(std, std)


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """A normal distribution of the parameters of a fit.

    `mean_rad`, shape (23,), and `mean_shape`, (8,); `information`, (44, 44), the inverse covariance
    in all parameters, 0 where nothing is known before.
    """

    mean_rad: np.ndarray
    mean_shape: np.ndarray
    information: np.ndarray

    @classmethod
    def about(
        cls, state: HandState, covariance: np.ndarray, shape: np.ndarray | None = None
    ) -> Prior:
        """About a state, with covariances of the angles, (23, 23), and of the shape, (8, 8)."""
        information = np.zeros((N_PARAMETERS, N_PARAMETERS))
        information[ANGLES, ANGLES] = np.linalg.inv(covariance)
        information[SHAPE, SHAPE] = np.linalg.inv(shape_covariance() if shape is None else shape)
        return cls(state.angles_rad, vector_of(state.shape), information)

    def away(self, state: HandState) -> np.ndarray:
        """Distance of a state from the mean, shape (44,)."""
        away = np.zeros(N_PARAMETERS)
        away[ANGLES] = state.angles_rad - self.mean_rad
        away[SHAPE] = vector_of(state.shape) - self.mean_shape
        return away

    def loss(self, state: HandState) -> float:
        """Minus its logarithm, up to a constant."""
        away = self.away(state)
        return float(0.5 * away @ self.information @ away)
