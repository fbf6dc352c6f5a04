"""Surface samples that transmitters illuminate: what both estimators of receptions start from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import AntennaArray, Scene, TraceStatistics, checks
from clradar.opencl import Device
from clradar.tracing.antenna_packets import bundled, n_groups
from clradar.tracing.sampled_surface import SampledSurface
from clradar.tracing.settings import SimulationSettings

TILE_SAMPLES = 16384
"""Samples per tile, fewer where memory is short. No result depends on it."""

SUM_SHARE = 1 / 3
"""Of a device's memory: the most that the sum of the paths takes, and is left free for it."""


@dataclass(frozen=True, slots=True, eq=False)
class Receptions:
    """Receptions of n paths of some samples, on the device until the next ones are requested.

    `start`, uint32, shape (n_tx * n_rx + 1,), has the first path of each pair, then their number; a
    pair's are in the order of samples. Of the expected estimator `statistics` have no outgoing and
    absorbed rays: none is drawn.
    """

    start: np.ndarray
    length: Any  # buffer of n, at least 8, metres: float64, or float (n, 2), hi + lo, if expected
    amplitude: Any  # buffer of as many floats
    longest_m: float  # no path of the scene is longer
    statistics: TraceStatistics


class LitSurface(SampledSurface):
    """Samples of a scene's surface, and which Tx illuminate them, tile by tile.

    Subclasses find the receptions. They prepare their kernels in `_prepare_rays` and take the
    memory of a tile in `_size_tiles`. Only the Tx of the slice `tx` are looked at; what they add is
    what they add to the whole array.
    """

    def __init__(
        self,
        scene: Scene,
        array: AntennaArray,
        settings: SimulationSettings,
        device: Device,
        tx: slice = slice(None),
    ) -> None:
        super().__init__(scene, settings, device)
        if array.n_tx * array.n_rx >= 2**32:
            checks.fail("array", "fewer than 2^32 pairs", f"{array.n_tx} x {array.n_rx}")
        assert settings.rays_per_sample is not None, "settings are resolved"
        self._ends_m = (array.tx_m, array.rx_m)
        self._tx_before = tx.start or 0
        self.array = array = AntennaArray(array.tx_m[tx], array.rx_m)
        self._rays_per_sample = settings.rays_per_sample
        self._face_alpha = np.asarray(scene.alpha, dtype=np.float32)
        self._n_tx_groups, self._n_rx_groups = n_groups(array.n_tx), n_groups(array.n_rx)
        self._tile_samples = 0
        self._tile: list[Any] = []

    def _prepare(self) -> None:
        array = self.array
        self._prepare_surface(*self._ends_m)
        self._tx_bundles = self._buffers.upload(bundled(array.tx_m))
        out_of_reach = array.rx_m.max(axis=0) + 1e3 + self.settings.radius_m * 10
        self._rx_bundles = self._buffers.upload(bundled(array.rx_m, out_of_reach))
        self._prepare_rays()
        self._size_tiles()

    def _longest_m(self, reflections: int = 1) -> float:
        """No path with so many reflections is longer, metres."""
        ends = (self._scene.triangles_m.reshape(-1, 3), *self._ends_m)
        point_m, *antennas_m = (np.linalg.norm(at, axis=1).max() for at in ends)
        between_m = np.linalg.norm(np.ptp(ends[0], axis=0))
        return float(2 * point_m + (reflections - 1) * between_m + sum(antennas_m))

    def _prepare_rays(self) -> None:
        """Upload and build what comes after the samples."""
        raise NotImplementedError

    def _size_tiles(self) -> None:
        """Set `_tile_samples` and `_tile`, and take the memory that a tile needs."""
        raise NotImplementedError

    @property
    def _room_bytes(self) -> int:
        """Memory that is free but for the sum's share."""
        reserved = int(SUM_SHARE * self.device.budget_bytes)
        return max(0, self._buffers.free_bytes - reserved)

    def _sample_buffers(self, count: int) -> list[Any]:
        """Buffers for points on flat faces, shading and face normals, faces, alpha, visible Tx, and
        points on the curved surface."""
        lengths = (12, 12, 12, 4, 4, self._n_tx_groups, 12)
        return [self._buffers.empty(length * count) for length in lengths]

    def _illuminate(self, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Sample the surface and find the visible Tx; returns face and number of these of each."""
        ground, _, geometric, face, _, visible, points = self._tile
        self._sample(first, count, [*self._tile[:4], points])
        self._find_visible(count, ground, geometric, self.array.n_tx, self._tx_bundles, visible)
        bits = self._buffers.read(visible, (count, self._n_tx_groups), np.uint8)
        return self._buffers.read(face, count, np.int32), np.unpackbits(bits, axis=1).sum(axis=1)
