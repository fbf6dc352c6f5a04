"""Results of fits of a hand, made up around a hand of known pose."""

from dataclasses import replace
from typing import Any

import numpy as np

from calibration.hand_fit.result import ANGLE_NAMES, Basin, HandFit
from clradar import Scene
from clradar.hand import HandShape, hand_mesh, pose_by_name

UNTOLD = ("index-finger-phalanx-distal flexion", "thumb-phalanx-distal flexion")


def placed_hand(letter: str, shift_m: tuple[float, float, float] = (0.0, 0.0, 0.3)) -> Any:
    """The mesh of a hand 30 cm in front of the radar, and its transform."""
    mesh = hand_mesh(letter, edge_length_m=4e-3, center_m=shift_m)
    transform = np.eye(4)
    transform[:3, 3] = mesh.joints_m[0]
    return mesh, transform


def made_up_fit(letter: str = "F", start: str = "L", **changes: Any) -> HandFit:
    """The fit of a letter that began at another; `changes` are of its fields."""
    (mesh, transform), (before, _) = placed_hand(letter), placed_hand(start)
    pose = pose_by_name(letter)
    joint_std_m = np.full(25, 1e-3)
    joint_std_m[[4, 9]] = 5e-3
    n = len(ANGLE_NAMES) + 6
    fit = HandFit(
        pose=pose,
        shape=HandShape(),
        handedness="right",
        transform=transform,
        scene=Scene.from_mesh(mesh, alpha=0.3),
        started=Scene.from_mesh(before, alpha=0.3),
        joints_m=np.array(mesh.joints_m),
        joint_covariance_m2=joint_std_m[:, None, None] ** 2 * np.eye(3) / 3.0,
        angle_std_rad=np.radians(np.full(len(ANGLE_NAMES), 3.0)),
        untold=UNTOLD,
        alpha=0.3,
        log_brightness=np.linspace(0.0, -3.0, 7),
        deviance=100.0,
        basins=(
            Basin(start, pose, transform, np.array(mesh.joints_m), 100.0, "right"),
            Basin("D", pose_by_name(start), transform, np.array(before.joints_m), 130.0, "right"),
        ),
        start=start,
        likeness=0.8,
        overlap=0.95,
        converged=True,
        covariance=1e-4 * np.eye(n),
        parameter_names=(*ANGLE_NAMES, *("rotation " + a for a in "xyz"), "x", "y", "z"),
    )
    return replace(fit, **changes)
