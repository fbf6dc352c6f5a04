"""Degrees of freedom that a surface cannot tell: find them, take their motion back, name them.

A direction is a twist about the centre of an object, scaled by its `unit` so that all six numbers
are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.registration.rigid_motion import exp_twist, orthonormal

OBSERVABLE = 5e-3
"""Smallest eigenvalue of the scaled normal matrix that counts as seen: see docs/calibration.md."""


class Object(Protocol):
    """What twists are about: a `Surface`, or a `Lever`."""

    @property
    def centre_m(self) -> np.ndarray: ...

    @property
    def unit(self) -> np.ndarray: ...


@dataclass(frozen=True, slots=True, eq=False)
class Lever:
    """A centre, shape (3,), metres, and how far from it the object's points are, metres."""

    centre_m: np.ndarray
    radius_m: float

    @property
    def unit(self) -> np.ndarray:
        """What to multiply a twist with for one whose six numbers are all metres, shape (6,)."""
        return np.repeat([self.radius_m, 1.0], 3)


def unobservable(information: np.ndarray) -> np.ndarray:
    """Return the scaled twists that move too little of the surface along its normal, (6, k)."""
    values, vectors = np.linalg.eigh(information)
    return vectors[:, values < OBSERVABLE]


def complement(basis: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis, shape (6, 6 - k), of what is orthogonal to `basis` (6, k)."""
    u, _, _ = np.linalg.svd(basis, full_matrices=True)
    return u[:, basis.shape[1] :]


def _turns_and_shifts(free: np.ndarray, surface: Object) -> tuple[np.ndarray, np.ndarray]:
    """Split the free directions into twists that turn, (6, r), and pure shifts, (3, q).

    The twists are in radians and metres, their rotation vectors orthonormal. A direction that turns
    by less than a tenth of what it shifts at the object's radius is taken for a shift.
    """
    _, amount, rows = np.linalg.svd(free[:3])
    amount = np.pad(amount, (0, len(rows) - len(amount)))
    turning = amount >= 0.1
    turns = (free @ rows[turning].T) / surface.unit[:, None]
    turns = turns / np.linalg.norm(turns[:3], axis=0)
    shifts = (free @ rows[~turning].T)[3:]
    return turns, shifts / np.linalg.norm(shifts, axis=0)


def without_free_motion(transform: np.ndarray, free: np.ndarray, surface: Object) -> np.ndarray:
    """Return, of all transforms that fit as well, the one that turns, then shifts, least."""
    turns, shifts = _turns_and_shifts(free, surface)
    for _ in range(20):
        turned = Rotation.from_matrix(transform[:3, :3]).as_rotvec()
        back = turns @ (turns[:3].T @ turned)
        transform = orthonormal(exp_twist(-back, surface.centre_m) @ transform)
    shift_m = surface.centre_m - came_from(transform, surface.centre_m)
    transform = transform.copy()
    transform[:3, 3] -= shifts @ (shifts.T @ shift_m)
    return transform


def named(free: np.ndarray, surface: Object) -> tuple[str, ...]:
    """Return a name for each free direction, along the coordinate axes as far as they allow."""
    turns, shifts = _turns_and_shifts(free, surface)
    names = [f"the shift along {_axis_text(axis)}" for axis in _upright(shifts).T]
    for axis in _upright(turns[:3]).T:
        velocity_m = turns[3:] @ (turns[:3].T @ axis)
        at_m = surface.centre_m + np.cross(axis, velocity_m)
        place = ", ".join(f"{1e3 * v:.0f}" for v in at_m)
        names.append(f"the rotation about {_axis_text(axis)} through ({place}) mm")
    return tuple(names)


def _upright(basis: np.ndarray) -> np.ndarray:
    """Return another orthonormal basis of the span of `basis`, (3, k), near x, y and z."""
    left = basis @ basis.T
    axes = []
    for _ in range(basis.shape[1]):
        # Rounded, so that ties go to x before y before z whatever the last bit says.
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


def came_from(transform: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    return transform[:3, :3].T @ (point_m - transform[:3, 3])
