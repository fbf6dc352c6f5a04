"""Samples of a mesh and their visibility from viewpoints: the depth map that a mesh has."""

from __future__ import annotations

import numpy as np

from clradar.model import Scene, checks
from clradar.opencl import Buffers, Device
from clradar.tracing.antenna_packets import bundled, n_groups
from clradar.tracing.sampled_surface import SampledSurface
from clradar.tracing.settings import resolve_settings


class VisibleSurface(SampledSurface):
    """Samples of a mesh on a device and their visibility from any viewpoints; a context manager.

    The mesh stays where it is; for one that is moved, move the viewpoints the other way. `reach_m`
    is how far from the origin a viewpoint may be: it bounds the rounding of the rays. `points_m`,
    float64, shape (n, 3), are on the curved surface that the normals describe; `normals` are
    interpolated from the vertices as in `clradar.trace`, of either sign.
    """

    def __init__(
        self,
        scene: Scene,
        samples_per_mm2: float,
        reach_m: float,
        device: Device,
        seed: int = 0,
    ) -> None:
        checks.instance("VisibleSurface: scene", scene, Scene)
        settings = resolve_settings(samples_per_mm2=samples_per_mm2, seed=seed)
        super().__init__(scene, settings, device)
        self._reach_m = checks.positive("VisibleSurface: reach_m", reach_m)
        self.points_m = self.normals = np.zeros((0, 3))

    def _prepare(self) -> None:
        self._prepare_surface(np.array([[self._reach_m, 0.0, 0.0]]))
        n, read = self.n_samples, self._buffers.read
        self._ground, shading, self._geometric, points = (
            self._buffers.empty(12 * n) for _ in range(4)
        )
        faces = self._buffers.empty(4 * n)
        self._sample(0, n, [self._ground, shading, self._geometric, faces, points])
        self.points_m = read(points, (n, 3), np.float32).astype(np.float64)
        self.normals = read(shading, (n, 3), np.float32).astype(np.float64)

    def visible_from(self, viewpoints_m: np.ndarray) -> np.ndarray:
        """Whether each sample is what a ray from each viewpoint (m, 3) hits first: bool, (n, m)."""
        bits = np.unpackbits(self.visible_bits(viewpoints_m), axis=1, bitorder="little")
        return bits[:, : len(viewpoints_m)].astype(bool)

    def visible_bits(self, viewpoints_m: np.ndarray) -> np.ndarray:
        """The same packed, shape (n, ceil(m / 8)), uint8; the first viewpoint is bit 0."""
        at = checks.read_only("visible_from: viewpoints_m", viewpoints_m, np.float64, (None, 3))
        shape = (self.n_samples, n_groups(len(at)))
        with Buffers(self.device) as buffers:
            bits = buffers.empty(shape[0] * shape[1])
            antennas = buffers.upload(bundled(at))
            self._find_visible(
                self.n_samples, self._ground, self._geometric, len(at), antennas, bits
            )
            return buffers.read(bits, shape, np.uint8)

    def ray_origins(self, viewpoints_m: np.ndarray) -> np.ndarray:
        """Samples lifted off their faces towards each viewpoint, shape (n, m, 3), float32, metres.

        The rays that decide the visibility begin there.
        """
        shape = (self.n_samples, 3)
        ground_m, normals = (
            self._buffers.read(buffer, shape, np.float32).astype(np.float64)
            for buffer in (self._ground, self._geometric)
        )
        towards = viewpoints_m[None] - ground_m[:, None]
        side = np.sign(np.einsum("sta,sa->st", towards, normals))[:, :, None]
        lift_m = 2 * float(self._tree.delta_m) * side * normals[:, None]
        return (ground_m[:, None] + lift_m).astype(np.float32)
