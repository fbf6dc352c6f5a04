"""A radar, a motion and the errors of registrations."""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import clradar
from calibration import Registration, Round

ARRAY = clradar.arrays.qar50()
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 32)  # unambiguous over 0.46 m
CENTRE_M = np.array([0.0, 0.0, 0.3])
RADAR: dict[str, Any] = {"array": ARRAY, "waveform": WAVEFORM, "device": "pocl"}
RAYS: dict[str, Any] = {"samples_per_mm2": 1.5, "rays_per_sample": 2}

POSITION_M, ROTATION_DEG = 1.5e-3, 1.5
"""Required of 95 of 100 measurements of a hand (docs/registration-method.md)."""


class Registered(NamedTuple):
    """A registration, its rounds and the progress that it showed."""

    result: Registration
    rounds: list[Round]
    shares: list[float]


def motion(turn_deg: Any = (0.0, 0.0, 0.0), shift_m: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A rotation vector about `CENTRE_M`, then a shift, as a 4x4 matrix."""
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    transform[:3, 3] = CENTRE_M - transform[:3, :3] @ CENTRE_M + np.asarray(shift_m)
    return transform


def truth() -> np.ndarray:
    return motion((-5.0, 4.0, 6.0), (-0.008, 0.007, 0.005))


def errors(transform: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Position error at `CENTRE_M`, metres, and rotation error, degrees."""
    off = transform - truth
    turn = Rotation.from_matrix(transform[:3, :3] @ truth[:3, :3].T).magnitude()
    return float(np.linalg.norm(off[:3, :3] @ CENTRE_M + off[:3, 3])), float(np.degrees(turn))


def assert_found(transform: np.ndarray) -> None:
    """It is `truth` within what is required."""
    position_m, rotation_deg = errors(transform, truth())
    assert position_m < POSITION_M
    assert rotation_deg < ROTATION_DEG
