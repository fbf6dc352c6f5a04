"""Self-intersections of a triangle mesh: edge against triangle, in pairs from a k-d tree."""

from __future__ import annotations

import numpy as np

# An edge whose sine to a triangle's plane is less lies in it: coplanar triangles do not cross.
_LEAST_SLOPE = 1e-7


def crossing_faces(
    vertices_m: np.ndarray, faces: np.ndarray, among: np.ndarray | None = None
) -> np.ndarray:
    """Return the pairs (N, 2) of faces, of those `among`, without a common corner that intersect.

    Two triangles intersect if an edge of one meets the other, unless it lies in its plane.
    """
    chosen = np.arange(len(faces)) if among is None else among
    if not len(chosen):
        return np.zeros((0, 2), dtype=np.int64)
    corners = faces[chosen]
    triangles_m = vertices_m[corners]
    one, other = _close_pairs(triangles_m)
    apart = (corners[one][:, :, None] != corners[other][:, None, :]).all(axis=(1, 2))
    one, other = one[apart], other[apart]
    crossed = np.zeros(len(one), dtype=bool)
    for a, b in ((one, other), (other, one)):
        for k in range(3):
            begin_m, end_m = triangles_m[a, k], triangles_m[a, (k + 1) % 3]
            crossed |= _edge_meets(begin_m, end_m - begin_m, triangles_m[b])
    return chosen[np.stack([one[crossed], other[crossed]], axis=1)]


def _close_pairs(triangles_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of triangles (N, 3, 3) whose bounding boxes overlap, each pair once."""
    from scipy.spatial import cKDTree

    centre_m = (triangles_m[:, 0] + triangles_m[:, 1] + triangles_m[:, 2]) / 3.0
    from_m = triangles_m - centre_m[:, None]
    most_m = 2.0 * np.sqrt(np.einsum("ijk,ijk->ij", from_m, from_m).max()) * (1.0 + 1e-9)
    one, other = cKDTree(centre_m).query_pairs(most_m, output_type="ndarray").T
    for low_m, high_m in zip(triangles_m.min(axis=1).T, triangles_m.max(axis=1).T, strict=True):
        meet = (low_m[one] <= high_m[other]) & (low_m[other] <= high_m[one])
        one, other = one[meet], other[meet]
    return one, other


def _edge_meets(begin_m: np.ndarray, edge_m: np.ndarray, triangles_m: np.ndarray) -> np.ndarray:
    """Return for N edges and N triangles whether the edge meets the triangle.

    After Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", Journal of
    Graphics Tools 2(1), 1997.
    """
    first_m = triangles_m[:, 1] - triangles_m[:, 0]
    second_m = triangles_m[:, 2] - triangles_m[:, 0]
    from_corner_m = begin_m - triangles_m[:, 0]
    across = np.cross(edge_m, second_m)
    turned = np.cross(from_corner_m, first_m)
    determinant = np.einsum("ij,ij->i", first_m, across)
    size = np.linalg.norm(np.cross(first_m, second_m), axis=1) * np.linalg.norm(edge_m, axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = np.einsum("ij,ij->i", from_corner_m, across) / determinant
        v = np.einsum("ij,ij->i", edge_m, turned) / determinant
        t = np.einsum("ij,ij->i", second_m, turned) / determinant
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        return inside & (t >= 0.0) & (t <= 1.0) & (np.abs(determinant) > _LEAST_SLOPE * size)
