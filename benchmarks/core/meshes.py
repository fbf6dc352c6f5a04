"""Test meshes of any number of faces, closed or concave."""

from __future__ import annotations

import numpy as np
import trimesh

import clradar


def ball(rings: int) -> clradar.Scene:
    """Closed, with bumps, 12 cm across at z = 0.3 m; about 8 rings^2 faces."""
    mesh = trimesh.creation.uv_sphere(1.0, count=(rings, 2 * rings))
    x, y, z = mesh.vertices.T
    bumps = 0.15 * np.sin(7 * x) * np.cos(5 * y + 1) + 0.05 * np.sin(20 * z + 3 * x)
    vertices = 0.06 * (1 + bumps)[:, None] * mesh.vertices * [1, 1, 0.6] + [0, 0, 0.3]
    return clradar.Scene(vertices, mesh.faces)


def waves(cells: int) -> clradar.Scene:
    """Open, 20 cm wide, its hollows towards the radar and rippled; 2 cells^2 faces."""
    axis = np.linspace(-0.1, 0.1, cells + 1)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    z = 0.32 + 0.03 * np.sin(90 * x) * np.cos(70 * y) - 2 * (x * x + y * y)
    z += 0.002 * np.sin(1500 * x) * np.sin(1300 * y)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    low = np.stack([corner, corner + 1, corner + cells + 2], axis=1)
    high = np.stack([corner, corner + cells + 2, corner + cells + 1], axis=1)
    faces = np.stack([low, high], axis=1).reshape(-1, 3)
    return clradar.Scene(np.stack([x, y, z], axis=1), faces)
