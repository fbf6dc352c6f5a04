"""Initial rotations of a global registration, and its options."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from clradar.model import checks

TILTS = 17  # none, and 15 and 30 degrees in eight directions


def start_rotations(search_deg: float) -> list[Rotation]:
    """Rotations about boresight, then tilts, in steps of 15 degrees; the identity first."""
    n = int(search_deg // 15)
    angles_deg = sorted((15 * k for k in range(-n, n + 1) if 15 * k > -180), key=abs)
    about = np.radians(np.arange(8) * 45.0)
    axes = np.stack([np.cos(about), np.sin(about), np.zeros(8)], axis=1)
    tilts = np.concatenate([np.zeros((1, 3)), 15.0 * axes, 30.0 * axes])
    return [
        Rotation.from_rotvec(tilt, degrees=True) * Rotation.from_euler("z", angle, degrees=True)
        for tilt in tilts
        for angle in angles_deg
    ]


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """Checked options of a registration: see `align` and `align_mesh`."""

    function: str
    search_deg: float
    min_inlier_share: float
    max_iterations: int

    def __post_init__(self) -> None:
        name = self.function
        if checks.positive(f"{name}: search_deg", self.search_deg) > 180:
            checks.fail(f"{name}: search_deg", "an angle in (0, 180]", repr(self.search_deg))
        if checks.positive(f"{name}: min_inlier_share", self.min_inlier_share) > 1:
            got = repr(self.min_inlier_share)
            checks.fail(f"{name}: min_inlier_share", "a share in (0, 1]", got)
        checks.whole(f"{name}: max_iterations", self.max_iterations, 1)
