"""The smooth surface that faces and the normals at their corners describe.

Host side of ``common/curved.h``; E1 in ``docs/equations.md``.
"""

from __future__ import annotations

import numpy as np

FLAT_STEPS = 4.0
"""Steps of float32 at a face's largest coordinate: a face whose heights are not larger is flat.
Rounding of its corners to float32 leaves three halves of a step along each axis."""


def corner_heights(triangles_m: np.ndarray, corner_normals: np.ndarray) -> np.ndarray:
    """Return the heights of corners over the tangent planes at the other corners, metres.

    ``[f, i, k]``, float64, shape (n_faces, 3, 2), is (v_j - v_i) . n_i of face f with j = (i + 1 +
    k) modulo 3, of corners v and unit normals n of either sign, both (n_faces, 3, 3). Zeros for
    faces that are flat but for the rounding of their corners to float32.
    """
    heights = np.empty((len(triangles_m), 3, 2))
    for k in (0, 1):
        edges = np.roll(triangles_m, -1 - k, axis=1) - triangles_m
        heights[:, :, k] = np.einsum("fia,fia->fi", edges, corner_normals)
    largest_m = np.abs(triangles_m).max(axis=(1, 2)).astype(np.float32)
    limit_m = FLAT_STEPS * np.spacing(largest_m)
    flat = np.abs(heights).max(axis=(1, 2)) <= limit_m
    heights[flat] = 0.0
    return heights
