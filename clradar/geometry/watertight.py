"""Watertightness of a triangle mesh: from inside a closed surface no antenna outside is visible."""

from __future__ import annotations

import numpy as np

_CHUNK = 2**16  # faces at a time, so that they stay in the cache


def outward_side(triangles_m: np.ndarray) -> int:
    """Side of the faces (n_faces, 3, 3), float32, metres, of a closed surface that is outside.

    1: closed, most of its volume is on the side that the normals point away from; -1: closed, on
    the other side; 0: not closed. A surface is closed if every edge belongs to an even number of
    faces: no ray leaves it without crossing a face (F. S. Nooruddin and G. Turk, "Simplification
    and repair of polygonal models using volumetric techniques", IEEE Trans. Visualization and
    Computer Graphics 9(2), 2003). Edges are not sorted; each has a 64-bit hash of the bits of its
    corners, and the exclusive or of all hashes is 0 if each comes in pairs (or by chance, with
    probability 2^-64).
    """
    odd, volume = np.uint64(0), 0.0
    for first in range(0, len(triangles_m), _CHUNK):
        corners = triangles_m[first : first + _CHUNK].astype(np.float32) + np.float32(0)  # no -0
        words = np.ascontiguousarray(corners).view(np.uint32).astype(np.uint64)
        keys = _mixed(_mixed(words[..., 0] | words[..., 1] << np.uint64(32)) + words[..., 2])
        for a, b in ((0, 1), (1, 2), (2, 0)):
            edges = _mixed(keys[:, a] + keys[:, b])
            edges[keys[:, a] == keys[:, b]] = 0
            odd ^= np.bitwise_xor.reduce(edges)
        v0, v1, v2 = corners.astype(np.float64).transpose(1, 0, 2)
        volume += float(np.einsum("ij,ij->", v0, np.cross(v1, v2)))
    if odd:
        return 0
    return 1 if volume >= 0 else -1


def _mixed(words: np.ndarray) -> np.ndarray:
    """Spread every bit over all 64 (the finalizer of SplitMix64, Steele et al., OOPSLA 2014)."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))
