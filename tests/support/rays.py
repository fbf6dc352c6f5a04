"""Visibility of antennas from points, straight from the kernel."""

import numpy as np

from clradar.geometry.bvh import upload_tree
from clradar.opencl import Buffers, build
from clradar.tracing.antenna_packets import VisibilityOptions, bundled, items, n_groups

STACK = 128
"""For all trees of the tests, so that the kernel is built once."""


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def seen(mesh, point, normal, tx, device) -> np.ndarray:
    """Visibility of antennas from points, shape (n_points, n_tx), from `visible_antennas`."""
    vertices, faces = mesh
    groups = n_groups(len(tx))
    wide = device.width == 8
    options = VisibilityOptions(width=device.width, wide=wide, stack=STACK)
    program = build(device, "visibility.cl", options)
    with Buffers(device) as buffers:
        tree = upload_tree(vertices[faces], [tx, point], buffers)
        assert tree.stack <= STACK
        arrays = (bundled(tx), point.astype(np.float32), normal.astype(np.float32))
        out = buffers.zeros(len(point) * groups)
        u = np.uint32
        program.launch(
            "visible_antennas", items(device, len(point), groups), u(len(point)), u(len(tx)),
            u(groups), tree.delta_m, *tree.buffers, *(buffers.upload(a) for a in arrays), out,
        )  # fmt: skip
        bits = buffers.read(out, (len(point), groups), np.uint8)
    flags = np.unpackbits(bits, axis=1, bitorder="little").astype(bool)
    assert not flags[:, len(tx) :].any()
    return flags[:, : len(tx)]
