"""The hand in one frame of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.hand_fit.hand_shape_vector import N_SHAPE, SHAPE_NAMES
from calibration.hand_fit.hand_state import N_ANGLES, HandState, angles_of
from calibration.hand_fit.result import ANGLE_NAMES, TIPS, by_joint
from clradar.files.failures import reading
from clradar.hand import JOINT_NAMES, HandShape
from clradar.hand.pose_file import pose_of_table, pose_table
from clradar.model.record import plain

SEARCHED, FOLLOWED, NOTHING = "searched", "followed", "nothing found"


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """The hand in one frame, from that frame and those before it.

    Attributes
    ----------
    frame : int
        Its number in the recording.
    time_s : float
        By its time stamp; without one, frames are 1/8 s apart.
    how : "searched", "followed" or "nothing found"
    start : str
        The starting pose, or "frame 3".
    notes : tuple of str
        Why it was searched anew, or has no hand.
    state : HandState or None
        Its `pose`, `shape` and `transform`; None without a hand.
    handedness, joints_m, joint_std_m, angle_std_rad
        As of `HandFit`; NaN without a hand.
    shape_std : ndarray, shape (8,)
        Of the logarithms of length, breadth, the digits' lengths and girth; 0 where not fitted.
    untold : tuple of str
        Angles that this frame does not determine: they keep what the frames before say.
    misfit, misfit_per_cell : float
        Robust deviance of the image; the same for each resolution cell with a hand, measured or
        fitted.
    """

    frame: int
    time_s: float
    how: str
    start: str
    notes: tuple[str, ...]
    handedness: str
    state: HandState | None
    joints_m: np.ndarray
    joint_std_m: np.ndarray
    angle_std_rad: np.ndarray
    shape_std: np.ndarray
    untold: tuple[str, ...]
    misfit: float
    misfit_per_cell: float

    @property
    def tips_m(self) -> np.ndarray:
        """Tips of the digits, shape (5, 3)."""
        return self.joints_m[list(TIPS)]

    @property
    def tip_std_m(self) -> np.ndarray:
        """`joint_std_m` of the tips, shape (5,)."""
        return self.joint_std_m[list(TIPS)]

    def to_dict(self) -> dict[str, Any]:
        """The frame in types that JSON has; with a hand it is a start that `fit_hand` takes."""
        names = ("frame", "time_s", "how", "start", "notes", "handedness")
        record: dict[str, Any] = plain({name: getattr(self, name) for name in names})
        if self.state is None:
            return record
        columns = (np.degrees(angles_of(self.state.pose)), np.degrees(self.angle_std_rad))
        rows = zip(ANGLE_NAMES, *(column.tolist() for column in columns), strict=True)
        return record | {
            "pose": pose_table(self.state.pose),
            "shape": asdict(self.state.shape),
            "shape_std": dict(zip(SHAPE_NAMES, self.shape_std.tolist(), strict=True)),
            "transform": self.state.transform.tolist(),
            "joints_m": by_joint(self.joints_m),
            "joint_std_m": by_joint(self.joint_std_m),
            "angles": {
                name: {"value_deg": value, "std_deg": std, "told": name not in self.untold}
                for name, value, std in rows
            },
            "misfit": self.misfit,
            "misfit_per_cell": self.misfit_per_cell,
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], path: Path) -> FrameFit:
        """The frame of a record of `to_dict`; `path` is what errors name."""
        with reading(path, "the record of a fitted frame"):
            about = (record["how"], record["start"], tuple(record["notes"]), record["handedness"])
            if "pose" not in record:
                return cls.nothing(record["frame"], record["time_s"], *about[2:])
            lengths = {"finger_lengths": tuple(record["shape"]["finger_lengths"])}
            angles = record["angles"]
            return cls(
                record["frame"],
                record["time_s"],
                *about,
                state=HandState(
                    pose_of_table(record["pose"], path),
                    HandShape(**(record["shape"] | lengths)),
                    np.array(record["transform"]),
                ),
                joints_m=_of_joints(record["joints_m"], 3),
                joint_std_m=_of_joints(record["joint_std_m"], 1)[:, 0],
                angle_std_rad=np.radians([angles[name]["std_deg"] for name in ANGLE_NAMES]),
                shape_std=np.array([record["shape_std"][name] for name in SHAPE_NAMES]),
                untold=tuple(name for name in ANGLE_NAMES if not angles[name]["told"]),
                misfit=record["misfit"],
                misfit_per_cell=record["misfit_per_cell"],
            )

    @classmethod
    def nothing(
        cls, frame: int, time_s: float, notes: tuple[str, ...], handedness: str
    ) -> FrameFit:
        """A frame in which no hand was found."""
        n = len(JOINT_NAMES)
        return cls(
            frame, time_s, NOTHING, "", notes, handedness, None, np.full((n, 3), np.nan),
            np.full(n, np.nan), np.full(N_ANGLES, np.nan), np.full(N_SHAPE, np.nan), (), np.nan,
            np.nan,
        )  # fmt: skip


def _of_joints(by_joint: Mapping[str, Any], n: int) -> np.ndarray:
    """Values by the name of the joint, shape (25, n); NaN for None."""
    rows = (by_joint[name] for name in JOINT_NAMES)
    return np.array([[np.nan] * n if row is None else np.atleast_1d(row) for row in rows], float)
