"""What a measurement tells of a hand: covariance of the parameters and of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.descent import FINE, Fitted, HandFitter
from calibration.hand_fit.hand_rendering import ANGLES, N_GEOMETRY, SHAPE, stepped
from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES
from calibration.hand_fit.hand_state import FITTED_ANGLES, HandState
from calibration.hand_fit.prior import Prior

UNTOLD_SHARE = 0.7
"""An angle whose standard deviation is not below this share of the prior's is not told."""

MOTION_NAMES = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z")

GEOMETRY_NAMES = (
    *MOTION_NAMES,
    *(f"{joint} {angle}" for joint, angle in FITTED_ANGLES),
    *(f"shape {name}" for name in SHAPE_NAMES),
)
"""Of the parameters without brightness: radians, metres, logarithms of factors."""


@dataclass(frozen=True, slots=True, eq=False)
class Certainty:
    """What a fit is certain of.

    `covariance`, shape (n, n), of the fitted geometry, and the `names` of its parameters; standard
    deviations `angle_std_rad`, shape (23,); `joint_covariance_m2`, (25, 3, 3); the names of the
    angles that the measurement does not tell, `untold`.
    """

    covariance: np.ndarray
    names: tuple[str, ...]
    angle_std_rad: np.ndarray
    joint_covariance_m2: np.ndarray
    untold: tuple[str, ...]

    @property
    def joint_std_m(self) -> np.ndarray:
        """As `HandFit.joint_std_m`."""
        std_m: np.ndarray = np.sqrt(np.trace(self.joint_covariance_m2, axis1=1, axis2=2))
        return std_m


def certainty(fitter: HandFitter, found: Fitted, prior: Prior, seed: int) -> Certainty:
    """The covariance at a fit, from information on a freshly drawn surface."""
    picture = fitter.picture(FINE)
    picture.draw_surface(found.state, seed)
    information, _, centre_m = fitter.scoring(found.state, found.log_brightness, prior, FINE)
    fitted = np.flatnonzero(fitter.fitted)
    covariance = np.linalg.inv(information[np.ix_(fitted, fitted)])
    kept = fitted < N_GEOMETRY
    fitted, covariance = fitted[kept], covariance[np.ix_(kept, kept)]
    by_parameter = _joint_derivatives(fitter, found.state, centre_m)[fitted]
    of_joints = np.einsum("kjc,kl,ljd->jcd", by_parameter, covariance, by_parameter)
    std = np.sqrt(np.diag(covariance))
    angle_std = std[(fitted >= ANGLES.start) & (fitted < SHAPE.start)]
    before = np.sqrt(np.diag(np.linalg.inv(prior.information[ANGLES, ANGLES])))
    names = tuple(GEOMETRY_NAMES[k] for k in fitted)
    angle_names = GEOMETRY_NAMES[ANGLES]
    return Certainty(
        covariance=covariance,
        names=names,
        angle_std_rad=angle_std,
        joint_covariance_m2=of_joints,
        untold=tuple(
            name
            for name, share in zip(angle_names, angle_std / before, strict=True)
            if share > UNTOLD_SHARE
        ),
    )


def joints_at(fitter: HandFitter, state: HandState) -> np.ndarray:
    """Joints in the antenna frame, (25, 3), metres."""
    joints_m = fitter.model.joints_m(state.pose, state.shape)
    return joints_m @ state.transform[:3, :3].T + state.transform[:3, 3]


def _joint_derivatives(fitter: HandFitter, state: HandState, centre_m: np.ndarray) -> np.ndarray:
    """Derivatives of the joints by the geometry's parameters, (37, 25, 3)."""
    here_m = joints_at(fitter, state)
    rows = []
    for step in 1e-4 * np.eye(N_GEOMETRY):
        there_m = joints_at(fitter, stepped(state, step, centre_m))
        if (np.nan_to_num(there_m) == np.nan_to_num(here_m)).all():  # at its limit
            step = -step
            there_m = joints_at(fitter, stepped(state, step, centre_m))
        rows.append((there_m - here_m) / step.sum())
    return np.array(rows)
