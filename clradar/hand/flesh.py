"""The hand's flesh: rounded cones along the bones, blended where skin is continuous.

Radii follow published breadths: index and middle finger 20 mm wide at the middle joint and 17.5 mm
at the last joint, the others less, thumb about 21 mm at its joint (between the means of men and
women of Garrett, "The adult human hand: some anthropometric and biomechanical considerations",
Human Factors 13(2), 1971, and of Greiner, NATICK TR-92/011, 1991), hand 84 to 86 mm wide at the
knuckles and about 29 mm thick there, wrist about 61 by 40 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clradar.hand.cones import Cone, Slope, smooth_minimum, smooth_slope
from clradar.hand.joints import FINGERS
from clradar.hand.skeleton import (
    FINGER_TIP_TISSUE_MM,
    MILLIMETRE_M,
    PHALANGES_MM,
    THUMB_MM,
    Skeleton,
)

PART_NAMES: tuple[str, ...] = ("palm", "thumb", *FINGERS)

# Blend radii: wide where the palm's muscles and the fingers' roots run into each other, small along
# a finger, and nearly none where skin only touches skin, so that fingers never fuse.
_PALM_BLEND_M = 9e-3
_ROOT_BLEND_M = 6e-3
_DIGIT_BLEND_M = 2.5e-3
_CONTACT_BLEND_M = 1e-3
_CUT_BLEND_M = 2e-3

# Two cones that share a sphere are equally far from its surroundings, so their smooth union is a
# quarter of the blend radius thicker there. Digits are made that much thinner at their joints.
_JOINT_EXCESS_MM = 0.25 * _DIGIT_BLEND_M / MILLIMETRE_M

# The forearm ends in a plane this far below the wrist crease.
_STUB_M = 9e-3

# Farther than any point of a hand from any other: where no cone of a union is near.
_FAR_M = 10.0

# Points evaluated at a time: the working arrays of a chunk fit into a second-level cache.
_CHUNK = 16384

# Radii in millimetres: root, middle joint, last joint, tip.
_FINGER_RADII_MM: dict[str, tuple[float, float, float, float]] = {
    "index": (10.0, 9.9, 8.7, 6.7),
    "middle": (10.2, 10.0, 8.9, 6.8),
    "ring": (9.6, 9.4, 8.4, 6.4),
    "pinky": (8.6, 8.4, 7.5, 5.8),
}
# Root, last joint, pad, tip.
_THUMB_RADII_MM = (11.0, 10.5, 9.7, 7.3)

_THUMB_TIP_TISSUE_MM = 5.7


@dataclass(frozen=True, slots=True, eq=False)
class Flesh:
    """The solid of a posed right hand in the frame of its skeleton.

    Parameters
    ----------
    forearm : ndarray, shape (3,)
        Unit vector along the forearm, from the elbow to the wrist, which is the origin.
    palm : tuple of Cone
        Forearm stub, wrist, palm with the muscles of the thumb and the little finger, and webs.
    roots, ends : tuple of tuple of Cone
        For the thumb and each finger: the cones that grow out of the palm, and those beyond.
    """

    forearm: np.ndarray
    palm: tuple[Cone, ...]
    roots: tuple[tuple[Cone, ...], ...]
    ends: tuple[tuple[Cone, ...], ...]

    def distance_m(self, points_m: np.ndarray, near: Neighbourhoods | None = None) -> np.ndarray:
        """Return the signed distance (N,) of points (N, 3), float64, negative inside, metres.

        Never larger in magnitude than the distance to the surface. With `near`, the cones that do
        not matter are left out, which is faster.
        """
        return _in_chunks(lambda some_m: self._slope(_Field(some_m, near))[0], points_m)

    def slope(self, points_m: np.ndarray, near: Neighbourhoods | None = None) -> Slope:
        """Return the signed distances of points (N, 3) and their gradients (N, 3)."""
        columns = _in_chunks(
            lambda some_m: np.column_stack(self._slope(_Field(some_m, near, sloped=True))), points_m
        )
        return columns[:, 0], columns[:, 1:]

    def normals(self, points_m: np.ndarray) -> np.ndarray:
        """Return the outward unit normals (N, 3) at points (N, 3) near the surface."""
        return unit_vectors(self.slope(points_m)[1])

    def nearest_part(self, points_m: np.ndarray, near: Neighbourhoods | None = None) -> np.ndarray:
        """Return for points (N, 3) the index (N,), int32, into `PART_NAMES` of the nearest part."""
        return _in_chunks(lambda some_m: self._nearest_part(_Field(some_m, near)), points_m)

    def bounds_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner (3,) of a box around the flesh, metres."""
        corners = [cone.reach_m() for cone in self.cones()]
        low_m = np.min([low for low, _ in corners], axis=0)
        high_m = np.max([high for _, high in corners], axis=0)
        # Blending adds a little outside the cones themselves; several blends may add up.
        low_m, high_m = low_m - _PALM_BLEND_M, high_m + _PALM_BLEND_M
        if self.forearm[1] == 1.0:
            low_m[1] = max(low_m[1], -_STUB_M - _CUT_BLEND_M)
        return low_m, high_m

    def cones(self) -> tuple[Cone, ...]:
        """Return all cones: the palm's, then each digit's roots and ends."""
        digits = zip(self.roots, self.ends, strict=True)
        return (*self.palm, *(cone for root, end in digits for cone in (*root, *end)))

    def _slope(self, field: _Field) -> Slope:
        palm = field.union(self.palm, 0, _PALM_BLEND_M)
        whole = palm
        at = len(self.palm)
        for roots, ends in zip(self.roots, self.ends, strict=True):
            root = field.union(roots, at, _DIGIT_BLEND_M)
            end = field.union(ends, at + len(roots), _DIGIT_BLEND_M)
            at += len(roots) + len(ends)
            digit = field.blended(root, end, _DIGIT_BLEND_M)
            # Only the root blends widely with the palm: a bent finger's tip may touch the palm, and
            # then has to stay a finger. The plain minimum leaves no crease, because both terms are
            # the root itself wherever they change over.
            grown = field.lower(field.blended(palm, root, _ROOT_BLEND_M), digit)
            # All of these hold the palm, so that the blend thickens it, evenly, by 0.6 mm.
            whole = field.blended(whole, grown, _CONTACT_BLEND_M)
        below_m = -_STUB_M - np.einsum("ij,j->i", field.points_m, self.forearm)
        below = below_m, np.broadcast_to(-self.forearm, field.points_m.shape)
        inverse = field.blended(_opposite(whole), _opposite(below), _CUT_BLEND_M)
        return _opposite(inverse)

    def _nearest_part(self, field: _Field) -> np.ndarray:
        parts_m = [field.union(self.palm, 0, _PALM_BLEND_M)[0]]
        at = len(self.palm)
        for root, end in zip(self.roots, self.ends, strict=True):
            parts_m.append(field.union(root + end, at, _DIGIT_BLEND_M)[0])
            at += len(root) + len(end)
        return np.argmin(parts_m, axis=0).astype(np.int32)


class _Field:
    """Unions of cones at points: distances, and gradients where they are asked for.

    Parameters
    ----------
    points_m : ndarray, shape (N, 3), metres
    near : Neighbourhoods or None
        Which cones matter where; None asks all of them.
    sloped : bool
        Whether gradients are wanted; they are empty otherwise.
    """

    def __init__(
        self, points_m: np.ndarray, near: Neighbourhoods | None, *, sloped: bool = False
    ) -> None:
        self.points_m = points_m
        self._near, self._sloped = near, sloped
        self._cells = None if near is None else near.cells_of(points_m)

    def union(self, cones: tuple[Cone, ...], first: int, blend_m: float) -> Slope:
        """Return cones blended in their order; `first` is the place of the first in the flesh."""
        distance_m = np.full(len(self.points_m), _FAR_M)
        gradient = np.zeros((len(self.points_m), 3 if self._sloped else 0))
        for i, cone in enumerate(cones):
            at: np.ndarray | slice = slice(None)
            if self._near is not None and self._cells is not None:
                at = np.flatnonzero(self._near.matters[first + i][self._cells])
                if len(at) == 0:
                    continue
            here_m = self.points_m[at]
            one = distance_m[at], gradient[at]
            other = cone.slope(here_m) if self._sloped else (cone.distance_m(here_m), one[1])
            distance_m[at], gradient[at] = self.blended(one, other, blend_m)
        return distance_m, gradient

    def blended(self, a: Slope, b: Slope, blend_m: float) -> Slope:
        if self._sloped:
            return smooth_slope(a, b, blend_m)
        return smooth_minimum(a[0], b[0], blend_m), a[1]

    def lower(self, a: Slope, b: Slope) -> Slope:
        if self._sloped:
            return np.minimum(a[0], b[0]), np.where((a[0] <= b[0])[:, None], a[1], b[1])
        return np.minimum(a[0], b[0]), a[1]


def _opposite(slope: Slope) -> Slope:
    return -slope[0], -slope[1]


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (N, 3) scaled to length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhoods:
    """Which cones have a part in the distance, for each cell of a grid.

    Parameters
    ----------
    low_m : ndarray, shape (3,), metres
        Lowest corner of the grid.
    cell_m : float, metres
        Edge of a cell.
    shape : tuple of 3 ints
    matters : ndarray, shape (cones, cells), bool
    """

    low_m: np.ndarray
    cell_m: float
    shape: tuple[int, int, int]
    matters: np.ndarray

    def cells_of(self, points_m: np.ndarray) -> np.ndarray:
        """Return the index (N,) of the cell that each point (N, 3) is in."""
        cells = ((points_m - self.low_m) / self.cell_m).astype(np.int64)
        return np.ravel_multi_index(tuple(cells.T), self.shape, mode="clip")


def neighbourhoods(
    flesh: Flesh, low_m: np.ndarray, cell_m: float, shape: tuple[int, int, int]
) -> Neighbourhoods:
    """Return which cones matter in the cells of a grid.

    A blend of radius k changes nothing where the two distances differ by k or more, and lowers a
    union by at most k in all. So a union is not seen where it is farther than the nearest cone of
    all by its own k and by what the blends behind it reach. Within a union a cone that is 3 k
    farther than the nearest can be seen only through a chain of cones in between, each of which
    weakens it: measured, by less than 0.1 um.
    """
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    middle_m = low_m + (cells.reshape(-1, 3) + 0.5) * cell_m
    distance_m = np.stack([cone.distance_m(middle_m) for cone in flesh.cones()])
    nearest_m = distance_m.min(axis=0)
    # Both distances of a comparison may be off by half the diagonal of a cell.
    slack_m = np.sqrt(3.0) * cell_m
    matters = np.zeros(distance_m.shape, dtype=bool)
    at = 0
    after_digit_m = _DIGIT_BLEND_M + 2.0 * _CONTACT_BLEND_M
    after_root_m = 1.5 * _ROOT_BLEND_M + after_digit_m
    unions = [(len(flesh.palm), _PALM_BLEND_M, after_root_m)]
    for root, end in zip(flesh.roots, flesh.ends, strict=True):
        unions.append((len(root), _DIGIT_BLEND_M, after_root_m))
        unions.append((len(end), _DIGIT_BLEND_M, after_digit_m))
    for count, blend_m, reach_m in unions:
        own_m = distance_m[at : at + count]
        union_m = own_m.min(axis=0)
        seen = union_m < nearest_m + (blend_m + reach_m + slack_m)
        matters[at : at + count] = seen & (own_m < union_m + (3.0 * blend_m + slack_m))
        at += count
    return Neighbourhoods(low_m, cell_m, shape, matters)


def _in_chunks(function: Callable[[np.ndarray], np.ndarray], points_m: np.ndarray) -> np.ndarray:
    if len(points_m) == 0:
        return function(np.zeros((1, 3)))[:0]
    pieces = [function(points_m[i : i + _CHUNK]) for i in range(0, len(points_m), _CHUNK)]
    return np.concatenate(pieces)


def _cone(begin_m: np.ndarray, end_m: np.ndarray, begin_mm: float, end_mm: float) -> Cone:
    return Cone(begin_m, end_m, begin_mm * MILLIMETRE_M, end_mm * MILLIMETRE_M)


def _strand(points_m: list[np.ndarray], radii_mm: list[float]) -> tuple[Cone, ...]:
    """Return the cones between successive points; blended, they have these radii there."""
    radii_mm = [radii_mm[0], *(r - _JOINT_EXCESS_MM for r in radii_mm[1:-1]), radii_mm[-1]]
    return tuple(
        _cone(points_m[i], points_m[i + 1], radii_mm[i], radii_mm[i + 1])
        for i in range(len(points_m) - 1)
    )


def _tip_at(bones: Skeleton, end: str, tip: str, tissue: float, radius_mm: float) -> float:
    """Return where along the last bone the tip's sphere is, as a fraction of the bone's length.

    `tissue` is the thickness of the soft tissue beyond the bone, in lengths of the bone.
    """
    length_mm = float(np.linalg.norm(bones.joint_m(tip) - bones.joint_m(end))) / MILLIMETRE_M
    return 1.0 + tissue - radius_mm / length_mm


def _finger(bones: Skeleton, finger: str) -> tuple[tuple[Cone, ...], tuple[Cone, ...]]:
    k = bones.thickness
    root, middle, last, tip = (k * radius_mm for radius_mm in _FINGER_RADII_MM[finger])
    near, far, end = (
        f"{finger}-finger-phalanx-{b}" for b in ("proximal", "intermediate", "distal")
    )
    tissue = FINGER_TIP_TISSUE_MM / PHALANGES_MM[finger][-1]
    tip_at = _tip_at(bones, end, f"{finger}-finger-tip", tissue, tip)
    strand = _strand(
        [
            bones.joint_m(near),
            bones.joint_m(far),
            bones.joint_m(end),
            bones.point_m(end, tip_at, dorsal_mm=-0.6),
        ],
        [root, middle, last, tip],
    )
    # Fat pads on the palm side between the joints' creases, and the finger's pad.
    near_pad = _cone(
        bones.point_m(near, 0.40, dorsal_mm=-2.6),
        bones.point_m(near, 0.78, dorsal_mm=-2.2),
        middle - 2.0 * k,
        middle - 2.1 * k,
    )
    far_pad = _cone(
        bones.point_m(far, 0.30, dorsal_mm=-2.2),
        bones.point_m(far, 0.70, dorsal_mm=-1.9),
        last - 1.0 * k,
        last - 1.3 * k,
    )
    end_pad = _cone(
        bones.point_m(end, 0.35, dorsal_mm=-1.9),
        bones.point_m(end, 0.75, dorsal_mm=-1.7),
        last - 1.9 * k,
        last - 2.1 * k,
    )
    return (strand[0], near_pad), (*strand[1:], far_pad, end_pad)


def _thumb(bones: Skeleton) -> tuple[tuple[Cone, ...], tuple[Cone, ...]]:
    k = bones.thickness
    root, last, pad, tip = (k * radius_mm for radius_mm in _THUMB_RADII_MM)
    near, end = "thumb-phalanx-proximal", "thumb-phalanx-distal"
    tip_at = _tip_at(bones, end, "thumb-tip", _THUMB_TIP_TISSUE_MM / THUMB_MM[-1], tip)
    roots = _strand(
        [bones.point_m("thumb-metacarpal", 0.7), bones.point_m(near, 0.1), bones.joint_m(end)],
        [root - 0.8 * k, root, last - _JOINT_EXCESS_MM],
    )
    # The thumb's last phalanx is wider than deep: two strands side by side.
    ends: list[Cone] = []
    for side_mm in (-1.3, 1.3):
        ends += _strand(
            [
                bones.point_m(end, 0.0, side_mm=0.5 * side_mm),
                bones.point_m(end, 0.5, side_mm=side_mm, dorsal_mm=-1.2),
                bones.point_m(end, tip_at, side_mm=side_mm, dorsal_mm=-0.6),
            ],
            [last - 1.7 * k, pad - 0.5 * k, tip],
        )
    return roots, tuple(ends)


def _palm(bones: Skeleton) -> tuple[Cone, ...]:
    at = bones.point_m
    index, middle, ring, pinky = (f"{finger}-finger-metacarpal" for finger in FINGERS)
    knuckles = [f"{finger}-finger-phalanx-proximal" for finger in FINGERS]
    thumb = "thumb-metacarpal"
    k = bones.thickness

    def by_wrist(x_mm: float, y_mm: float, z_mm: float) -> np.ndarray:
        return bones.frames[0] @ np.array([x_mm, y_mm, z_mm]) * (k * MILLIMETRE_M)

    def around(begin_m: np.ndarray, end_m: np.ndarray, begin_mm: float, end_mm: float) -> Cone:
        return Cone(begin_m, end_m, begin_mm * (k * MILLIMETRE_M), end_mm * (k * MILLIMETRE_M))

    cones = [
        # Forearm stub: radius and ulna, the tendons between them on the palm side.
        around(by_wrist(-13.0, -30.0, 0.0), by_wrist(-13.0, 6.0, 0.0), 17.5, 16.5),
        around(by_wrist(12.5, -30.0, 0.5), by_wrist(12.0, 6.0, 0.5), 16.5, 15.5),
        around(by_wrist(0.0, -30.0, -3.0), by_wrist(0.0, 8.0, -2.0), 17.0, 16.0),
        # Carpus.
        around(by_wrist(-12.0, 4.0, 0.0), at(index, 0.15), 15.5, 12.5),
        around(by_wrist(0.0, 4.0, 0.0), at(middle, 0.15), 15.5, 12.5),
        around(by_wrist(12.0, 4.0, 0.0), at(pinky, 0.15), 14.5, 12.0),
    ]
    # The four rays; the flesh lies deeper on the palm side than on the back.
    for name, base_mm, head_mm in (
        (index, 11.8, 11.4),
        (middle, 12.0, 11.8),
        (ring, 11.6, 11.4),
        (pinky, 11.0, 10.2),
    ):
        cones.append(around(at(name, 0.1), at(name, 0.97, dorsal_mm=-1.0), base_mm, head_mm))
    # Knuckles: they belong to the metacarpals, and stay when the fingers bend.
    rays = (index, middle, ring, pinky)
    for name, radius_mm in zip(rays, (7.4, 7.8, 7.2, 6.4), strict=True):
        cones.append(
            around(at(name, 0.78, 0.0, 2.6), at(name, 1.0, 0.0, 2.6), radius_mm - 1.0, radius_mm)
        )
    # Pads below the fingers and webs between them: the skin of the palm reaches about 20 mm beyond
    # the knuckles' centres.
    for i, radius_mm in enumerate((7.6, 7.4, 6.8)):
        one, other = knuckles[i], knuckles[i + 1]
        low_m = 0.5 * (at(rays[i], 0.94, dorsal_mm=-2.0) + at(rays[i + 1], 0.94, dorsal_mm=-2.0))
        high_m = 0.5 * (at(one, 0.30, dorsal_mm=-2.5) + at(other, 0.33, dorsal_mm=-2.5))
        cones.append(around(low_m, high_m, radius_mm + 2.0, radius_mm - 1.4))
    cones += [
        # Heel of the hand on the side of the little finger.
        around(at(pinky, -0.08, 0.0, -5.8), at(pinky, 0.7, 1.0, -2.2), 12.8, 11.4),
        # Ball of the thumb: around the metacarpal, and its short muscles on the palm side.
        around(at(thumb, 0.05), at(thumb, 0.66), 12.0, 10.4),
        around(at(thumb, 0.05, 4.0, -5.5), at(thumb, 0.65, 2.0, -5.5), 12.5, 10.5),
        around(by_wrist(-9.0, 16.0, -8.0), at(thumb, 0.6, 3.0, -4.0), 12.0, 11.0),
        # Web of the thumb: sheets from its metacarpal to that of the index finger.
        around(at(thumb, 0.35, 0.0, -3.0), at(index, 0.35, 0.0, -3.0), 10.5, 10.0),
        around(at(thumb, 0.6, 0.0, -3.0), at(index, 0.5, 0.0, -3.0), 8.5, 8.5),
        around(at(thumb, 0.85, 0.0, -3.0), at(index, 0.66, 0.0, -3.0), 6.5, 7.5),
    ]
    return tuple(cones)


def grown_flesh(bones: Skeleton) -> Flesh:
    """Return the flesh around a posed skeleton."""
    digits = [_thumb(bones), *(_finger(bones, finger) for finger in FINGERS)]
    return Flesh(
        forearm=bones.frames[0][:, 1],
        palm=_palm(bones),
        roots=tuple(root for root, _ in digits),
        ends=tuple(end for _, end in digits),
    )
