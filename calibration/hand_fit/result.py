"""Result of the fit of a hand: pose, place, what the measurement tells of them, and its basins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.hand import HandPose, HandShape
from clradar.model import Capture, Scene, Volume

TIPS = (4, 9, 14, 19, 24)
"""Tips of thumb, index, middle, ring and little finger in `clradar.hand.JOINT_NAMES`."""


@dataclass(frozen=True, slots=True, eq=False)
class Basin:
    """One of the poses in which the fit comes to rest.

    Attributes
    ----------
    start : str
        Name of the starting pose that led there.
    pose : HandPose
    transform : ndarray, shape (4, 4), metres
    joints_m : ndarray, shape (25, 3), metres
        In the antenna frame.
    deviance : float
        Robust deviance per resolution cell plus that of the prior, on freshly drawn surfaces;
        smaller is better, and a difference of 2 is noise.
    """

    start: str
    pose: HandPose
    transform: np.ndarray
    joints_m: np.ndarray
    deviance: float


@dataclass(frozen=True, slots=True, eq=False)
class HandFit:
    """A hand fitted to a measurement.

    Attributes
    ----------
    pose : HandPose
        The fitted angles; those of the wrist and the twists are those of the start.
    shape : HandShape
    handedness : "right" or "left"
    transform : ndarray, shape (4, 4), metres
        Rigid motion from the frame of the hand (`clradar.hand.posed_skeleton`; a left hand is its
        mirror image in x) to the antenna frame.
    scene : Scene
        The mesh, placed, with its parts and texture and the alpha found.
    joints_m, joint_std_m : ndarray, shape (25, 3) and (25,), metres
        Joint centres in the antenna frame, NaN where a rig has none, and the root mean square of
        their standard deviation along the three axes.
    angle_std_rad : ndarray, shape (23,), radians
        Standard deviation of the angles of `FITTED_ANGLES`, of prior and measurement together.
    untold : tuple of str
        Angles that the measurement does not tell, such as "index-finger-phalanx-distal flexion":
        they keep the value of the prior.
    alpha : float or None
        None where it was not estimated.
    log_brightness : ndarray, shape (7,)
        Natural logarithm of the brightness at the angles of incidence of the rendering.
    deviance : float
        As in `Basin`.
    basins : tuple of Basin
        Other poses that were found, the best first, this one included.
    start : str
        Name of the starting pose.
    likeness, overlap : float and float or None
        Correlation of rendering and measurement in decibels; overlap of the last simulation.
    capture, volume : Capture and Volume, optional
        The last simulation of the closed loop, on the grid of the measured volume.
    started : HandFit-like Scene
        The mesh in the starting pose, moved rigidly onto the measurement: the picture before.
    converged : bool
    covariance : ndarray, shape (n, n)
        Of `parameter_names`, radians, metres and natural logarithms of factors.
    parameter_names : tuple of str
    """

    pose: HandPose
    shape: HandShape
    handedness: str
    transform: np.ndarray
    scene: Scene
    started: Scene
    joints_m: np.ndarray
    joint_std_m: np.ndarray
    angle_std_rad: np.ndarray
    untold: tuple[str, ...]
    alpha: float | None
    log_brightness: np.ndarray
    deviance: float
    basins: tuple[Basin, ...]
    start: str
    likeness: float
    overlap: float | None
    converged: bool
    covariance: np.ndarray
    parameter_names: tuple[str, ...]
    capture: Capture | None = None
    volume: Volume | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def tips_m(self) -> np.ndarray:
        """Tips of thumb, index, middle, ring and little finger, shape (5, 3), metres."""
        return self.joints_m[list(TIPS)]

    @property
    def tip_std_m(self) -> np.ndarray:
        """Standard deviation of the tips, shape (5,), metres, as `joint_std_m`."""
        return self.joint_std_m[list(TIPS)]

    def remarks(self) -> tuple[str, ...]:
        """Reasons to doubt the result, one clause each."""
        return self.notes

    def to_dict(self) -> dict[str, Any]:
        """The result in types that JSON has."""
        raise NotImplementedError

    def report(self) -> str:
        """The result as a few lines of text."""
        raise NotImplementedError
