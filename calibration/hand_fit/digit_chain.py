"""Where many angles of one digit take its bones: a product of rotations, without a new skeleton.

R. W. Brockett, "Robotic manipulators and the product of exponentials formula", 1984: angle by angle
from the base, each turns all that follows about an axis that is known in one reference pose.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.hand_fit.bone_rates import axes_of
from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, HandState
from calibration.hand_fit.skinned import Bones
from clradar.hand.joints import FINGERS

BONES_OF_ANGLES = {
    "thumb": (1, 1, 1, 2, 3),
    **{finger: (6 + 5 * i, 6 + 5 * i, 7 + 5 * i, 8 + 5 * i) for i, finger in enumerate(FINGERS)},
}
"""Which bone each of a digit's angles turns, from the base to the tip."""


def bones_of_digit(digit: str) -> slice:
    """The bones that a digit's angles move, its tip included, among `JOINT_NAMES`."""
    turned = BONES_OF_ANGLES[digit]
    return slice(turned[0], turned[-1] + 2)


class DigitChain:
    """A digit of a hand whose other parts stay."""

    def __init__(self, model: HandModel, state: HandState, digit: str) -> None:
        self.own, self.turned = ANGLES_OF_DIGIT[digit], BONES_OF_ANGLES[digit]
        self.bones = model.bones(state.pose, state.shape).moved(state.transform)
        self._angles_rad = state.angles_rad
        self._axes = axes_of(self.bones, state.pose)[self.own]

    def places(self, angles_rad: np.ndarray) -> Bones:
        """The bones for rows of `angles_rad`, (n, 23): arrays (n, 25, 3, 3) and (n, 25, 3).

        Only the digit's angles count.
        """
        n = len(angles_rad)
        matrix = np.repeat(self.bones.matrix[None], n, axis=0)
        origin_m = np.repeat(self.bones.origin_m[None], n, axis=0)
        turn, shift_m = np.repeat(np.eye(3)[None], n, axis=0), np.zeros((n, 3))
        away = (angles_rad - self._angles_rad)[:, self.own]
        for axis, angle, bone in zip(self._axes, away.T, self.turned, strict=True):
            base_m = self.bones.origin_m[bone]
            here = Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
            # x -> turn (here (x - base) + base) + shift
            shift_m = shift_m + np.einsum("nij,nj->ni", turn, base_m - here @ base_m)
            turn = turn @ here
            for moved in (bone, bone + 1):  # a tip follows the last bone
                matrix[:, moved] = turn @ self.bones.matrix[moved]
                origin_m[:, moved] = turn @ self.bones.origin_m[moved] + shift_m
        return Bones(matrix, origin_m)
