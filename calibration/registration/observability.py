"""Unobservable rigid degrees of freedom of a surface: detection, removal of their motion, names.

A degree of freedom is a twist about a centre, scaled so that all six numbers are metres. It is
unobservable if it hardly moves the surface along its normals: N. Gelfand, L. Ikemoto,
S. Rusinkiewicz, M. Levoy, "Geometrically stable sampling for the ICP algorithm", 3DIM 2003,
doi 10.1109/IM.2003.1240258.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.rigid_motion import exp_twist, moved_back, orthonormal

OBSERVABLE = 5e-3
"""Smallest eigenvalue of the scaled normal matrix of an observable direction: see
docs/registration-method.md."""


@dataclass(frozen=True, slots=True, eq=False)
class TwistScale:
    """Centre of twists, shape (3,), metres, and the typical distance of points from it, metres."""

    centre_m: np.ndarray
    radius_m: float

    @property
    def unit(self) -> np.ndarray:
        """Factors, shape (6,), that scale a twist to six lengths in metres."""
        return np.repeat([self.radius_m, 1.0], 3)


def unobservable(information: np.ndarray) -> np.ndarray:
    """Scaled twists that hardly move the surface along its normals, shape (6, k)."""
    values, vectors = np.linalg.eigh(information)
    return vectors[:, values < OBSERVABLE]


def complement(basis: np.ndarray) -> np.ndarray:
    """Orthonormal basis, shape (6, 6 - k), of the orthogonal complement of `basis` (6, k)."""
    u, _, _ = np.linalg.svd(basis, full_matrices=True)
    return u[:, basis.shape[1] :]


def without_unobservable_motion(
    transform: np.ndarray, free: np.ndarray, scale: TwistScale
) -> np.ndarray:
    """Of all transforms that fit equally well, the one with least rotation, then least shift."""
    rotations, shifts = _rotations_and_shifts(free, scale)
    for _ in range(20):
        rotation = Rotation.from_matrix(transform[:3, :3]).as_rotvec()
        back = rotations @ (rotations[:3].T @ rotation)
        transform = orthonormal(exp_twist(-back, scale.centre_m) @ transform)
    shift_m = scale.centre_m - moved_back(transform, scale.centre_m)
    transform = transform.copy()
    transform[:3, 3] -= shifts @ (shifts.T @ shift_m)
    return transform


def direction_names(free: np.ndarray, scale: TwistScale) -> tuple[str, ...]:
    """A name for each unobservable direction, along the coordinate axes as far as possible."""
    rotations, shifts = _rotations_and_shifts(free, scale)
    names = [f"the shift along {_axis_text(axis)}" for axis in _axis_aligned(shifts).T]
    for axis in _axis_aligned(rotations[:3]).T:
        velocity_m = rotations[3:] @ (rotations[:3].T @ axis)
        at_m = scale.centre_m + np.cross(axis, velocity_m)
        place = ", ".join(f"{1e3 * v:.0f}" for v in at_m)
        names.append(f"the rotation about {_axis_text(axis)} through ({place}) mm")
    return tuple(names)


def _rotations_and_shifts(free: np.ndarray, scale: TwistScale) -> tuple[np.ndarray, np.ndarray]:
    """Split unobservable directions into rotations, twists (6, r), and pure shifts, (3, q).

    The twists are in radians and metres, their rotation vectors orthonormal. A direction whose
    rotation moves points at the radius by less than a tenth of its shift counts as a shift.
    """
    _, amount, rows = np.linalg.svd(free[:3])
    amount = np.pad(amount, (0, len(rows) - len(amount)))
    rotating = amount >= 0.1
    rotations = (free @ rows[rotating].T) / scale.unit[:, None]
    rotations = rotations / np.linalg.norm(rotations[:3], axis=0)
    shifts = (free @ rows[~rotating].T)[3:]
    return rotations, shifts / np.linalg.norm(shifts, axis=0)


def _axis_aligned(basis: np.ndarray) -> np.ndarray:
    """Another orthonormal basis of the span of `basis`, (3, k), near x, y and z."""
    left = basis @ basis.T
    axes = []
    for _ in range(basis.shape[1]):
        # Rounded, so that ties are resolved in the order x, y, z on every machine.
        pick = int(np.argmax(np.round(np.diag(left), 6)))
        axis = left[:, pick] / np.linalg.norm(left[:, pick])
        axes.append(axis)
        left = left - np.outer(axis, axis)
    return np.array(axes).T.reshape(3, -1)


def _axis_text(axis: np.ndarray) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if abs(axis @ unit) > 0.999:
            return name
    return "(" + ", ".join(f"{v:.2f}" for v in axis) + ")"
