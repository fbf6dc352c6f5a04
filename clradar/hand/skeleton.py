"""Forward kinematics of the hand: 25 joints with the names of WebXR Hand Input.

Everything here is a right hand in its own frame: origin in the middle of the wrist crease, +y along
the fingers, palm towards -z, thumb towards -x. Placing it in front of the radar is a translation,
and a left hand is the mirror image in x.

Bone lengths are the means of Buryanov and Kotiuk, "Proportions of hand segments", Int. J. Morphol.
28(3), 2010 (adults, radiographs). The carpus and the distances between the knuckles are chosen so
that the hand has the length (wrist crease to middle fingertip) and the breadth (at the knuckles) of
an average adult: Greiner, "Hand anthropometry of U.S. Army personnel", NATICK TR-92/011, 1991, has
means of about 194 and 90 mm for men, 181 and 79 mm for women.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clradar.hand.joints import FINGER_BONES, FINGERS, JOINT_INDEX, THUMB_BONES
from clradar.hand.pose import HandPose
from clradar.hand.pose_file import pose_by_name
from clradar.hand.shape import AVERAGE, HandShape

MILLIMETRE_M = 1e-3

# Proximal, intermediate, distal phalanx, in millimetres (Buryanov and Kotiuk 2010, rounded).
PHALANGES_MM: dict[str, tuple[float, float, float]] = {
    "index": (39.8, 22.4, 15.8),
    "middle": (44.6, 26.3, 17.4),
    "ring": (41.4, 25.7, 17.3),
    "pinky": (32.7, 18.1, 16.0),
}
# Metacarpal, proximal, distal.
THUMB_MM = (46.2, 31.6, 21.7)

# Base (carpometacarpal joint) and head (knuckle) of each metacarpal. The distances agree with the
# published lengths 68.1, 64.6, 58.0 and 53.7 mm; the heads follow the transverse arch of the palm.
_METACARPALS_MM: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "index": ((-13.0, 26.3, -0.5), (-26.5, 93.1, -1.5)),
    "middle": ((-1.5, 30.8, 1.0), (-5.0, 95.3, 1.0)),
    "ring": ((9.0, 29.3, 0.0), (15.5, 86.9, -0.5)),
    "pinky": ((18.5, 26.3, -2.5), (33.0, 77.8, -4.0)),
}
_THUMB_BASE_MM = (-21.0, 18.8, -8.0)

# Lengths of the average hand, wrist crease to the tip of the straight middle finger with 3.8 mm of
# soft tissue, and the vector between its outer knuckles.
_PALM_LENGTH_MM = _METACARPALS_MM["middle"][1][1]
FINGER_TIP_TISSUE_MM = 3.8
_FINGER_LENGTH_MM = sum(PHALANGES_MM["middle"]) + FINGER_TIP_TISSUE_MM
_KNUCKLES_MM = np.subtract(_METACARPALS_MM["pinky"][1], _METACARPALS_MM["index"][1])[:2]

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
    joints_m : ndarray, shape (25, 3)
        Joint centres in the order of `JOINT_NAMES`.
    frames : ndarray, shape (25, 3, 3)
        Axes of the bone that begins at each joint, as columns: bending axis, along the bone, dorsal
        (the side of the nail). A tip has the axes of the last bone.
    thickness : float
        Of the flesh around the bones, relative to the average hand.
    """

    joints_m: np.ndarray
    frames: np.ndarray
    thickness: float = 1.0

    def joint_m(self, name: str) -> np.ndarray:
        """The centre (3,) of a joint."""
        return self.joints_m[JOINT_INDEX[name]]

    def point_m(
        self, joint: int, along: float, side_mm: float = 0.0, dorsal_mm: float = 0.0
    ) -> np.ndarray:
        """A point (3,) next to the bone that begins at a joint, at a share of its length.

        Offsets are along the bending axis (away from the thumb) and towards the back, in an average
        hand: a thicker one has them larger.
        """
        begin_m, end_m = self.joints_m[joint : joint + 2]
        offset_m = np.array([side_mm, 0.0, dorsal_mm]) * (self.thickness * MILLIMETRE_M)
        return begin_m + along * (end_m - begin_m) + self.frames[joint] @ offset_m


def _proportions(shape: HandShape) -> tuple[np.ndarray, dict[str, float], float]:
    """Return factors to the average hand: of places in the palm (3,), of bones, and of flesh.

    Fingers are relative to the hand: palm and fingers are scaled until the middle finger ends at
    the hand's length. Knuckles allow for the flesh beside them, so that the breadth always holds.
    """
    middle = shape.finger_lengths[2]
    scale = shape.length_m / MILLIMETRE_M / (_PALM_LENGTH_MM + middle * _FINGER_LENGTH_MM)
    thickness = shape.girth * shape.breadth_m / AVERAGE.breadth_m
    beside_mm = AVERAGE.breadth_m / MILLIMETRE_M - float(np.linalg.norm(_KNUCKLES_MM))
    knuckles_mm = shape.breadth_m / MILLIMETRE_M - thickness * beside_mm
    across_mm = float(np.sqrt(knuckles_mm**2 - (scale * _KNUCKLES_MM[1]) ** 2))
    digits = zip(("thumb", *FINGERS), shape.finger_lengths, strict=True)
    palm = np.array([across_mm / _KNUCKLES_MM[0], scale, thickness])
    return palm, {name: scale * factor for name, factor in digits}, thickness


def _axis_rotation(axis: int, angle_rad: float) -> np.ndarray:
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
    # Cross products, written out: numpy's takes most of the time of a skeleton.
    side = np.array([along[1], -along[0], 0.0])
    side /= np.linalg.norm(side)
    dorsal = [
        side[1] * along[2] - side[2] * along[1],
        side[2] * along[0] - side[0] * along[2],
        side[0] * along[1] - side[1] * along[0],
    ]
    return np.stack([side, along, dorsal], axis=1)


def _signs(joint: str) -> tuple[float, float]:
    """Return the positive sense of abduction and twist about the axes of the skeleton."""
    if joint.startswith(("wrist", "thumb")):
        return 1.0, -1.0
    return 1.0 if joint.startswith(("index", "middle")) else -1.0, 1.0


def _turn(pose: HandPose, joint: str) -> np.ndarray:
    """Return the rotation (3, 3) of a joint of a pose, in the axes of the bone before it.

    Flexion comes first, about the bending axis of the bone before; then abduction, about the dorsal
    axis that the flexion has rotated; then twist about the bone.
    """
    angles, (abduction_sign, twist_sign) = pose.angles(joint), _signs(joint)
    # Bending rotates the bone (+y) towards the palm (-z), hence the negative angle about x.
    return (
        _axis_rotation(0, -angles.flexion_rad)
        @ _axis_rotation(2, abduction_sign * angles.abduction_rad)
        @ _axis_rotation(1, twist_sign * angles.twist_rad)
    )


def turning_axes(pose: HandPose, joint: str) -> np.ndarray:
    """Return the axes about which the angles of a joint turn its bone, and all that follows.

    Unit vectors as columns (3, 3), of flexion, abduction and twist, in the axes of the bone
    (`Skeleton.frames`): right-handed rotations about them are growing angles.
    """
    angles = pose.angles(joint)
    abduction_sign, twist_sign = _signs(joint)
    untwist = _axis_rotation(1, -twist_sign * angles.twist_rad)
    flexion = _turn(pose, joint).T[:, 0]
    return np.stack([-flexion, abduction_sign * untwist[:, 2], [0.0, twist_sign, 0.0]], axis=1)


_Chain = tuple[list[np.ndarray], list[np.ndarray]]


def _chain(
    pose: HandPose, base_m: np.ndarray, frame: np.ndarray, bones: Sequence[str],
    lengths_mm: Sequence[float], scale: float,
) -> _Chain:  # fmt: skip
    """Return the joints that begin and end successive bones, and a frame for each joint.

    `frame` is that of all bones if their angles are 0.
    """
    joints_m, frames = [base_m], []
    for bone, length_m in zip(bones, np.array(lengths_mm) * scale * MILLIMETRE_M, strict=True):
        frame = frame @ _turn(pose, bone)
        frames.append(frame)
        joints_m.append(joints_m[-1] + frame[:, 1] * length_m)
    return joints_m, [*frames, frame]


def _finger(pose: HandPose, finger: str, palm: np.ndarray, scale: float) -> _Chain:
    metacarpal, *bones = (f"{finger}-finger-{bone}" for bone in FINGER_BONES[:-1])
    base_m, head_m = np.array(_METACARPALS_MM[finger]) * palm * MILLIMETRE_M
    palm_frame = _frame_along(head_m - base_m)
    roll = _axis_rotation(1, np.deg2rad(_FINGER_ROLL_DEG[finger]))
    if metacarpal in pose.joints:
        frame = palm_frame @ _turn(pose, metacarpal)
        # The finger rotates with the metacarpal.
        turn = frame @ palm_frame.T
        head_m, palm_frame, roll = base_m + turn @ (head_m - base_m), frame, turn @ roll
    joints_m, frames = _chain(pose, head_m, roll, bones, PHALANGES_MM[finger], scale)
    return [base_m, *joints_m], [palm_frame, *frames]


def posed_skeleton(pose: str | HandPose, shape: HandShape = AVERAGE) -> Skeleton:
    """Return the skeleton of a right hand in its own frame, whose origin is the wrist.

    The angles of the wrist rotate the whole hand; with all of them 0 it has +y along the fingers,
    the palm towards -z, the thumb towards -x.

    Examples
    --------
    >>> straight = clradar.hand.posed_skeleton(clradar.hand.HandPose("straight"))
    >>> [round(1e3 * c, 1) for c in straight.joint_m("middle-finger-tip").tolist()]  # millimetres
    [-5.0, 183.6, 1.0]
    """
    pose = pose if isinstance(pose, HandPose) else pose_by_name(pose)
    palm, scales, thickness = _proportions(shape)
    thumb_m = np.array(_THUMB_BASE_MM) * palm * MILLIMETRE_M
    bones = [f"thumb-{bone}" for bone in THUMB_BONES[:-1]]
    chains = [_chain(pose, thumb_m, _THUMB_REST, bones, THUMB_MM, scales["thumb"])]
    chains += [_finger(pose, finger, palm, scales[finger]) for finger in FINGERS]
    joints_m, frames = [np.zeros(3)], [np.eye(3)]
    for chain_m, axes in chains:
        joints_m += chain_m
        frames += axes
    at_m, turned = np.stack(joints_m), np.stack(frames)
    if "wrist" in pose.joints:
        turn = _turn(pose, "wrist")
        at_m, turned = at_m @ turn.T, turn @ turned
    return Skeleton(at_m, turned, thickness)
