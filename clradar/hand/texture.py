"""Coordinates of skin that stay with it when the hand is posed: those of the hand held flat.

Inverse linear blend skinning (Magnenat-Thalmann, Laperriere and Thalmann, "Joint-dependent local
deformations for hand animation and object grasping", Graphics Interface 1988): every bone takes a
point of the skin to where that bone alone would have it in a flat hand, and near a joint, where
the point belongs to several bones, it goes to the weighted mean. A hard choice of one bone would
tear the coordinates apart across a triangle.
"""

from __future__ import annotations

import numpy as np

from clradar.hand.joints import FINGERS, JOINT_INDEX
from clradar.hand.skeleton import MILLIMETRE_M, Skeleton

BLEND_M = 6e-3
"""Skin belongs to the bones beside the nearest whose flesh is less than this farther away."""

BACKWARDS_M = 8e-3
"""What counts as distance, too, where the normal is across the direction away from a bone, twice
that where it points to it: skin that touches the skin of another bone stays with its own."""

# About the mean distance of the skin from the bone that begins at each joint, millimetres.
_RADII_MM = {
    "wrist": 17.0,
    "thumb-metacarpal": 12.0,
    "thumb-phalanx-proximal": 10.7,
    "thumb-phalanx-distal": 9.0,
    **{f"{finger}-finger-metacarpal": 12.0 for finger in FINGERS},
    **{f"{finger}-finger-phalanx-proximal": 9.8 for finger in FINGERS},
    **{f"{finger}-finger-phalanx-intermediate": 9.0 for finger in FINGERS},
    **{f"{finger}-finger-phalanx-distal": 7.6 for finger in FINGERS},
}
_BONES = tuple(_RADII_MM)

SKIN_BONES: tuple[int, ...] = tuple(JOINT_INDEX[bone] for bone in _BONES)
"""The joints where the bones begin that carry skin: the columns of `skin_weights`."""


def skin_weights(vertices_m: np.ndarray, normals: np.ndarray, posed: Skeleton) -> np.ndarray:
    """Return by how much every bone moves points of the skin of a posed hand, (V, len(SKIN_BONES)).

    Rows sum to 1. The weights of the bones beside the nearest fall to zero as (1 - d / c)^2, where
    d is how much farther their flesh is than that of the nearest, c = `BLEND_M`.
    """
    distance_m = np.stack([_distance_m(vertices_m, normals, posed, b) for b in _BONES], axis=1)
    nearest = distance_m.argmin(axis=1)
    distance_m -= distance_m.min(axis=1, keepdims=True)
    weight: np.ndarray = np.maximum(0.0, 1.0 - distance_m / BLEND_M) ** 2 * _BESIDE[nearest]
    weight /= weight.sum(axis=1, keepdims=True)
    return weight


def texture_coordinates_m(
    vertices_m: np.ndarray, normals: np.ndarray, posed: Skeleton, flat: Skeleton
) -> np.ndarray:
    """Return where points (V, 3) of the skin of a posed hand are in a flat hand of the same bones,
    metres.

    q = sum_b w_b (G_b F_b^T (v - p_b) + o_b), where F and p are the axes and the beginning of a
    bone in the pose, G and o in the flat hand, and w are the `skin_weights`.
    """
    weight = skin_weights(vertices_m, normals, posed)
    texture_m = np.zeros(vertices_m.shape)
    for bone, share in zip(_BONES, weight.T, strict=True):
        at = JOINT_INDEX[bone]
        turn = flat.frames[at] @ posed.frames[at].T
        own_m = np.einsum("ij,vj->vi", turn, vertices_m - posed.joints_m[at])
        texture_m += share[:, None] * (own_m + flat.joints_m[at])
    return texture_m


def _distance_m(
    vertices_m: np.ndarray, normals: np.ndarray, bones: Skeleton, bone: str
) -> np.ndarray:
    """Return the distances (V,) of points from the flesh around a bone, metres."""
    at = JOINT_INDEX[bone]
    begin_m = bones.joints_m[at]
    end_m = bones.joint_m("middle-finger-metacarpal") if bone == "wrist" else bones.joints_m[at + 1]
    axis_m, from_begin_m = end_m - begin_m, vertices_m - begin_m
    share = np.clip(np.einsum("vi,i->v", from_begin_m, axis_m) / (axis_m @ axis_m), 0.0, 1.0)
    away_m = from_begin_m - share[:, None] * axis_m
    length_m = np.linalg.norm(away_m, axis=1)
    outward = np.einsum("vi,vi->v", away_m, normals) / np.maximum(length_m, 1e-12)
    radius_m = _RADII_MM[bone] * bones.thickness * MILLIMETRE_M
    return length_m - radius_m + BACKWARDS_M * (1.0 - outward)


def _are_beside(one: str, other: str) -> bool:
    """Return whether the same skin may belong to both bones: not skin that only touches."""
    palm, roots = ("wrist", "metacarpal"), ("metacarpal", "proximal")
    if one.endswith(palm) and other.endswith(palm):
        return True
    digits = [bone.split("-")[0] for bone in (one, other)]
    if digits[0] == digits[1]:
        return abs(JOINT_INDEX[one] - JOINT_INDEX[other]) <= 1
    if not one.endswith(roots) or not other.endswith(roots) or "thumb" in digits:
        return False
    # The webs between the fingers.
    return abs(FINGERS.index(digits[0]) - FINGERS.index(digits[1])) == 1


_BESIDE = np.array([[_are_beside(one, other) for other in _BONES] for one in _BONES])
