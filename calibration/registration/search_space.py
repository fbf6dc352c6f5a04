"""Initial rotations of a global registration, and the checks of its options."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from clradar.model import checks

TILTS = 17
"""None, and 15 and 30 degrees in eight directions."""


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


def check_search(
    function: str, search_deg: float, min_inlier_share: float, max_iterations: int
) -> None:
    """Raise `ModelError` unless the options of a registration are in their ranges."""
    if checks.positive(f"{function}: search_deg", search_deg) > 180:
        checks.fail(f"{function}: search_deg", "an angle in (0, 180]", repr(search_deg))
    if checks.positive(f"{function}: min_inlier_share", min_inlier_share) > 1:
        checks.fail(f"{function}: min_inlier_share", "a share in (0, 1]", repr(min_inlier_share))
    checks.whole(f"{function}: max_iterations", max_iterations, 1)
