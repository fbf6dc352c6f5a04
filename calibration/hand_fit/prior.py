"""Prior of the angles and the shape of a hand: about the start, correlated as hands move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.hand_rendering import ANGLES, N_PARAMETERS, SHAPE
from calibration.hand_fit.hand_shape_vector import shape_covariance, vector_of
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, FITTED_ANGLES, N_ANGLES, HandState
from clradar.hand.joints import FINGERS
from clradar.hand.sampler import (
    ABDUCTION_SHARE,
    HOLLOW_SHARE,
    KNUCKLE_CORRELATION,
    LAST_SHARE,
    LAST_SIGMA_DEG,
    NEIGHBOUR_CORRELATION,
    SPREAD_DEG,
)

_SHARES = (1.0, ABDUCTION_SHARE, HOLLOW_SHARE)
FLEXION_STD_DEG, ABDUCTION_STD_DEG, ARCH_STD_DEG = (SPREAD_DEG * share for share in _SHARES)
"""Of a hand about the pose that it means to make, before the measurement."""


def angle_covariance(flexion_std_deg: float = FLEXION_STD_DEG) -> np.ndarray:
    """Covariance of `FITTED_ANGLES`, (23, 23), radians squared.

    Of middle joints m of covariance C, knuckles k and last joints l follow as in a random pose:
    k = 0.6 m + 0.8 m', l = 2/3 m + l', with an m' of the same variance and an l' of their own.
    """
    covariance = np.diag(
        [
            ABDUCTION_STD_DEG**2
            if angle == "abduction" and not joint.startswith("thumb")
            else FLEXION_STD_DEG**2
            for joint, angle in FITTED_ANGLES
        ]
    )
    numbers = np.arange(len(FINGERS))
    middle = FLEXION_STD_DEG**2 * NEIGHBOUR_CORRELATION ** np.abs(numbers[:, None] - numbers)
    rows = np.array([np.arange(N_ANGLES)[ANGLES_OF_DIGIT[finger]] for finger in FINGERS])
    follows = {0: KNUCKLE_CORRELATION, 2: 1.0, 3: LAST_SHARE}
    alone = {
        0: (1.0 - KNUCKLE_CORRELATION**2) * FLEXION_STD_DEG**2,
        2: 0.0,
        3: LAST_SIGMA_DEG**2,
    }
    for one, share in follows.items():
        for other, another in follows.items():
            covariance[np.ix_(rows[:, one], rows[:, other])] = share * another * middle
        covariance[rows[:, one], rows[:, one]] += alone[one]
    *_, knuckle, last = range(N_ANGLES)[ANGLES_OF_DIGIT["thumb"]]
    covariance[knuckle, last] = covariance[last, knuckle] = KNUCKLE_CORRELATION * FLEXION_STD_DEG**2
    palm = ANGLES_OF_DIGIT["palm"]
    covariance[palm, palm] = ARCH_STD_DEG**2 * np.array(
        [[1.0, NEIGHBOUR_CORRELATION], [NEIGHBOUR_CORRELATION, 1.0]]
    )
    return np.asarray(covariance * np.radians(flexion_std_deg / FLEXION_STD_DEG) ** 2)


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
