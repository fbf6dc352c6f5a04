"""Rigid motions: 4x4 matrices, the exponential map of SE(3), Kabsch's fit, point-to-plane rows."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from clradar.motion.rigid import moved as moved


def moved_back(transform: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    """Apply the inverse of a 4x4 `transform` to one point, shape (3,), metres."""
    return transform[:3, :3].T @ (point_m - transform[:3, 3])


def rotation_about(rotation: Rotation, from_m: np.ndarray, to_m: np.ndarray) -> np.ndarray:
    """4x4 matrix of a rotation about the point `from_m` and a shift of that point to `to_m`."""
    transform = np.eye(4)
    transform[:3, :3] = rotation.as_matrix()
    transform[:3, 3] = to_m - transform[:3, :3] @ from_m
    return transform


def orthonormal(transform: np.ndarray) -> np.ndarray:
    """A 4x4 matrix with its rotation orthonormalised against accumulated rounding."""
    clean = np.array(transform)
    clean[:3, :3] = Rotation.from_matrix(clean[:3, :3]).as_matrix()
    return clean


def exp_twist(twist: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
    """The finite motion of a twist, (6,), the exponential map of SE(3), (4, 4).

    A twist is a rotation vector (radians), then the velocity (metres) of the point `centre_m`. It
    is the exponential, not a rotation followed by a shift: a twist about any axis in space gives
    the rotation about that axis, however large, so that motions which map a surface onto itself (a
    sphere about its centre) do so exactly.
    """
    x, y, z = twist[:3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(twist[:3]))
    # (1 - cos a) / a^2 and (a - sin a) / a^3; the series where their differences cancel.
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    sixth = (angle - np.sin(angle)) / angle**3 if angle > 0.01 else (1.0 - angle**2 / 20.0) / 6.0
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(twist[:3]).as_matrix()
    transform[:3, 3] = (np.eye(3) + half * cross + sixth * cross @ cross) @ (
        twist[3:] - cross @ centre_m
    )
    return transform


def kabsch(from_m: np.ndarray, to_m: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The rigid motion that minimises sum of weights * |to - motion(from)|^2, never a reflection.

    Points have shape (n, 3), weights (n,) a sum above 0. W. Kabsch, "A solution for the best
    rotation to relate two sets of vectors", Acta Cryst. A32, 1976, doi 10.1107/S0567739476001873.
    """
    share = weights / weights.sum()
    from_centre, to_centre = share @ from_m, share @ to_m
    u, _, vt = np.linalg.svd((from_m - from_centre).T @ ((to_m - to_centre) * share[:, None]))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = Rotation.from_matrix(vt.T @ flip @ u.T)
    return rotation_about(rotation, from_centre, to_centre)


def plane_jacobian(points_m: np.ndarray, normals: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
    """Derivative, (n, 6), of the point-to-plane residuals n.(p - q) by a twist about `centre_m`.

    Of the moved points p and the unit normals of the planes that they are matched with, both (n,
    3): by the rotation vector (metres per radian), then by the translation (1).
    """
    return np.concatenate([np.cross(points_m - centre_m, normals), normals], axis=1)
