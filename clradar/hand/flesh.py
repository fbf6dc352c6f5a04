"""The hand's flesh as an implicit surface: round cones along the bones, united by smooth minima.

The smooth minimum is the quadratic polynomial one of I. Quilez ("Smooth minimum",
iquilezles.org/articles/smin): it differs from the minimum where two distances differ by less than a
blend radius, and by at most a quarter of it.

Radii follow published breadths: index and middle finger 20 mm wide at the middle joint and 17.5 mm
at the last joint, the others less, thumb about 21 mm at its joint (between the means of men and
women of Garrett, "The adult human hand: some anthropometric and biomechanical considerations",
Human Factors 13(2), 1971, and of Greiner, NATICK TR-92/011, 1991), hand 84 to 86 mm wide at the
knuckles and about 29 mm thick there, wrist about 61 by 40 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from clradar.hand.joints import CHAINS, FINGERS
from clradar.hand.skeleton import (
    FINGER_TIP_TISSUE_MM,
    MILLIMETRE_M,
    PHALANGES_MM,
    THUMB_MM,
    Skeleton,
)
from clradar.opencl import Buffers, build

PART_NAMES: tuple[str, ...] = ("palm", "thumb", *FINGERS)

# Blend radii: wide where the palm's muscles and the fingers' roots merge, small along a finger, and
# nearly none where skin only touches skin, so that fingers never fuse.
PALM_BLEND_M = 9e-3
ROOT_BLEND_M = 6e-3
DIGIT_BLEND_M = 2.5e-3
CONTACT_BLEND_M = 1e-3
CUT_BLEND_M = 2e-3

# Two cones that share a sphere have equal distances around it, so their smooth union is a quarter
# of the blend radius thicker there. Digits are made that much thinner at their joints.
_JOINT_EXCESS_MM = 0.25 * DIGIT_BLEND_M / MILLIMETRE_M

# The forearm ends in a plane this far below the wrist crease.
STUB_M = 9e-3

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

# Nodes along an edge of a cell. The distance at the middle of a cell tells whether the surface can
# cross it; only then are its nodes evaluated.
_NODES = 4

# Lanes of the widest item. Arrays are padded to it on every device.
_PADDED = 8


@dataclass(frozen=True, slots=True, eq=False)
class Flesh:
    """The solid of a posed right hand in the frame of its skeleton, whose origin is the wrist.

    A round cone is the convex hull of two spheres, neither of which may hold the other: their
    centres and radii, shape (2, 4), metres. `forearm` is the unit vector from the elbow to the
    wrist; `palm`, shape (n, 2, 4), has forearm stub, wrist, palm with the muscles of the thumb and
    the little finger, and webs; `roots` and `ends`, shape (5, n, 2, 4), have, for the thumb and
    each finger, the cones that grow out of the palm and those beyond. `FleshField` computes the
    signed distance: smooth unions of cones with the blend radii of this module, then of digits with
    the palm, minus what lies beyond the plane that ends the forearm.
    """

    forearm: np.ndarray
    palm: np.ndarray
    roots: np.ndarray
    ends: np.ndarray

    def bounds_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner (3,) of a box around the flesh, metres."""
        centre_m, radius_m = np.split(self.cones().reshape(-1, 4), [3], axis=1)
        # Blending adds a little outside the cones themselves; several blends may add up.
        low_m = (centre_m - radius_m).min(axis=0) - PALM_BLEND_M
        high_m = (centre_m + radius_m).max(axis=0) + PALM_BLEND_M
        if self.forearm[1] == 1.0:
            low_m[1] = max(low_m[1], -STUB_M - CUT_BLEND_M)
        return low_m, high_m

    def cones(self) -> np.ndarray:
        """Return all cones (n, 2, 4): the palm's, then each digit's roots and ends."""
        digits = np.concatenate([self.roots, self.ends], axis=1)
        return np.concatenate([self.palm, digits.reshape(-1, 2, 4)])


def _cone(
    begin_m: np.ndarray, end_m: np.ndarray, begin: float, end: float, unit_m: float = MILLIMETRE_M
) -> np.ndarray:
    return np.array([[*begin_m, begin * unit_m], [*end_m, end * unit_m]])


def _strand(points_m: list[np.ndarray], radii_mm: list[float]) -> np.ndarray:
    """Return the cones between successive points, with these radii there after blending."""
    radii = np.array(radii_mm)
    radii[1:-1] -= _JOINT_EXCESS_MM
    spheres = np.column_stack([points_m, radii * MILLIMETRE_M])
    return np.stack([spheres[:-1], spheres[1:]], axis=1)


def _tip_at(bones: Skeleton, tip: int, tissue: float, radius_mm: float) -> float:
    """Return where along the last bone the tip's sphere is; it and `tissue` in lengths of it."""
    length_m = float(np.linalg.norm(bones.joints_m[tip] - bones.joints_m[tip - 1]))
    return 1.0 + tissue - radius_mm / (length_m / MILLIMETRE_M)


def _finger(bones: Skeleton, digit: int) -> tuple[np.ndarray, np.ndarray]:
    k, finger = bones.thickness, PART_NAMES[digit]
    root, middle, last, tip = (k * radius_mm for radius_mm in _FINGER_RADII_MM[finger])
    _, near, far, end, end_tip = CHAINS[digit - 1]
    tip_at = _tip_at(bones, end_tip, FINGER_TIP_TISSUE_MM / PHALANGES_MM[finger][-1], tip)
    strand = _strand(
        [*bones.joints_m[[near, far, end]], bones.point_m(end, tip_at, dorsal_mm=-0.6)],
        [root, middle, last, tip],
    )

    # Fat pads on the palm side between the joints' creases, and the finger's pad: fraction of the
    # bone, offset towards its back and radius at each end.
    def pad(bone: int, *ends: tuple[float, float, float]) -> np.ndarray:
        begin_m, end_m = (bones.point_m(bone, along, dorsal_mm=mm) for along, mm, _ in ends)
        return _cone(begin_m, end_m, ends[0][2], ends[1][2])

    near_pad = pad(near, (0.40, -2.6, middle - 2.0 * k), (0.78, -2.2, middle - 2.1 * k))
    far_pad = pad(far, (0.30, -2.2, last - 1.0 * k), (0.70, -1.9, last - 1.3 * k))
    end_pad = pad(end, (0.35, -1.9, last - 1.9 * k), (0.75, -1.7, last - 2.1 * k))
    return np.stack([strand[0], near_pad]), np.stack([*strand[1:], far_pad, end_pad])


def _thumb(bones: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    k = bones.thickness
    root, last, pad, tip = (k * radius_mm for radius_mm in _THUMB_RADII_MM)
    metacarpal, near, end, end_tip = CHAINS[0]
    tip_at = _tip_at(bones, end_tip, _THUMB_TIP_TISSUE_MM / THUMB_MM[-1], tip)
    roots = _strand(
        [bones.point_m(metacarpal, 0.7), bones.point_m(near, 0.1), bones.joints_m[end]],
        [root - 0.8 * k, root, last - _JOINT_EXCESS_MM],
    )
    # The thumb's last phalanx is wider than deep: two strands side by side.
    ends = [
        _strand(
            [
                bones.point_m(end, 0.0, side_mm=0.5 * side_mm),
                bones.point_m(end, 0.5, side_mm=side_mm, dorsal_mm=-1.2),
                bones.point_m(end, tip_at, side_mm=side_mm, dorsal_mm=-0.6),
            ],
            [last - 1.7 * k, pad - 0.5 * k, tip],
        )
        for side_mm in (-1.3, 1.3)
    ]
    return roots, np.concatenate(ends)


def _palm(bones: Skeleton) -> np.ndarray:
    at = bones.point_m
    thumb, *rays = (chain[0] for chain in CHAINS)
    index, middle, ring, pinky = rays
    k = bones.thickness

    def by_wrist(x_mm: float, y_mm: float, z_mm: float) -> np.ndarray:
        return bones.frames[0] @ np.array([x_mm, y_mm, z_mm]) * (k * MILLIMETRE_M)

    around = partial(_cone, unit_m=k * MILLIMETRE_M)
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
    for name, radius_mm in zip(rays, (7.4, 7.8, 7.2, 6.4), strict=True):
        cones.append(
            around(at(name, 0.78, 0.0, 2.6), at(name, 1.0, 0.0, 2.6), radius_mm - 1.0, radius_mm)
        )
    # Pads below the fingers and webs between them: the skin of the palm reaches about 20 mm beyond
    # the knuckles' centres.
    for i, radius_mm in enumerate((7.6, 7.4, 6.8)):
        one, other = rays[i] + 1, rays[i + 1] + 1
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
    return np.stack(cones)


def grown_flesh(bones: Skeleton) -> Flesh:
    """Return the flesh around a posed skeleton."""
    digits = [_thumb(bones), *(_finger(bones, digit) for digit in range(2, len(PART_NAMES)))]
    roots, ends = (np.stack(cones) for cones in zip(*digits, strict=True))
    return Flesh(bones.frames[0][:, 1], _palm(bones), roots, ends)


@dataclass(frozen=True, slots=True)
class _FleshOptions:
    width: int
    palm: int
    root: int
    end: int
    nodes: int = _NODES
    palm_blend_m: float = PALM_BLEND_M
    root_blend_m: float = ROOT_BLEND_M
    digit_blend_m: float = DIGIT_BLEND_M
    contact_blend_m: float = CONTACT_BLEND_M
    cut_blend_m: float = CUT_BLEND_M


class FleshField:
    """The flesh of a posed hand on a device, with a grid of nodes around it.

    Coordinates are float32 about the middle of the hand's box on the device, so that distances are
    within 0.1 um. The nodes lie half a spacing inside cells of 4 x 4 x 4; each cell has a bit mask
    of the cones that matter in it. `first_m` is the first node, a spacing below the box of the
    flesh; the last one is not below its top.
    """

    def __init__(self, flesh: Flesh, spacing_m: float, buffers: Buffers) -> None:
        low_m, high_m = flesh.bounds_m()
        self.first_m = low_m - spacing_m
        self._cells = tuple(
            int(n) for n in np.ceil((high_m + spacing_m - self.first_m) / (_NODES * spacing_m))
        )
        n_x, n_y, n_z = self._cells
        n_z_padded = n_z + -n_z % _PADDED
        self._shape = [np.uint32(n) for n in (*self._cells, n_z_padded)]
        self._middle_m = 0.5 * (low_m + high_m)
        self._buffers, self._device = buffers, buffers.device
        options = _FleshOptions(
            self._device.width, len(flesh.palm), len(flesh.roots[0]), len(flesh.ends[0])
        )
        self._program = build(self._device, "flesh.cl", options)
        corner_m = self.first_m - 0.5 * spacing_m - self._middle_m
        above_cut_m = self._middle_m @ flesh.forearm + STUB_M
        frame = np.array([*corner_m, spacing_m, *flesh.forearm, above_cut_m])
        self._put = [
            buffers.upload(numbers.astype(np.float32))
            for numbers in (frame, _records(flesh, self._middle_m))
        ]
        self._near = [buffers.empty(4 * n_x * n_y * n_z_padded) for _ in range(2)]
        self._distance = buffers.empty(4 * n_x * n_y * n_z_padded)
        self._program.launch(
            "flesh_cells",
            (n_z_padded // self._device.width, n_y, n_x),
            self._shape[0], self._shape[1], self._shape[3],
            *self._put, *self._near, self._distance,
        )  # fmt: skip

    def node_distances_m(self) -> np.ndarray:
        """Return signed distances at all nodes, shape (n_x, n_y, n_z), float32, metres.

        Nodes of cells without surface have the distance of the cell's middle: right in sign only.
        """
        n_x, n_y, n_z = self._cells
        shape = (_NODES * n_x, _NODES * n_y, _NODES * n_z)
        buffer = self._buffers.empty(4 * math.prod(shape))
        self._program.launch(
            "flesh_nodes",
            (n_z * _NODES**3 // self._device.width, n_y, n_x),
            *self._shape, *self._put, *self._near, self._distance, buffer,
        )  # fmt: skip
        out = self._buffers.read(buffer, shape, np.float32)
        self._buffers.release(buffer)
        return out

    def distances_m(self, points_m: np.ndarray) -> np.ndarray:
        """Return the signed distances (N,) of points (N, 3), float32, negative inside, metres.

        A lower bound of the distance to the surface in magnitude, up to rounding.
        """
        return self._of_points("flesh_distances", points_m, 1)[0]

    def gradients(self, points_m: np.ndarray) -> np.ndarray:
        """Return the gradients (N, 3), float32, of the signed distances of points (N, 3)."""
        return self._of_points("flesh_gradients", points_m, 3).T

    def nearest_parts(self, points_m: np.ndarray) -> np.ndarray:
        """Return for points (N, 3) the index (N,), int32, into `PART_NAMES` of the nearest part."""
        return self._of_points("flesh_parts", points_m, 1, np.int32)[0]

    def _of_points(
        self, name: str, points_m: np.ndarray, n_rows: int, dtype: Any = np.float32
    ) -> np.ndarray:
        n = len(points_m)
        columns = np.zeros((3, n + -n % _PADDED), np.float32)
        columns[:, :n] = (points_m - self._middle_m).T
        n_padded = columns.shape[1]
        points, result = self._buffers.borrow(columns), self._buffers.empty(4 * n_rows * n_padded)
        self._program.launch(
            name, (n_padded // self._device.width,),
            np.uint32(n_padded), *self._shape, *self._put, *self._near, points, result,
        )  # fmt: skip
        out = self._buffers.read(result, (n_rows, n_padded), dtype)[:, :n]
        for buffer in (points, result):
            self._buffers.release(buffer)
        return out


def _records(flesh: Flesh, origin_m: np.ndarray) -> np.ndarray:
    """Return the cones as records of ten numbers (n, 10), see ``flesh.cl``."""
    (begin_m, radius_m), (end_m, end_radius_m) = (
        np.split(spheres, [3], axis=1) for spheres in flesh.cones().swapaxes(0, 1)
    )
    axis_m = end_m - begin_m
    length_m = np.linalg.norm(axis_m, axis=1, keepdims=True)
    sine = (radius_m - end_radius_m) / length_m
    tangent = sine / np.sqrt(1.0 - sine * sine)
    return np.hstack([begin_m - origin_m, axis_m / length_m, length_m, radius_m, sine, tangent])
