"""Test meshes of any number of faces, closed or concave."""

from __future__ import annotations

import numpy as np

import clradar


def ball(rings: int, sectors: int) -> clradar.Scene:
    """Closed, with bumps, 12 cm across at z = 0.3 m; 2 sectors (rings - 1) faces."""
    tilt = np.linspace(0, np.pi, rings + 1)[1:-1]
    azimuth = np.arange(sectors) * 2 * np.pi / sectors
    t, p = (a.ravel() for a in np.meshgrid(tilt, azimuth, indexing="ij"))
    way = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    way = np.concatenate([way, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    x, y, z = way.T
    bumps = 0.15 * np.sin(7 * x) * np.cos(5 * y + 1) + 0.05 * np.sin(20 * z + 3 * x)
    vertices = 0.06 * (1 + bumps)[:, None] * way * [1, 1, 0.6] + [0, 0, 0.3]

    first = np.arange(sectors)
    second = np.roll(first, -1)
    faces = [np.stack([np.full(sectors, len(way) - 2), first, second], axis=1)]
    for ring in range(rings - 2):
        a, b = first + ring * sectors, second + ring * sectors
        faces += [np.stack([a, a + sectors, b], axis=1)]
        faces += [np.stack([b, a + sectors, b + sectors], axis=1)]
    last = (rings - 2) * sectors
    faces += [np.stack([np.full(sectors, len(way) - 1), last + second, last + first], axis=1)]
    return clradar.Scene(vertices, np.concatenate(faces))


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
