"""Pieces of faces and their division into congruent triangles: the points of a quadrature.

A face is cut into k^2 congruent triangles, k so that they are at least as dense as asked for, and
each stands for its centroid: the midpoint rule, whose error falls with the square of their
size. Long thin faces are first halved at their longest edge, again and again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.errors import MeshError
from clradar.geometry.bvh import face_normals

LONGEST = 2.1
"""Longest edge of a triangle over the spacing of the points: 1.5 for equilateral triangles of that
density, 2 for halves of squares, which are not to be cut."""

FEWER = 0.1
"""Of an edge's parts that are rounded down: a density 1.2 times below what is asked for at worst,
for one triangle a face, and not four times above it."""

MOST_EDGE_POINTS = 2**11  # parts of an edge: their square is counted in float32
MOST_POINTS = 2**31  # their ordinals are signed numbers of 32 bits on the device


BLOCK_FACES = 2**16
"""Faces that are cut at a time, with some kilobytes of memory for each. No result depends on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Faces and parts of faces, in the order of faces."""

    face: np.ndarray  # (n,), int32
    corners: np.ndarray  # (n, 3, 2), float32: weights of the face's second and third corner
    edge_points: np.ndarray  # (n,), uint32: k, the piece is cut into k^2 triangles
    start: np.ndarray  # (n + 1,), uint32: first point of each, then the number of points

    @property
    def n_points(self) -> int:
        return int(self.start[-1])


def pieces_of(triangles_m: np.ndarray, samples_per_mm2: float) -> Pieces:
    """Cut faces, shape (n_faces, 3, 3), for a density of points.

    No face with an area, or 2^31 points or more, is a `MeshError`.
    """
    area_m2 = face_normals(triangles_m)[1]
    face = np.flatnonzero(area_m2 > 0)
    if len(face) == 0:
        raise MeshError("scene: expected at least one face with an area, got only degenerate faces")
    spacing_m = 1e-3 / np.sqrt(samples_per_mm2)
    _check_points(area_m2.sum() / spacing_m**2)
    parts = (face[i : i + BLOCK_FACES] for i in range(0, len(face), BLOCK_FACES))
    cut = [_cut(triangles_m, part, area_m2[part], spacing_m) for part in parts]
    face, corners, k = (np.concatenate(column) for column in zip(*cut, strict=True))
    start = np.zeros(len(k) + 1, np.int64)
    np.cumsum(k.astype(np.int64) ** 2, out=start[1:])
    _check_points(float(start[-1]))
    return Pieces(face, corners, k, start.astype(np.uint32))


def _cut(
    triangles_m: np.ndarray, face: np.ndarray, area: np.ndarray, spacing_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut some faces of an area: `Pieces.face`, `corners` and `edge_points`."""
    corners = np.broadcast_to(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (len(face), 3, 2))
    done: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    while len(face):
        at_m = _positions(triangles_m[face], corners)
        edges_m = np.linalg.norm(np.roll(at_m, -1, axis=1) - at_m, axis=2)
        k = np.maximum(1, np.ceil(np.sqrt(area) / spacing_m - FEWER)).astype(np.int64)
        too_long = (edges_m.max(axis=1) > LONGEST * spacing_m * k) | (k > MOST_EDGE_POINTS)
        fit = ~too_long
        done.append((face[fit], corners[fit], k[fit]))
        face, area = np.repeat(face[too_long], 2), np.repeat(area[too_long] / 2, 2)
        corners = _halved(corners[too_long], edges_m[too_long].argmax(axis=1))
        _check_points(float(len(face)))
    face, corners, k = (np.concatenate(column) for column in zip(*done, strict=True))
    order = np.argsort(face, kind="stable")
    columns = ((face, np.int32), (corners, np.float32), (k, np.uint32))
    face, corners, k = (column[order].astype(dtype) for column, dtype in columns)
    return face, corners, k


def _check_points(count: float) -> None:
    if count >= MOST_POINTS:
        raise MeshError(
            f"scene: expected fewer than 2^31 samples, got {count:.10g}; lower samples_per_mm2, or "
            "check the unit of the mesh"
        )


def _positions(triangles_m: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Positions of barycentric corners, shape (n, 3, 3), metres."""
    first = triangles_m[:, None, 0]
    edges = triangles_m[:, 1:] - triangles_m[:, :1]
    return np.asarray(first + np.einsum("nkc,nca->nka", corners, edges))


def _halved(corners: np.ndarray, longest: np.ndarray) -> np.ndarray:
    """Both halves of triangles that are cut at the middle of an edge, shape (2 n, 3, 2)."""
    turned = np.take_along_axis(
        corners, ((longest[:, None] + np.arange(3)) % 3)[:, :, None], axis=1
    )
    a, b, c = turned[:, 0], turned[:, 1], turned[:, 2]
    middle = 0.5 * (a + b)
    halves = np.stack([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)], axis=1)
    return halves.reshape(-1, 3, 2)
