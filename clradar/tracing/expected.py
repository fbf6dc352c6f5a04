"""Expected receptions: integration over the outgoing directions in place of Monte Carlo sampling.

For each sample, Tx and Rx the probability that the outgoing ray enters the Rx sphere, as derived in
``docs/estimators.md``. Host side of ``expected.cl``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from clradar.model import TraceStatistics
from clradar.model.progress import Progress
from clradar.opencl import build
from clradar.opencl.buffers import antenna_rows
from clradar.tracing.antenna_packets import GROUP
from clradar.tracing.lit_surface import TILE_SAMPLES, LitSurface, Receptions

PLAIN_NODES, EDGE_NODES, FINE_NODES = 4, 6, 12
"""Quadrature nodes of a disc, of a piece of one that the lobe's edge cuts, and of large discs."""

BATCH_SAMPLES = 256
"""Visible samples whose probabilities are held at a time; fewer where memory is short or the array
large. No result depends on it."""

BATCH_BYTES = 2**26  # most that the probabilities and paths of a batch may take
GPU_SHARE = 16  # samples of an item on a GPU; on a CPU it takes all of a batch
LIST_ITEMS = 2**17  # most items on a GPU for the discs that need slices
RX_FIELDS, TX_FIELDS = 8, 20  # numbers per sample and antenna between the kernels


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedOptions:
    """Options of ``expected.cl``."""

    nvidia_registers: ClassVar[int] = 96
    width: int
    spreading: bool
    group: int = GROUP
    rx_fields: int = RX_FIELDS
    tx_fields: int = TX_FIELDS
    plain: int = PLAIN_NODES
    edge: int = EDGE_NODES
    fine: int = FINE_NODES


class ExpectedTracer(LitSurface):
    """Finds one path per sample, Tx and Rx, whose amplitude is the mean over random directions.

    The samples are those of `Tracer`; nothing else is random.
    """

    def _prepare_rays(self) -> None:
        array, up = self.array, self._buffers.upload
        spreading = self.settings.amplitude == "spreading"
        self._padded = self._n_rx_groups * GROUP
        # Padding may be anywhere: the kernel marks its lanes as missing.
        rx = np.concatenate(
            [array.rx_m, np.repeat(array.rx_m[-1:], self._padded - array.n_rx, axis=0)]
        )
        self._rx_columns = up(np.ascontiguousarray(antenna_rows(rx).T))
        self._tx_rows = up(antenna_rows(array.tx_m))
        self._longest = self._longest_m()
        rules = np.concatenate([_gauss_legendre(EDGE_NODES), _gauss_legendre(FINE_NODES)])
        self._rule = up(rules.astype(np.float32))
        options = ExpectedOptions(width=self.device.width, spreading=spreading)
        self._expected = build(self.device, "expected.cl", options)

    def _size_tiles(self) -> None:
        n_pairs = self.array.n_tx * self.array.n_rx
        probabilities = 4 * self.array.n_tx * self._padded
        fields = 4 * (RX_FIELDS * self._padded + TX_FIELDS * self.array.n_tx)
        per_sample = 56 + self._n_tx_groups
        free = min(self._room_bytes, 4 * self.device.max_buffer_bytes) - 8 * n_pairs
        per_batch = 2 * probabilities + fields + 12 * n_pairs + per_sample + self._n_rx_groups
        fits = min(BATCH_BYTES, max(0, free) // 2) // per_batch
        largest = self.device.max_buffer_bytes // max(probabilities, 8 * n_pairs)
        batch = int(max(1, min(BATCH_SAMPLES, self.n_samples, fits, largest)))
        tile = int(max(1, min(TILE_SAMPLES, self.n_samples, max(0, free) // 4 // per_sample)))
        empty = self._buffers.empty
        self._tile_samples, self._batch_samples = tile, batch
        self._share = batch if self.device.width == 8 else GPU_SHARE
        most_parts = -(-batch // self._share)
        self._tile = self._sample_buffers(tile)
        self._batch = self._sample_buffers(batch)
        self._rx_visible = empty(self._n_rx_groups * batch)
        self._discs = empty(4 * RX_FIELDS * self._padded * batch)
        self._tx_lobes = empty(4 * TX_FIELDS * self.array.n_tx * batch)
        self._probabilities = empty(probabilities * batch)
        self._listed, self._n_listed = empty(probabilities * batch), empty(8)
        self._counts = empty(probabilities * most_parts)
        self._starts = empty(4 * (n_pairs * most_parts + 1))
        # At least the eight that the phasor sum reads at a time.
        self._length = self._buffers.zeros(8 * max(8, n_pairs * batch))
        self._amplitude = self._buffers.zeros(4 * max(8, n_pairs * batch))

    def tiles(self, progress: Progress | None = None) -> Iterator[Receptions]:
        """Yield the expected receptions of all samples, batch by batch, sorted by pair."""
        n_groups = self._n_tx_groups
        for first in range(0, self.n_samples, self._tile_samples):
            count = min(self._tile_samples, self.n_samples - first)
            faces, n_visible = self._illuminate(first, count)
            ground, shading, geometric, _, _, visible, points = self._tile
            vectors = [
                self._buffers.read(b, (count, 3), np.float32)
                for b in (ground, shading, geometric, points)
            ]
            bits = self._buffers.read(visible, (count, n_groups), np.uint8)
            # Samples that are visible from no Tx are left out.
            rows = np.flatnonzero(bits.any(axis=1))
            statistics = TraceStatistics(count, int(n_visible.sum()), 0, 0)
            for at in range(0, max(1, len(rows)), self._batch_samples):
                part = rows[at : at + self._batch_samples]
                columns = [*(v[part] for v in vectors), self._face_alpha[faces[part]], bits[part]]
                yield self._expectations(columns, statistics)
                statistics = TraceStatistics(0, 0, 0, 0)
            if progress is not None:
                progress(first + count, self.n_samples)

    def _expectations(self, columns: list[np.ndarray], statistics: TraceStatistics) -> Receptions:
        count = len(columns[0])
        n_parts = max(1, -(-count // self._share))
        start = np.zeros(self.array.n_tx * self.array.n_rx * n_parts + 1, np.uint32)
        if count:
            np.cumsum(self._find_probabilities(columns, count, n_parts), out=start[1:])
        if start[-1]:
            self._emit(start, count, n_parts)
        start = np.ascontiguousarray(start[::n_parts])
        return Receptions(start, self._length, self._amplitude, self._longest, statistics)

    def _find_probabilities(
        self, columns: list[np.ndarray], count: int, n_parts: int
    ) -> np.ndarray:
        """How many paths each part of each pair has."""
        s, array, u = self.settings, self.array, np.uint32
        ground, shading, geometric, _, alpha, visible, points = self._batch
        buffers = (ground, shading, geometric, points, alpha, visible)
        for buffer, column in zip(buffers, columns, strict=True):
            self._buffers.write(buffer, column)
        radius, exponent = np.float32(s.radius_m), np.float32(s.pattern_exponent)
        self._find_visible(
            count, ground, geometric, array.n_rx, self._rx_bundles, self._rx_visible,
            s.radius_m,
        )  # fmt: skip
        width = self.device.width
        blocks = self._padded // width
        self._expected.start(
            "receiver_discs", (blocks, count), u(count), u(array.n_rx), u(self._padded), radius,
            exponent, self._rx_columns, points, self._rx_visible, self._discs,
        )  # fmt: skip
        self._expected.start(
            "tx_lobes", (array.n_tx, count), u(count), u(array.n_tx), u(self._n_tx_groups),
            exponent, self._tx_rows, points, shading, geometric, alpha, visible, self._tx_lobes,
            self._n_listed,
        )  # fmt: skip
        sizes, parts = (u(count), u(array.n_tx), u(self._padded)), (u(self._share), u(n_parts))
        discs = (self._discs, self._tx_lobes, alpha, self._rule, self._probabilities)
        listed, size = (self._n_listed, self._listed), (blocks, array.n_tx, n_parts)
        self._expected.start(
            "reception_probabilities", size, *sizes, *parts, *discs, *listed, self._counts,
            work=200.0 * self._share,
        )  # fmt: skip
        if width == 1:
            most = count * array.n_tx * self._padded
            items = min(LIST_ITEMS, most)
            self._expected.start(
                "listed_probabilities", (items,), u(items), *sizes, *discs, *listed,
                work=200.0 * most / items,
            )  # fmt: skip
            self._expected.start(
                "count_probabilities", size, *sizes, *parts, self._probabilities, self._counts,
                work=4.0 * self._share,
            )  # fmt: skip
        counts = self._buffers.read(self._counts, (array.n_tx, n_parts, self._padded), np.float32)
        return counts[..., : array.n_rx].transpose(0, 2, 1).ravel().astype(np.int64)

    def _emit(self, start: np.ndarray, count: int, n_parts: int) -> None:
        array, u = self.array, np.uint32
        self._buffers.write(self._starts, start)
        self._expected.launch(
            "expected_paths", (self._padded // self.device.width, array.n_tx, n_parts), u(count),
            u(array.n_tx), u(array.n_rx), u(self._padded), u(self._share), u(n_parts),
            np.float32(self._rays_per_sample), self._discs, self._tx_lobes, self._probabilities,
            self._starts, self._length, self._amplitude, work=30.0 * self._share,
        )  # fmt: skip


def _gauss_legendre(nodes: int) -> np.ndarray:
    """-cos tau and its weight at the Gauss-Legendre nodes tau in 0 to pi, shape (nodes, 2)."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    tau = (x + 1) * np.pi / 2
    return np.stack([-np.cos(tau), weight * np.pi / 2 * np.sin(tau)], axis=1)
