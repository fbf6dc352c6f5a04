"""Depth maps as surfaces in PLY files (G. Turk, "The PLY Polygon File Format", 1994)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clradar.model import DepthMap, checks

STEEPEST = 3.0
"""Neighbours are joined where their depths differ by at most this many pixels: beyond some 70
degrees there is an edge with another surface behind it."""

_VERTEX = np.dtype(
    [
        *((name, "<f8") for name in "xyz"),
        ("amplitude", "<f4"),
        *((name, "u1") for name in ("red", "green", "blue")),
    ]
)
_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", (3,))])
_HEADER = """ply
format binary_little_endian 1.0
comment metres: x to the right of a person who faces the radar, y up, z away from it
element vertex {vertices}
property double x
property double y
property double z
property float amplitude
property uchar red
property uchar green
property uchar blue
element face {faces}
property list uchar int vertex_indices
end_header
"""


def write_ply_surface(path: Path, depth: DepthMap) -> None:
    """Write the pixels that have a depth as vertices, and triangles that face the radar."""
    points_m = depth.points_m()
    if not len(points_m):
        checks.fail("export_file: record", "a depth map with a depth, for a .ply file", "none")
    amplitude = depth.amplitude[depth.mask]
    vertices = np.empty(len(points_m), _VERTEX)
    for i, name in enumerate("xyz"):
        vertices[name] = points_m[:, i]
    vertices["amplitude"] = amplitude
    grey = _grey(amplitude, depth.dynamic_range_db)
    for name in ("red", "green", "blue"):
        vertices[name] = grey
    corners = triangles(depth)
    faces = np.empty(len(corners), _FACE)
    faces["count"], faces["vertices"] = 3, corners
    header = _HEADER.format(vertices=len(vertices), faces=len(faces))
    with open(path, "xb") as file:
        file.write(header.encode("ascii"))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def triangles(depth: DepthMap) -> np.ndarray:
    """Return the triangles between neighbouring pixels, shape (n, 3): rows of `points_m`.

    Two for each square of four pixels, with the normal towards the radar, -z; those with a pixel
    that has no depth, or with a step of more than `STEEPEST` pixels, are left out.
    """
    number = np.full(depth.mask.shape, -1)
    number[depth.mask] = np.arange(depth.mask.sum())
    here, right = (slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))
    above, across = (slice(1, None), slice(None, -1)), (slice(1, None), slice(1, None))
    if min(depth.mask.shape) < 2:
        return np.empty((0, 3), np.int64)
    pixel_m = max(float(np.diff(depth.x_m).max()), float(np.diff(depth.y_m).max()))
    found = []
    for corners in ((here, above, right), (right, above, across)):
        z_m = np.stack([depth.depth_m[corner] for corner in corners])
        joined = np.ptp(z_m, axis=0) <= STEEPEST * pixel_m  # False where one is NaN
        found.append(np.stack([number[corner][joined] for corner in corners], axis=1))
    return np.concatenate(found)


def _grey(amplitude: np.ndarray, range_db: float) -> np.ndarray:
    """Return levels from 0 at `range_db` below the maximum to 255."""
    level_db = 20 * np.log10(amplitude / amplitude.max())
    return np.round(255 * np.clip(1 + level_db / range_db, 0, 1)).astype(np.uint8)
