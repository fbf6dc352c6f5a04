"""Result of the fit of a hand: pose, place, what the measurement tells of them, and its basins."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from calibration.hand_fit.hand_state import FITTED_ANGLES, angles_of
from clradar.hand import JOINT_NAMES, HandPose, HandShape
from clradar.hand.pose_file import pose_table
from clradar.model import Capture, Scene, Volume
from clradar.model.record import plain

TIPS = (4, 9, 14, 19, 24)
"""Tips of thumb, index, middle, ring and little finger in `clradar.hand.JOINT_NAMES`."""

DIGITS = ("thumb", "index", "middle", "ring", "pinky")

ANGLE_NAMES = tuple(f"{joint} {angle}" for joint, angle in FITTED_ANGLES)
"""Such as "index-finger-phalanx-distal flexion"."""

RIVAL_DEVIANCE = 6.0
"""A basin whose deviance is larger by less is a rival: with Gaussian errors its likelihood is at
least exp(-3) = 5 % of the best one's."""

TOLD_M = 4e-3  # a tip whose standard deviation is below is determined: about a resolution cell
PLAIN = (
    "handedness", "transform", "start", "converged", "deviance", "likeness", "overlap", "alpha",
    "log_brightness", "parameter_names", "covariance",
)  # fmt: skip
"""Fields that are in the JSON of a fit as they are."""

APART_M = 10e-3
"""Poses with a tip farther apart than this are different ones: a finger is 15 mm thick."""


DOUBTFUL_OVERLAP = 0.8
"""Overlap of the simulation below which it may be no hand, or its pose is another: a small box and
a cylinder have 0.68 to 0.77, other poses and the other hand up to 0.75
(docs/hand-fit-method.md)."""

DOUBTFUL_LIKENESS = 0.84
"""The same of the correlation of the rendering, where nothing is simulated: wrong letters and the
other hand had 0.81 to 0.83."""


@dataclass(frozen=True, slots=True, eq=False)
class Basin:
    """One of the poses in which the fit comes to rest.

    Attributes
    ----------
    start : str
        The starting pose that led there.
    pose, transform, joints_m, handedness
        As of `HandFit`.
    deviance : float
        Robust deviance per resolution cell plus that of the prior; a difference of 2 is noise.
    """

    start: str
    pose: HandPose
    transform: np.ndarray
    joints_m: np.ndarray
    deviance: float
    handedness: str


@dataclass(frozen=True, slots=True, eq=False)
class HandFit:
    """A hand fitted to a measurement, in the antenna frame.

    Joints come in the order of `clradar.hand.JOINT_NAMES`, tips from thumb to little finger, angles
    as in `to_dict`.

    Attributes
    ----------
    pose : HandPose
        Wrist and twists are those of the start.
    shape : HandShape or None
        None of a rig.
    handedness : "right" or "left"
    transform : ndarray, shape (4, 4), metres
        From the frame of `clradar.hand.posed_skeleton`; a left hand is its mirror image in x.
    scene, started : Scene
        The placed mesh with the alpha found; that of the starting pose, moved rigidly.
    joints_m : ndarray, shape (25, 3)
        NaN where a rig has no such joint.
    joint_covariance_m2, angle_std_rad : ndarray, shape (25, 3, 3) and (23,)
        Of prior and measurement together, with the spread over the `basins` by their likelihood.
    untold : tuple of str
        Angles that the measurement does not determine: they keep the value of the prior.
    alpha : float or None
        None where it was neither given nor estimated.
    log_brightness : ndarray, shape (7,)
        Natural logarithm, at angles of incidence from 0 to 70 degrees.
    deviance, start
        As of `Basin`.
    basins : tuple of Basin
        Poses in which the fit came to rest, this one first.
    likeness : float
        Correlation of rendering and measurement in decibels.
    capture, volume : Capture and Volume, or None
        The last simulation.
    overlap : float or None
        Of that simulation with the measurement (docs/metrics.md).
    converged : bool
    covariance : ndarray, shape (n, n)
        Of `parameter_names`, in radians, metres and natural logarithms of factors.
    notes : tuple of str
        Some of the `remarks`.
    """

    pose: HandPose
    shape: HandShape | None
    handedness: str
    transform: np.ndarray
    scene: Scene
    started: Scene
    joints_m: np.ndarray
    joint_covariance_m2: np.ndarray
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
        """Tips of the digits, shape (5, 3)."""
        return self.joints_m[list(TIPS)]

    @property
    def joint_std_m(self) -> np.ndarray:
        """Root of the sum of the variances along x, y and z, shape (25,)."""
        return np.sqrt(np.trace(self.joint_covariance_m2, axis1=1, axis2=2))

    @property
    def tip_std_m(self) -> np.ndarray:
        """`joint_std_m` of the tips, shape (5,)."""
        return self.joint_std_m[list(TIPS)]

    @property
    def doubtful(self) -> bool:
        """Whether it may be another object, hand or pose, by the limits of docs/hand-fit.md."""
        if self.overlap is None:
            return self.likeness < DOUBTFUL_LIKENESS
        return self.overlap < DOUBTFUL_OVERLAP

    @property
    def told_tips(self) -> np.ndarray:
        """Mask, shape (5,), of tips with a standard deviation below 4 mm; none if `doubtful`."""
        return (self.tip_std_m < TOLD_M) & (not self.doubtful)

    @property
    def told_angles(self) -> np.ndarray:
        """Mask, shape (23,), of the angles that are not `untold`; none if `doubtful`."""
        known = [name not in self.untold for name in ANGLE_NAMES]
        return np.array(known) & (not self.doubtful)

    def remarks(self) -> tuple[str, ...]:
        """Reasons to doubt the result, one clause each."""
        found = list(self.notes)
        if not self.converged:
            found.append("the pose still changed in the last step, and may go on")
        for basin in self.basins:
            more, apart_m = basin.deviance - self.deviance, self.tips_apart_m(basin)
            if more < RIVAL_DEVIANCE and apart_m.max() > APART_M:
                digit = DIGITS[int(apart_m.argmax())]
                finger = digit if digit == "thumb" else f"{digit} finger"
                end = "tip" if np.isfinite(self.tips_m).all() else "end"
                found.append(
                    f"another pose fits nearly as well (deviance {more:+.1f}), with the {end} of "
                    f"the {finger} {1e3 * apart_m.max():.0f} mm away"
                )
        if self.doubtful:
            found.append(
                f"{self._agreement()}, as of a hand of other proportions (--fit-shape, --rig), the "
                "other hand (handedness='either', --hand either), another pose (pose='all', "
                "--pose all) or another object; standard deviations hold for the first alone"
            )
        return tuple(found)

    def _agreement(self) -> str:
        """How little a doubtful fit agrees with the measurement, in words."""
        if self.overlap is None:
            likeness = f"its rendering correlates with the measurement by {self.likeness:.2f}"
            return f"{likeness}, below {DOUBTFUL_LIKENESS:g}"
        simulated = f"simulated, it overlaps with the measurement by {self.overlap:.2f}"
        return f"{simulated}, below {DOUBTFUL_OVERLAP:g}"

    def tips_apart_m(self, basin: Basin) -> np.ndarray:
        """Distances of the digits' ends from those of a basin, shape (5,)."""
        return ends_apart_m(basin.joints_m, self.joints_m)

    def to_dict(self) -> dict[str, Any]:
        """The result in types that JSON has, without meshes and simulations.

        `pose` is what a pose file holds; joints, digits and angles are by name, angles in degrees.
        """
        told = self.told_angles.tolist()
        columns = (np.degrees(angles_of(self.pose)), np.degrees(self.angle_std_rad))
        rows = zip(ANGLE_NAMES, *(column.tolist() for column in columns), told, strict=True)
        return {
            "pose": pose_table(self.pose),
            "shape": None if self.shape is None else asdict(self.shape),
            **plain({name: getattr(self, name) for name in PLAIN}),
            "joints_m": by_joint(self.joints_m),
            "joint_std_m": by_joint(self.joint_std_m),
            "joint_covariance_m2": by_joint(self.joint_covariance_m2),
            "told_tips": dict(zip(DIGITS, self.told_tips.tolist(), strict=True)),
            "angles": {
                name: {"value_deg": value, "std_deg": std, "told": known}
                for name, value, std, known in rows
            },
            "untold": [name for name, known in zip(ANGLE_NAMES, told, strict=True) if not known],
            "basins": [
                {
                    "start": basin.start,
                    "handedness": basin.handedness,
                    "deviance": basin.deviance,
                    "pose": pose_table(basin.pose),
                    "transform": basin.transform.tolist(),
                    "joints_m": by_joint(basin.joints_m),
                }
                for basin in self.basins
            ],
            "remarks": list(self.remarks()),
            "report": self.report(),
        }

    def summary(self) -> str:
        """The first line of the report."""
        text = f"A {self.handedness} hand, fitted from '{self.start}'"
        text += ": converged." if self.converged else ": NOT converged, still moving."
        text += f" Its rendering correlates with the measurement by {self.likeness:.2f}."
        if self.alpha is not None:
            text += f" Alpha is {self.alpha:.2f}."
        if self.overlap is not None:
            text += f" Simulated there, the overlap is {self.overlap:.2f}."
        return text

    def report(self) -> str:
        """The result as a few lines of text."""
        lines = [self.summary()]
        tips = [
            f"{digit} {', '.join(f'{v:.1f}' for v in 1e3 * tip_m)} ± {1e3 * std_m:.1f}"
            for digit, tip_m, std_m in zip(DIGITS, self.tips_m, self.tip_std_m, strict=True)
            if np.isfinite(tip_m).all()
        ]
        if tips:
            lines.append(f"Tips (x, y, z ± one standard deviation, mm): {'; '.join(tips)}.")
        else:
            lines.append("The rig has no tips: its last joints are in joints_m.")
        n_told = np.count_nonzero(self.told_angles)
        lines.append(f"The measurement tells {n_told} of {len(ANGLE_NAMES)} angles.")
        if self.doubtful:
            lines[-1] = "No tip and no angle is determined, since the fit is doubtful."
        elif self.untold:
            lines[-1] += f" It does not tell, and the start gave: {', '.join(self.untold)}."
        if len(self.basins) > 1:
            others = (
                f"from '{basin.start}' with deviance {basin.deviance - self.deviance:+.1f}, tips "
                f"up to {1e3 * self.tips_apart_m(basin).max():.0f} mm away"
                for basin in self.basins[1:]
            )
            lines.append(f"Other poses that it came to rest in: {'; '.join(others)}.")
        lines += [f"Doubtful: {remark}." for remark in self.remarks()]
        return "\n".join(lines)


def end_joints(joints_m: np.ndarray) -> list[int]:
    """The last joint of every digit that a hand with joints (25, 3) has: a rig may have no tip."""
    return [tip if np.isfinite(joints_m[tip]).all() else tip - 1 for tip in TIPS]


def ends_apart_m(one_m: np.ndarray, other_m: np.ndarray) -> np.ndarray:
    """Distances, (5,), between the digits' ends of one hand with joints, (25, 3), in two poses."""
    return np.linalg.norm((one_m - other_m)[end_joints(one_m)], axis=1)


def by_joint(values: np.ndarray) -> dict[str, Any]:
    """Values (25, ...) by the name of the joint; None where the hand has no such joint."""
    return {
        name: value.tolist() if np.isfinite(value).all() else None
        for name, value in zip(JOINT_NAMES, values, strict=True)
    }
