"""What is remembered of a moving hand from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import fractional_matrix_power

from calibration.hand_fit.belief import Belief
from calibration.hand_fit.hand_shape_vector import N_SHAPE
from calibration.hand_fit.hand_state import HandState
from clradar.hand import JOINT_NAMES, HandPose, HandShape, JointAngles
from clradar.hand.joints import ANGLES

FRAME_S = 0.125  # between frames without time stamps
MOST_STEPS = 4.0  # times that the last motion is taken to go on, while no hand is found


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The hand after a frame."""

    frame: int  # the last that was fitted, whether or not a hand was found in it
    seen: int  # the last frame with a hand; less than 0 before there is any
    seen_s: float  # when that was
    handedness: str  # "right" or "left"
    state: HandState
    joints_m: np.ndarray  # (25, 3)
    log_brightness: np.ndarray  # (7,)
    belief: Belief
    moved: np.ndarray  # (4, 4): motion from the frame before the last
    moved_s: float  # in which it was
    misfits: tuple[float, ...]  # per cell, of the last frames since a search

    def predicted(self, passed_s: float) -> np.ndarray:
        """Transform of the hand so much later, if it goes on moving as it did."""
        steps = min(passed_s / self.moved_s, MOST_STEPS)
        motion = np.real(fractional_matrix_power(self.moved, steps))
        left, _, right = np.linalg.svd(motion[:3, :3])
        motion[:3, :3] = left @ right
        return np.asarray(motion @ self.state.transform)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """All of it as arrays, from which `from_arrays` makes it again bit by bit."""
        joints = [self.state.pose.angles(joint) for joint in JOINT_NAMES]
        shape = self.state.shape
        return {
            "frames": np.array([self.frame, self.seen]),
            "seen_s": np.array(self.seen_s),
            "handedness": np.array(self.handedness),
            "joints_m": self.joints_m,
            "pose": np.array(self.state.pose.name),
            "angles_rad": np.array(
                [[getattr(j, f"{name}_rad") for name in ANGLES] for j in joints]
            ),
            "shape": np.array(
                [shape.length_m, shape.breadth_m, *shape.finger_lengths, shape.girth]
            ),
            "transform": self.state.transform,
            "log_brightness": self.log_brightness,
            "mean": self.belief.mean,
            "covariance": self.belief.covariance,
            "nominal_shape": self.belief.nominal_shape,
            "moved": self.moved,
            "moved_s": np.array(self.moved_s),
            "misfits": np.array(self.misfits),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> Track:
        """The track of the arrays of `to_arrays`."""
        angles = {
            joint: JointAngles(*row)
            for joint, row in zip(JOINT_NAMES, arrays["angles_rad"].tolist(), strict=True)
        }
        length_m, breadth_m, *fingers, girth = arrays["shape"].tolist()
        assert len(fingers) == N_SHAPE - 3
        shape = HandShape(length_m, breadth_m, tuple(fingers), girth)
        frame, seen = arrays["frames"].tolist()
        return cls(
            frame,
            seen,
            float(arrays["seen_s"]),
            str(arrays["handedness"]),
            HandState(HandPose(str(arrays["pose"]), angles), shape, arrays["transform"]),
            arrays["joints_m"],
            arrays["log_brightness"],
            Belief(arrays["mean"], arrays["covariance"], arrays["nominal_shape"]),
            arrays["moved"],
            float(arrays.get("moved_s", FRAME_S)),  # tracks of version 0.2 lack it
            tuple(arrays["misfits"].tolist()),
        )
