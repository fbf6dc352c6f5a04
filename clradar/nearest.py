"""What rays hit first, for rays given one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.bvh import build_bvh, error_bound_m, flatten
from clradar.model import checks
from clradar.opencl import Buffers, Device, build


@dataclass(frozen=True, slots=True)
class _NearestOptions:
    width: int
    stack: int


def nearest_hits(
    triangles_m: np.ndarray, origins_m: np.ndarray, directions: np.ndarray, device: Device
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where rays hit a mesh first.

    Parameters
    ----------
    triangles_m : array_like, shape (n_faces, 3, 3), metres
    origins_m : array_like, shape (n, 3), metres
    directions : array_like, shape (n, 3)
        Unit vectors.
    device : Device

    Returns
    -------
    distance_m : ndarray, shape (n,), float32, metres
        -1 where nothing is hit.
    face : ndarray, shape (n,), int32
        -1 where nothing is hit.
    weights : ndarray, shape (n, 2), float32
        Barycentric weights of the face's second and third corner.
    """
    at = checks.read_only("nearest_hits: origins_m", origins_m, np.float32, (None, 3))
    towards = checks.read_only("nearest_hits: directions", directions, np.float32, at.shape)
    delta_m = error_bound_m(np.asarray(triangles_m, dtype=np.float64), at.astype(np.float64))
    nodes, blocks, stack = flatten(build_bvh(triangles_m, device), triangles_m, delta_m)
    program = build(device, "nearest.cl", _NearestOptions(device.width, stack))
    n = len(at)
    with Buffers(device) as buffers:
        put = [buffers.upload(a) for a in (nodes, blocks, at, towards)]
        out = [buffers.empty(size * n) for size in (4, 4, 8)]
        program.launch("nearest_hits", (n,), np.uint32(n), *put, *out)
        return (
            buffers.read(out[0], n, np.float32),
            buffers.read(out[1], n, np.int32),
            buffers.read(out[2], (n, 2), np.float32),
        )
