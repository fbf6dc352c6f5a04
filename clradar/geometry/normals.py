"""Shading normals at the corners of faces: flat, or angle-weighted with creases.

Weights by corner angle are those of G. Thuermer and C. A. Wuethrich, "Computing vertex normals from
polygonal facets", J. Graphics Tools 3(1), 1998.
"""

from __future__ import annotations

import numpy as np

from clradar.geometry.bvh import face_normals
from clradar.model import Scene, checks

CREASE_DEG = 30.0  # faces that meet at more than this angle keep an edge between them
KNOWN_DEG = 60.0
"""A scene's own normals are used at faces that are tilted against them by no more: at a vertex
between two surfaces that touch, its normal is that of one of them."""


def corner_normals(
    scene: Scene, normals: str = "smooth", crease_deg: float = CREASE_DEG
) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals at the corners of all faces, (n_faces, 3, 3), and of the faces, (n_faces, 3).

    "smooth": the average, weighted by corner angle, over the faces around the vertex that are
    connected to this face by edges at which they meet at no more than `crease_deg`, 0 to 180.
    Vertices at the same position count as one. Where the scene has a normal within `KNOWN_DEG` of
    the face's, it is that one. "face": the face's own normal. Degenerate faces have zeros.
    """
    checks.one_of("normals", normals, ("smooth", "face"))
    crease_deg = checks.within("crease_deg", crease_deg, 0, 180, " degrees")
    triangles = scene.triangles_m
    face_normal, area = face_normals(triangles)
    flat = np.repeat(face_normal[:, None], 3, axis=1)
    if normals == "face":
        return flat, face_normal

    _, position = np.unique(scene.vertices_m, axis=0, return_inverse=True)
    faces = position.reshape(-1).astype(np.int32)[scene.faces]
    one, other = _smooth_corner_pairs(faces, face_normal, area > 0, np.cos(np.radians(crease_deg)))
    group = _connected(3 * len(faces), one, other)
    weighted = (_corner_angles(triangles)[:, :, None] * flat).reshape(-1, 3)
    total = np.stack([np.bincount(group, weights=weighted[:, k]) for k in range(3)], axis=1)
    norm = np.linalg.norm(total, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = np.where(norm > 1e-9, total / norm, 0.0)[group].reshape(-1, 3, 3)
    cancelled = (np.abs(smooth).sum(axis=2) == 0)[:, :, None]
    found = np.where(cancelled, flat, smooth)
    return _known(scene, found, face_normal), face_normal


def _known(scene: Scene, found: np.ndarray, face_normal: np.ndarray) -> np.ndarray:
    """The scene's own normals where it has them and they fit the face, `found` elsewhere."""
    if scene.normals is None:
        return found
    given = scene.normals[scene.faces]
    cosine = np.einsum("fka,fa->fk", given, face_normal)[:, :, None]
    fits = np.abs(cosine) >= np.cos(np.radians(KNOWN_DEG))
    return np.where(fits, np.sign(cosine) * given, found)


def _smooth_corner_pairs(
    faces: np.ndarray, face_normal: np.ndarray, real: np.ndarray, cos_crease: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of corners (3 * face + corner) at both ends of every edge but creases."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]]  # (n_faces, 3 edges, 2 ends)
    sides = np.array([[0, 1], [1, 2], [2, 0]], np.int32)
    corner = 3 * np.arange(len(faces), dtype=np.int32)[:, None, None] + sides
    reverse = ends[..., 0] > ends[..., 1]
    ends = np.where(reverse[..., None], ends[..., ::-1], ends)[real].reshape(-1, 2)
    corner = np.where(reverse[..., None], corner[..., ::-1], corner)[real].reshape(-1, 2)
    by_edge = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, corner = ends[by_edge], corner[by_edge]
    # Neighbours in this order that share the edge; with more than two faces at an edge, each with
    # the next.
    shared = (ends[1:] == ends[:-1]).all(axis=1)
    a, b = corner[:-1][shared], corner[1:][shared]
    cosine = np.einsum("ij,ij->i", face_normal[a[:, 0] // 3], face_normal[b[:, 0] // 3])
    smooth = cosine >= cos_crease - 1e-9
    return a[smooth].ravel(), b[smooth].ravel()


def _connected(n: int, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The first corner that each of `n` is connected to by pairs of corners, shape (n,).

    Those around a vertex are few; SciPy's graphs take longer to import than this does.
    """
    first = np.arange(n, dtype=np.int32)
    while True:
        a, b = first[one], first[other]
        apart = a != b
        if not apart.any():
            return first
        one, other, a, b = one[apart], other[apart], a[apart], b[apart]
        np.minimum.at(first, np.maximum(a, b), np.minimum(a, b))
        while True:
            further = first[first]
            if (further == first).all():
                break
            first = further


def _corner_angles(triangles_m: np.ndarray) -> np.ndarray:
    """Inner angle at every corner, shape (n_faces, 3), radians; 0 where degenerate."""
    angles = np.zeros(triangles_m.shape[:2])
    for k in range(3):
        a = triangles_m[:, (k + 1) % 3] - triangles_m[:, k]
        b = triangles_m[:, (k + 2) % 3] - triangles_m[:, k]
        angles[:, k] = np.arctan2(
            np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b)
        )
    return angles
