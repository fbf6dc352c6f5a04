"""The joint angles that a measurement can tell, and the state of a hand that is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clradar.hand import LIMITS_DEG, HandPose, HandShape, JointAngles
from clradar.hand.joints import FINGERS

FITTED_ANGLES: tuple[tuple[str, str], ...] = (
    ("thumb-metacarpal", "flexion"),
    ("thumb-metacarpal", "abduction"),
    ("thumb-metacarpal", "twist"),
    ("thumb-phalanx-proximal", "flexion"),
    ("thumb-phalanx-distal", "flexion"),
    *(
        (f"{finger}-finger-{bone}", angle)
        for finger in FINGERS
        for bone, angle in (
            ("phalanx-proximal", "flexion"),
            ("phalanx-proximal", "abduction"),
            ("phalanx-intermediate", "flexion"),
            ("phalanx-distal", "flexion"),
        )
    ),
    ("ring-finger-metacarpal", "flexion"),
    ("pinky-finger-metacarpal", "flexion"),
)
"""Joint and angle of the 23 parameters. All others, those of the wrist among them, stay as in the
starting pose: the rigid motion of the hand does what the wrist would."""

N_ANGLES = len(FITTED_ANGLES)

ANGLES_OF_DIGIT = {
    "thumb": slice(0, 5),
    **{finger: slice(5 + 4 * i, 9 + 4 * i) for i, finger in enumerate(FINGERS)},
    "palm": slice(21, 23),
}
"""Where the angles of a digit, and those of the palm's arch, are among `FITTED_ANGLES`."""

LOWEST_RAD, HIGHEST_RAD = (
    np.radians([LIMITS_DEG[joint][angle][end] for joint, angle in FITTED_ANGLES]) for end in (0, 1)
)
"""Anatomical limits, shape (23,), radians."""


def angles_of(pose: HandPose) -> np.ndarray:
    """The fitted angles of a pose, shape (23,), radians."""
    return np.array([getattr(pose.angles(joint), f"{angle}_rad") for joint, angle in FITTED_ANGLES])


def pose_with(pose: HandPose, angles_rad: np.ndarray, name: str | None = None) -> HandPose:
    """`pose` with other fitted angles, (23,), clipped to the limits; the rest stays."""
    clipped = np.clip(angles_rad, LOWEST_RAD, HIGHEST_RAD)
    joints = dict(pose.joints)
    for k in np.flatnonzero(clipped != angles_of(pose)):
        joint, angle = FITTED_ANGLES[k]
        known = joints.get(joint, JointAngles())
        joints[joint] = replace(known, **{f"{angle}_rad": float(clipped[k])})
    return HandPose(pose.name if name is None else name, joints)


@dataclass(frozen=True, slots=True, eq=False)
class HandState:
    """Joint angles, shape and place of a hand.

    `transform` is the rigid motion from the frame of the hand (`clradar.hand.posed_skeleton`,
    mirrored in x for a left hand; the wrist is the origin) to the antenna frame, metres.
    """

    pose: HandPose  # whose wrist angles are those of the starting pose
    shape: HandShape  # of the parametric hand; a rig ignores it
    transform: np.ndarray  # (4, 4)

    @property
    def angles_rad(self) -> np.ndarray:
        """The fitted angles, shape (23,)."""
        return angles_of(self.pose)

    def with_angles(self, angles_rad: np.ndarray) -> HandState:
        """The same hand with other fitted angles, (23,), clipped to the limits."""
        return replace(self, pose=pose_with(self.pose, angles_rad))
