"""Poses and shapes of hands as JSON values that read back to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from clradar.hand import ANGLES, JOINT_NAMES, HandPose, HandShape, JointAngles

SHAPE_COLUMNS = (
    "length_m",
    "breadth_m",
    *(f"finger_lengths.{digit}" for digit in ("thumb", "index", "middle", "ring", "pinky")),
    "girth",
)
"""Names of the numbers of `shape_row`."""


def pose_record(pose: HandPose) -> dict[str, Any]:
    """Return name and angles, without joints whose angles are all 0."""
    joints = {
        joint: [getattr(angles, f"{name}_rad") for name in ANGLES]
        for joint, angles in pose.joints.items()
    }
    return {"name": pose.name, "joints_rad": joints}


def pose_of(record: Mapping[str, Any]) -> HandPose:
    joints = {joint: JointAngles(*angles) for joint, angles in record["joints_rad"].items()}
    return HandPose(record["name"], joints)


def angles_rad(pose: HandPose) -> np.ndarray:
    """Return the angles of all joints, shape (25, 3), radians: `JOINT_NAMES` by `ANGLES`."""
    joints = (pose.angles(name) for name in JOINT_NAMES)
    return np.array([[getattr(own, f"{name}_rad") for name in ANGLES] for own in joints])


def shape_record(shape: HandShape) -> dict[str, Any]:
    return {**asdict(shape), "finger_lengths": list(shape.finger_lengths)}


def shape_row(shape: HandShape | None) -> list[float]:
    """Return a shape as numbers, in the order of `SHAPE_COLUMNS`; NaN if there is none."""
    if shape is None:
        return [float("nan")] * len(SHAPE_COLUMNS)
    return [shape.length_m, shape.breadth_m, *shape.finger_lengths, shape.girth]
