"""How fast the bones of a hand move with its motion, its angles and its shape.

R. W. Brockett, "Robotic manipulators and the product of exponentials formula", 1984: an angle turns
all that follows its joint about a known axis through the joint.
"""

from __future__ import annotations

import numpy as np

from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_shape_vector import N_SHAPE, shape_of, vector_of
from calibration.hand_fit.hand_state import FITTED_ANGLES, HandState
from calibration.hand_fit.skinned import BoneRates, Bones
from clradar.hand import HandPose
from clradar.hand.joints import ANGLES, FINGERS, JOINT_INDEX, JOINT_NAMES
from clradar.hand.skeleton import turning_axes

TURNED = tuple(JOINT_INDEX[joint] for joint, _ in FITTED_ANGLES)
"""Which bone each of the fitted angles turns."""

_DIGIT = np.array([name.split("-")[0] for name in JOINT_NAMES])

SAME_DIGIT = [np.flatnonzero(_DIGIT[list(TURNED)] == digit) for digit in ("thumb", *FINGERS)]
"""The fitted angles of each digit, that of its metacarpal among them."""

FOLLOWING = (_DIGIT[list(TURNED), None] == _DIGIT) & (np.arange(25) >= np.c_[list(TURNED)])
"""Mask (23, 25) of the bones that each of the fitted angles moves: it, and the digit beyond it."""

_SHAPE_STEP = 1e-6
"""Of a skeleton in double precision: both the rest of the series and rounding stay below 1e-6."""


def axes_of(bones: Bones, pose: HandPose) -> np.ndarray:
    """Unit axes about which the fitted angles turn the bones of a pose, (23, 3)."""
    by_joint = {joint: turning_axes(pose, joint) for joint, _ in FITTED_ANGLES}
    own = np.array([by_joint[joint][:, ANGLES.index(angle)] for joint, angle in FITTED_ANGLES])
    matrix = bones.matrix[list(TURNED)]
    frames = matrix / np.linalg.norm(matrix, axis=1, keepdims=True)
    # The axes of a left hand's bones are mirrored, which turns rotations round.
    handed = np.sign(np.linalg.det(frames))[:, None]
    return handed * np.einsum("nij,nj->ni", frames, own)


def bone_rates(model: HandModel, state: HandState, bones: Bones, centre_m: np.ndarray) -> BoneRates:
    """Derivatives of `bones`, those of a state in the antenna frame, by 37 parameters.

    These are a twist about `centre_m` (`calibration.registration.rigid_motion.exp_twist`), the
    fitted angles and the shape; arrays (37, 25, 3, 3) and (37, 25, 3). At a limit of the shape they
    are those of one side.
    """
    rotations = _turning(np.eye(3), np.tile(centre_m, (3, 1)), bones)
    shifts = BoneRates(np.zeros((3, 25, 3, 3)), np.repeat(np.eye(3)[:, None], 25, axis=1))
    turns = _turning(axes_of(bones, state.pose), bones.origin_m[list(TURNED)], bones)
    turns.matrix[~FOLLOWING], turns.origin_m[~FOLLOWING] = 0.0, 0.0
    parts = (rotations, shifts, turns, _by_shape(model, state, bones))
    return BoneRates(
        np.concatenate([part.matrix for part in parts]),
        np.concatenate([part.origin_m for part in parts]),
    )


def _turning(axes: np.ndarray, bases_m: np.ndarray, bones: Bones) -> BoneRates:
    """Derivatives by rotations about axes, (k, 3), through bases, (k, 3)."""
    cross = np.swapaxes(np.cross(axes[:, None], np.eye(3)), 1, 2)  # the product as matrices
    return BoneRates(
        cross[:, None] @ bones.matrix,
        np.cross(axes[:, None], bones.origin_m - bases_m[:, None]),
    )


def _by_shape(model: HandModel, state: HandState, bones: Bones) -> BoneRates:
    matrix, origin_m = np.zeros((N_SHAPE, 25, 3, 3)), np.zeros((N_SHAPE, 25, 3))
    if model.has_shape:
        vector = vector_of(state.shape)
        for k, step in enumerate(_SHAPE_STEP * np.eye(N_SHAPE)):
            if vector_of(shape_of(vector + step))[k] < vector[k] + 0.5 * _SHAPE_STEP:  # at a limit
                step = -step
            ahead = model.bones(state.pose, shape_of(vector + step)).moved(state.transform)
            matrix[k] = (ahead.matrix - bones.matrix) / step[k]
            origin_m[k] = (ahead.origin_m - bones.origin_m) / step[k]
    return BoneRates(matrix, origin_m)
