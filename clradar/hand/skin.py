"""Linear blend skinning: skin that several bones carry, in one pose or in many.

Magnenat-Thalmann, Laperriere and Thalmann, "Joint-dependent local deformations for hand animation
and object grasping", Graphics Interface 1988. Every bone takes a point of the skin along, and a
point that belongs to several goes to the weighted mean:

    x = sum_b w_b (M_b u_b + o_b)

with the place u_b of the point in the coordinates of the bone, the bone's matrix M and origin o.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clradar.hand.joints import CHAINS, FINGERS, JOINT_NAMES, WRIST
from clradar.hand.skeleton import MILLIMETRE_M, Skeleton
from clradar.model.record import Record

if TYPE_CHECKING:
    from scipy.sparse import csr_array

BLEND_M = 6e-3  # skin belongs to bones beside the nearest whose flesh is at most so much farther

BACKWARDS_M = 8e-3
"""What counts as distance, too, where the normal is across the direction away from a bone, twice
that where it points to it: skin that touches the skin of another bone stays with its own."""

# Joints at which the bones begin, and about the mean distance of the skin from them, millimetres.
_BONES = (WRIST, *CHAINS[0][:3], *(chain[i] for i in range(4) for chain in CHAINS[1:]))
_RADII_MM = (17.0, 12.0, 10.7, 9.0, *(mm for mm in (12.0, 9.8, 9.0, 7.6) for _ in FINGERS))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Skin(Record):
    """Points of the skin: one row per pair of point and bone, points ascending.

    `bone` is the index into `JOINT_NAMES` of the joint at which it begins; weights sum to 1 over a
    point; `own_m`, shape (n, 3), is the place of the point in the coordinates of the bone.
    """

    point: np.ndarray
    bone: np.ndarray
    weight: np.ndarray
    own_m: np.ndarray

    def __post_init__(self) -> None:
        point = self._set_array("point", np.int64, (None,))
        self._set_array("bone", np.int64, point.shape)
        self._set_array("weight", np.float64, point.shape)
        self._set_array("own_m", np.float64, (*point.shape, 3))

    @classmethod
    def on(cls, points_m: np.ndarray, weights: np.ndarray, bones: Skeleton) -> Skin:
        """Return the skin of points (n, 3) and weights (n, 25) in the pose of a skeleton."""
        point, bone = np.nonzero(weights)
        away_m = points_m[point] - bones.joints_m[bone]
        own_m = np.einsum("nji,nj->ni", bones.frames[bone], away_m)
        return cls(point, bone, weights[point, bone], own_m)

    def __len__(self) -> int:
        return int(self.point[-1]) + 1

    @property
    def weights(self) -> csr_array:
        """Weights, shape (n, 25)."""
        return by_bone(self.point, self.bone, self.weight[:, None])

    def of_points(self, chosen: np.ndarray) -> Skin:
        """Return the skin of some points alone, which ascend."""
        rows = np.isin(self.point, chosen)
        point = np.searchsorted(chosen, self.point[rows])
        return Skin(point, self.bone[rows], self.weight[rows], self.own_m[rows])

    def posed(self, matrices: np.ndarray, origins_m: np.ndarray) -> np.ndarray:
        """Return the points where bones take them, shape (..., n, 3), metres.

        Of one pose or many: `matrices`, shape (..., 25, 3, 3), and `origins_m`, (..., 25, 3). A
        bone that carries no skin may be NaN.
        """
        homogeneous = np.concatenate([self.own_m, np.ones((len(self.own_m), 1))], axis=1)
        own = by_bone(self.point, self.bone, self.weight[:, None] * homogeneous)
        maps = np.concatenate([np.swapaxes(matrices, -1, -2), origins_m[..., None, :]], axis=-2)
        used = np.isin(np.arange(len(JOINT_NAMES)), self.bone)
        maps = np.where(used[:, None, None], maps, 0.0).reshape(-1, own.shape[1], 3)
        placed = own @ maps.transpose(1, 0, 2).reshape(own.shape[1], -1)
        placed_m = placed.reshape(len(self), -1, 3).swapaxes(0, 1)
        return np.ascontiguousarray(placed_m).reshape(*matrices.shape[:-3], len(self), 3)


def by_bone(
    point: np.ndarray, bone: np.ndarray, values: np.ndarray, n: int | None = None
) -> csr_array:
    """Return rows of pairs of point and bone, k values each, as a matrix (n, 25 k), by bones."""
    from scipy.sparse import csr_array

    n, width = int(point[-1]) + 1 if n is None else n, values.shape[1]
    columns = width * bone[:, None] + np.arange(width)
    ends = width * np.searchsorted(point, np.arange(n + 1))
    shape = (n, len(JOINT_NAMES) * width)
    return csr_array((values.ravel(), columns.ravel(), ends), shape=shape)


def skin_weights(vertices_m: np.ndarray, normals: np.ndarray, posed: Skeleton) -> np.ndarray:
    """Return by how much every bone moves points of the skin of a posed hand, (V, 25).

    Rows sum to 1. The weights of the bones beside the nearest fall to zero as (1 - d / c)^2, where
    d is how much farther their flesh is than that of the nearest, c = `BLEND_M`. A hard choice of
    one bone would tear the skin apart across a triangle.
    """
    bones = zip(_BONES, _RADII_MM, strict=True)
    own_m = [_distance_m(vertices_m, normals, posed, *bone) for bone in bones]
    distance_m = np.stack(own_m, axis=1)
    nearest = distance_m.argmin(axis=1)
    distance_m -= distance_m.min(axis=1, keepdims=True)
    weight = np.maximum(0.0, 1.0 - distance_m / BLEND_M) ** 2 * _BESIDE[nearest]
    weight /= weight.sum(axis=1, keepdims=True)
    of_all = np.zeros((len(weight), len(JOINT_NAMES)))
    of_all[:, _BONES] = weight
    return of_all


def _distance_m(
    vertices_m: np.ndarray, normals: np.ndarray, bones: Skeleton, bone: int, radius_mm: float
) -> np.ndarray:
    """Return the distances (V,) of points from the flesh around a bone, metres."""
    begin_m, end_m = bones.joints_m[[bone, CHAINS[2][0] if bone == WRIST else bone + 1]]
    axis_m, from_begin_m = end_m - begin_m, vertices_m - begin_m
    share = np.clip(np.einsum("vi,i->v", from_begin_m, axis_m) / (axis_m @ axis_m), 0.0, 1.0)
    away_m = from_begin_m - share[:, None] * axis_m
    length_m = np.linalg.norm(away_m, axis=1)
    outward = np.einsum("vi,vi->v", away_m, normals) / np.maximum(length_m, 1e-12)
    radius_m = radius_mm * bones.thickness * MILLIMETRE_M
    return length_m - radius_m + BACKWARDS_M * (1.0 - outward)


def _are_beside(one: int, other: int) -> bool:
    """Return whether the same skin may belong to both bones: not skin that only touches."""
    palm = {WRIST, *(chain[0] for chain in CHAINS)}
    if palm >= {one, other}:
        return True
    for i, chain in enumerate(CHAINS):
        if one in chain and other in chain:
            return abs(one - other) <= 1
        # The webs between the fingers.
        if 0 < i < 4 and {*chain[:2], *CHAINS[i + 1][:2]} >= {one, other}:
            return True
    return False


_BESIDE = np.array([[_are_beside(one, other) for other in _BONES] for one in _BONES])
