"""Visibility of antennas from points, straight from the kernel."""

from __future__ import annotations

import numpy as np

from clradar.geometry.bvh import build_bvh, error_bound_m, flatten
from clradar.opencl import Buffers, build
from clradar.tracing.antenna_packets import GROUP, bundled, items
from clradar.tracing.lit_surface import _VisibilityOptions

STACK = 128


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def seen(mesh, point, normal, tx, device) -> np.ndarray:
    """Which antennas each point sees, shape (n_points, n_tx), from `visible_antennas`."""
    vertices, faces = mesh
    triangles = vertices[faces]
    delta_m = error_bound_m(triangles, tx, point)
    bvh = build_bvh(triangles, device)
    nodes, records, stack = flatten(bvh, triangles, delta_m)
    assert stack <= STACK
    n_groups = -(-len(tx) // GROUP)
    program = build(device, "visibility.cl", _VisibilityOptions(device.width, STACK))
    with Buffers(device) as buffers:
        arrays = (nodes, records, bundled(tx), point.astype(np.float32), normal.astype(np.float32))
        put = [buffers.upload(a) for a in arrays]
        out = buffers.zeros(len(point) * n_groups)
        u = np.uint32
        program.launch(
            "visible_antennas", items(device, len(point), n_groups), u(len(point)), u(len(tx)),
            u(n_groups), np.float32(delta_m), *put, out,
        )  # fmt: skip
        bits = buffers.read(out, (len(point), n_groups), np.uint8)
    flags = np.unpackbits(bits, axis=1, bitorder="little").astype(bool)
    assert not flags[:, len(tx) :].any()
    return flags[:, : len(tx)]
