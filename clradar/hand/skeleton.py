"""The hand's skeleton: 25 joints with the names of WebXR Hand Input, and forward kinematics.

Everything here is a right hand in its own frame: origin in the middle of the wrist crease, +y along
the fingers, palm towards -z, thumb towards -x. Placing it in front of the radar is a translation,
and a left hand is the mirror image in x.

Bone lengths are the means of Buryanov and Kotiuk, "Proportions of hand segments", Int. J. Morphol.
28(3), 2010 (adults, radiographs). The carpus and the distances between the knuckles are chosen so
that the hand has the length (wrist crease to middle fingertip) and the breadth (at the knuckles) of
an average adult: Greiner, "Hand anthropometry of U.S. Army personnel", NATICK TR-92/011, 1991, has
means of about 194 and 90 mm for men, 181 and 79 mm for women. The fingers come out about as long,
from their creases, as the means that Chatzioglou, Pinar and Govsa measured (Anat. Cell Biol. 57(2),
2024, doi 10.5115/acb.23.310): 64, 71, 66 and 53 mm from index to little finger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.hand.pose import FingerPose, HandPose, ThumbPose

MILLIMETRE_M = 1e-3

FINGERS: tuple[str, ...] = ("index", "middle", "ring", "pinky")

_FINGER_BONES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_THUMB_BONES = ("metacarpal", "phalanx-proximal", "phalanx-distal", "tip")

JOINT_NAMES: tuple[str, ...] = (
    "wrist",
    *(f"thumb-{bone}" for bone in _THUMB_BONES),
    *(f"{finger}-finger-{bone}" for finger in FINGERS for bone in _FINGER_BONES),
)
"""Joint names and their order: XRHandJoint of W3C WebXR Hand Input Module, Level 1.

A joint carries the name of the bone that begins there; `tip` is the end of the last bone.
"""

_JOINT_INDEX = {name: i for i, name in enumerate(JOINT_NAMES)}

# Proximal, intermediate, distal phalanx, in millimetres (Buryanov and Kotiuk 2010, rounded).
_PHALANGES_MM: dict[str, tuple[float, float, float]] = {
    "index": (39.8, 22.4, 15.8),
    "middle": (44.6, 26.3, 17.4),
    "ring": (41.4, 25.7, 17.3),
    "pinky": (32.7, 18.1, 16.0),
}
# Metacarpal, proximal, distal.
_THUMB_MM = (46.2, 31.6, 21.7)

# Base (carpometacarpal joint) and head (knuckle) of each metacarpal. The distances agree with the
# published lengths 68.1, 64.6, 58.0 and 53.7 mm; the heads follow the transverse arch of the palm.
_METACARPALS_MM: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "index": ((-13.0, 26.3, -0.5), (-26.5, 93.1, -1.5)),
    "middle": ((-1.5, 30.8, 1.0), (-5.0, 95.3, 1.0)),
    "ring": ((9.0, 29.3, 0.0), (15.5, 86.9, -0.5)),
    "pinky": ((18.5, 26.3, -2.5), (33.0, 77.8, -4.0)),
}
_THUMB_BASE_MM = (-21.0, 18.8, -8.0)

# Rotation of each finger's bending plane about the finger, positive towards the thumb's side: bent
# fingers converge towards the thumb, which they meet in a pinch, instead of staying parallel.
_FINGER_ROLL_DEG: dict[str, float] = {"index": 8.0, "middle": 0.0, "ring": 6.0, "pinky": 12.0}

# With all angles 0 the thumb is parallel to the fingers and bends in the plane of the palm: its
# bending axis (first column) is the dorsal direction, its dorsal side (third) looks towards -x.
_THUMB_REST = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """A posed right hand in its own frame.

    Parameters
    ----------
    joints_m : ndarray, shape (25, 3), float64, metres
        Joint centres in the order of `JOINT_NAMES`.
    frames : ndarray, shape (25, 3, 3), float64
        Axes of the bone that begins at each joint, as columns: bending axis, along the bone, dorsal
        (the side of the nail). A tip has the axes of the last bone.
    """

    joints_m: np.ndarray
    frames: np.ndarray

    def joint_m(self, name: str) -> np.ndarray:
        """Return the centre (3,) of the joint called `name`, metres."""
        return self.joints_m[_JOINT_INDEX[name]]

    def point_m(
        self, name: str, along: float, side_mm: float = 0.0, dorsal_mm: float = 0.0
    ) -> np.ndarray:
        """Return a point beside the bone that begins at a joint.

        Parameters
        ----------
        name : str
            The joint.
        along : float
            Fraction of the bone's length from that joint.
        side_mm, dorsal_mm : float, millimetres
            Offsets along the bending axis (away from the thumb) and towards the back of the bone.

        Returns
        -------
        ndarray, shape (3,), float64, metres
        """
        at = _JOINT_INDEX[name]
        begin_m, end_m = self.joints_m[at], self.joints_m[at + 1]
        offset_m = np.array([side_mm, 0.0, dorsal_mm]) * MILLIMETRE_M
        return begin_m + along * (end_m - begin_m) + self.frames[at] @ offset_m


def _turn(axis: int, angle_rad: float) -> np.ndarray:
    """Return the right-handed rotation matrix (3, 3) about a coordinate axis."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    after, last = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[after, after] = matrix[last, last] = c
    matrix[after, last], matrix[last, after] = -s, s
    return matrix


def _frame_along(direction: np.ndarray) -> np.ndarray:
    """Return axes (3, 3) whose second column is `direction` and whose third is nearly +z."""
    along = direction / np.linalg.norm(direction)
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    return np.stack([side, along, np.cross(side, along)], axis=1)


def _chain(
    base_m: np.ndarray, frame: np.ndarray, flexions_rad: tuple[float, ...], lengths_m: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the joints after `base_m` and the bones' frames, bending joint by joint."""
    joints_m, frames = [], []
    for flexion_rad, length_m in zip(flexions_rad, lengths_m, strict=True):
        # Bending turns the bone (+y) towards the palm (-z), hence the negative turn about x.
        frame = frame @ _turn(0, -flexion_rad)
        base_m = base_m + frame[:, 1] * length_m
        joints_m.append(base_m)
        frames.append(frame)
    return joints_m, frames


def _finger(finger: str, pose: FingerPose) -> tuple[list[np.ndarray], list[np.ndarray]]:
    base_m, head_m = np.array(_METACARPALS_MM[finger]) * MILLIMETRE_M
    # A positive turn about the dorsal axis goes towards the thumb.
    away = 1.0 if finger in ("index", "middle") else -1.0
    frame = _turn(1, np.deg2rad(_FINGER_ROLL_DEG[finger])) @ _turn(2, away * pose.abduction_rad)
    flexions_rad = (pose.mcp_flexion_rad, pose.pip_flexion_rad, pose.dip_flexion_rad)
    lengths_m = np.array(_PHALANGES_MM[finger]) * MILLIMETRE_M
    joints_m, frames = _chain(head_m, frame, flexions_rad, lengths_m)
    return (
        [base_m, head_m, *joints_m],
        [_frame_along(head_m - base_m), *frames, frames[-1]],
    )


def _thumb(pose: ThumbPose) -> tuple[list[np.ndarray], list[np.ndarray]]:
    base_m = np.array(_THUMB_BASE_MM) * MILLIMETRE_M
    frame = (
        _THUMB_REST
        @ _turn(0, -pose.cmc_flexion_rad)
        @ _turn(2, pose.cmc_abduction_rad)
        @ _turn(1, -pose.cmc_twist_rad)
    )
    flexions_rad = (0.0, pose.mcp_flexion_rad, pose.ip_flexion_rad)
    joints_m, frames = _chain(base_m, frame, flexions_rad, np.array(_THUMB_MM) * MILLIMETRE_M)
    return [base_m, *joints_m], [*frames, frames[-1]]


def posed_skeleton(pose: HandPose) -> Skeleton:
    """Return the skeleton of a right hand in its own frame."""
    joints_m, frames = [np.zeros(3)], [np.eye(3)]
    for joints, axes in (_thumb(pose.thumb), *(_finger(f, getattr(pose, f)) for f in FINGERS)):
        joints_m += joints
        frames += axes
    return Skeleton(np.stack(joints_m), np.stack(frames))
