"""Points all over a mesh, and which of them are seen from where: the depth map that a mesh has."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.geometry.bvh import build_bvh, error_bound_m, flatten
from clradar.geometry.normals import corner_normals
from clradar.model import Scene, checks
from clradar.opencl import Buffers, Device, build
from clradar.tracing.antenna_packets import GROUP, bundled, items
from clradar.tracing.lit_surface import _SampleOptions, _VisibilityOptions, samples_per_face
from clradar.tracing.settings import resolve_settings


class VisibleSurface:
    """Samples of a mesh on a device, ready to be asked from which places they are seen.

    A context manager: its device memory is freed when the block ends. The mesh stays where it is;
    to look at a mesh that is moved, move the viewpoints the other way.

    Parameters
    ----------
    scene : Scene
    samples_per_mm2 : float, 1/mm^2
    reach_m : float, metres
        How far from the origin a viewpoint may be: bounds the rounding of the rays.
    device : Device

    Attributes
    ----------
    points_m : ndarray, shape (n, 3), float64, metres
    normals : ndarray, shape (n, 3), float64
        Unit normals, interpolated from the vertices as in `clradar.trace`; of either sign.
    """

    def __init__(
        self, scene: Scene, samples_per_mm2: float, reach_m: float, device: Device
    ) -> None:
        checks.instance("VisibleSurface: scene", scene, Scene)
        self._scene = scene
        self._settings = resolve_settings(samples_per_mm2=samples_per_mm2)
        self._reach_m = checks.positive("VisibleSurface: reach_m", reach_m)
        self._device = device
        self._buffers = Buffers(device)
        self.points_m = self.normals = np.zeros((0, 3))

    def __enter__(self) -> VisibleSurface:
        try:
            self._prepare()
        except BaseException:
            self._buffers.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        self._buffers.__exit__(None, None, None)

    def _prepare(self) -> None:
        up, device = self._buffers.upload, self._device
        triangles = self._scene.triangles_m
        bvh = build_bvh(triangles, device)
        self._delta = np.float32(error_bound_m(triangles, np.array([[self._reach_m, 0.0, 0.0]])))
        nodes, records, stack = flatten(bvh, triangles, float(self._delta))
        corners, faces = corner_normals(self._scene)
        counts = samples_per_face(self._scene, self._settings)
        n = int(counts.sum())
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)
        self._tree = [up(nodes), up(records)]
        self._points, shading, self._geometric = (self._buffers.empty(12 * n) for _ in range(3))
        u = np.uint32
        build(device, "sample.cl", _SampleOptions(1)).launch(
            "sample_surface", (n,), u(len(counts)), u(0), u(n), u(0), u(0), up(start),
            *(up(a.astype(np.float32)) for a in (triangles, corners, faces)),
            self._points, shading, self._geometric, self._buffers.empty(4 * n),
        )  # fmt: skip
        self._program = build(device, "visibility.cl", _VisibilityOptions(device.width, stack))
        self.points_m = self._buffers.read(self._points, (n, 3), np.float32).astype(np.float64)
        self.normals = self._buffers.read(shading, (n, 3), np.float32).astype(np.float64)

    def seen_from(self, viewpoints_m: np.ndarray) -> np.ndarray:
        """Return whether each sample is what a ray from each viewpoint hits first.

        Parameters
        ----------
        viewpoints_m : array_like, shape (m, 3), metres

        Returns
        -------
        ndarray, shape (n, m), bool
        """
        bits = np.unpackbits(self.seen_bits(viewpoints_m), axis=1, bitorder="little")
        return bits[:, : len(viewpoints_m)].astype(bool)

    def seen_bits(self, viewpoints_m: np.ndarray) -> np.ndarray:
        """Return the same packed, shape (n, ceil(m / 8)), uint8; the first viewpoint is bit 0."""
        at = checks.read_only("seen_from: viewpoints_m", viewpoints_m, np.float64, (None, 3))
        n, groups = len(self.points_m), -(-len(at) // GROUP)
        u = np.uint32
        with Buffers(self._device) as buffers:
            bits = buffers.empty(n * groups)
            self._program.launch(
                "visible_antennas", items(self._device, n, groups), u(n), u(len(at)), u(groups),
                self._delta, *self._tree, buffers.upload(bundled(at)), self._points,
                self._geometric, bits,
            )  # fmt: skip
            return buffers.read(bits, (n, groups), np.uint8)
