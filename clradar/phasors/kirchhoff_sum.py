"""The Kirchhoff sum over lit points, compressed cube by cube: host side of ``kirchhoff.cl``.

E12 in ``docs/equations.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Material, Waveform
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device, build
from clradar.opencl.buffers import OnDevice, hi_lo
from clradar.phasors.interpolative import Decomposition
from clradar.phasors.leg_skeletons import (
    LegPoints,
    Side,
    antenna_skeleton,
    frequency_skeleton,
    linear_damping,
)
from clradar.phasors.leg_tables import NODES, PATTERN_NODES, pattern_table, reflection_legs
from clradar.phasors.point_cubes import PointCubes, cubes_of
from clradar.tracing.antenna_packets import GROUP, n_groups
from clradar.tracing.quadrature import LitPoints

CUBE_WAVELENGTHS = 4.4
"""Edge of a cube in the shortest wavelengths: 16 mm at 82 GHz. Larger cubes need more skeleton
antennas and frequencies, smaller ones are more."""

TOLERANCE_DB = -60.0  # RMS error of the capture relative to its RMS that the compression may cause
MARGIN = 0.5  # part of the tolerance that the skeletons use, shared by Tx, Rx and frequencies
FEW_POINTS = 200
"""With fewer points that all antennas see, choosing skeleton antennas costs more than it saves."""

CAPTURE_SHARE = 1 / 4
"""Most of a device's memory that the samples take; of a larger capture some Tx are summed at a
time. No result depends on it."""

BATCH_BYTES = 2**25
"""Most that the sums of the cubes of a batch take. No result depends on it."""

LEG_BYTES = 2**24
"""Most that the legs of a call take, so that they stay in the cache. No result depends on it."""

ROWS, FREQUENCIES, POINT_NUMBERS = 4, 4, 12
"""Tx and frequencies of an item, and numbers of a point, in ``kirchhoff.cl``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KirchhoffOptions:
    """Options of ``kirchhoff.cl``."""

    width: int
    terms: int
    materials: bool
    pattern: bool
    nodes: int = NODES
    pattern_nodes: int = PATTERN_NODES
    point: int = POINT_NUMBERS


@dataclass(frozen=True, slots=True, eq=False)
class _Antennas:
    """Antennas of one side on the device."""

    n_padded: int
    rows: Any
    """float (9, n_padded)"""


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Points that are summed for the same antennas, cube by cube."""

    start: np.ndarray
    """First point of each cube, then their number, shape (n_cubes + 1,), uint32."""
    points: np.ndarray
    cube: np.ndarray
    tx_bits: np.ndarray
    rx_bits: np.ndarray


class KirchhoffSum(OnDevice):
    """Sums lit points, relative to `middle_m`, to S-parameters; a context manager.

    `seed` is of the incoherent part of micro-roughness. `counts` are of the last sum: cubes, points
    that all antennas see, skeleton Tx, Rx and frequencies.
    """

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        materials: Sequence[Material],
        middle_m: np.ndarray,
        seed: int,
        device: Device,
    ) -> None:
        super().__init__(device)
        self.array, self.waveform, self.materials, self.seed = array, waveform, materials, seed
        self._middle_m = middle_m.astype(np.float64)
        self._k = waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        self._terms = 3 if any(m.micro_roughness_rms_m > 0 for m in materials) else 2
        self._plain = self._terms == 2 and all(m.conductor and m.coating is None for m in materials)
        self.counts: dict[str, int] = {}

    def _prepare(self) -> None:
        array, up = self.array, self._buffers.upload
        tables = [pattern_table(p) for p in (array.tx_pattern, array.rx_pattern)]
        options = KirchhoffOptions(
            width=self.device.width,
            terms=self._terms,
            materials=not self._plain,
            pattern=array.has_patterns,
        )
        self._program = build(self.device, "kirchhoff.cl", options)
        self._patterns = [up(table.astype(np.float32)) for table in tables]
        self._tables = reflection_legs(self.materials, self.waveform.frequencies_hz)
        places = (array.tx_m - self._middle_m, array.rx_m - self._middle_m)
        self._sides = tuple(
            Side(at, table, side.axes)
            for at, table, side in zip(places, tables, array.sides, strict=True)
        )
        self._antennas = [self._upload_antennas(side, slice(None)) for side in self._sides]

    def _upload_antennas(self, side: Side, chosen: Any) -> _Antennas:
        at_m, axes = side.antennas_m[chosen], side.axes[chosen].astype(np.float32)
        n_padded = -(-len(at_m) // GROUP) * GROUP
        padded = np.minimum(np.arange(n_padded), len(at_m) - 1)
        rows = np.concatenate([*(part.T for part in hi_lo(at_m[padded])), axes[padded].T])
        return _Antennas(n_padded, self._buffers.upload(np.ascontiguousarray(rows)))

    def result(self, lit: LitPoints, progress: Progress | None = None) -> np.ndarray:
        """Return the S-parameters, shape (n_tx, n_rx, n_freq), complex64."""
        array, n_f = self.array, self.waveform.n_freq
        shape = (array.n_tx, array.n_rx, n_f)
        if len(lit.sample) == 0:
            self.counts = {"cubes": 0, "seen_by_all": 0}
            return np.zeros(shape, np.complex64)
        wavelength_m = SPEED_OF_LIGHT_M_PER_S / self.waveform.frequencies_hz[-1]
        cubes = cubes_of(lit.position_m, CUBE_WAVELENGTHS * float(wavelength_m))
        tx_bits, rx_bits = lit.tx[cubes.order], lit.rx[cubes.order]
        points = self._leg_points(lit, cubes, tx_bits, rx_bits)
        of_all = (tx_bits == _all_bits(array.n_tx)).all(axis=1)
        of_all &= (rx_bits == _all_bits(array.n_rx)).all(axis=1)
        if of_all.sum() < FEW_POINTS:
            of_all[:] = False
        self._choose_skeletons(points, of_all)
        sample = lit.sample[cubes.order]
        packed = _packed(points, sample)
        self._full, self._partial = (
            _Group(
                np.searchsorted(cubes.cube[chosen], np.arange(len(cubes.centre_m) + 1)).astype(
                    np.uint32
                ),
                packed[chosen], cubes.cube[chosen], tx_bits[chosen], rx_bits[chosen],
            )
            for chosen in (of_all, ~of_all)
        )  # fmt: skip
        self.counts |= {"cubes": len(cubes.centre_m), "seen_by_all": int(of_all.sum())}
        return self._sum_cubes(cubes, progress)

    def _leg_points(
        self, lit: LitPoints, cubes: PointCubes, tx_bits: np.ndarray, rx_bits: np.ndarray
    ) -> LegPoints:
        centre_m = cubes.centre_m.astype(np.float64)[cubes.cube]
        position_m = lit.position_m[cubes.order].astype(np.float64)
        area_m2 = lit.area_m2[cubes.order].astype(np.float64)
        tx, rx = self._sides
        to_tx, spread_tx = _towards(position_m, tx, tx_bits)
        to_rx, spread_rx = _towards(position_m, rx, rx_bits)
        slope_m2, level_m2 = linear_damping(
            lit.edges_m[cubes.order], to_tx + to_rx, spread_tx + spread_rx
        )
        material = lit.material[cubes.order]
        return LegPoints(position_m - centre_m, centre_m, area_m2, slope_m2, level_m2, material)

    def _choose_skeletons(self, points: LegPoints, of_all: np.ndarray) -> None:
        share = MARGIN * 10.0 ** (TOLERANCE_DB / 20.0) / np.sqrt(3.0)
        tx, rx = self._sides
        args = (self._k, self._tables, self._terms, share)
        self._frequency = frequency_skeleton(points, (tx, rx), *args)
        self._skeletons: list[Decomposition] = []
        if of_all.any():
            full = points[np.flatnonzero(of_all)]
            self._skeletons = [antenna_skeleton(full, side, *args) for side in self._sides]
        names = ("skeleton_tx", "skeleton_rx")
        self.counts = {"skeleton_frequencies": len(self._frequency.skeleton)}
        self.counts |= {
            name: len(part.skeleton) for name, part in zip(names, self._skeletons, strict=False)
        }

    def _sum_cubes(self, cubes: PointCubes, progress: Progress | None) -> np.ndarray:
        """Sum over the cubes, for as many Tx at a time as the device has memory for."""
        array, (tx, rx) = self.array, self._antennas
        n_f = -(-self.waveform.n_freq // FREQUENCIES) * FREQUENCIES
        room = int(CAPTURE_SHARE * self.device.budget_bytes) // (8 * n_f * rx.n_padded)
        step = max(GROUP, min(tx.n_padded, room // GROUP * GROUP))
        data = np.empty((array.n_tx, array.n_rx, self.waveform.n_freq), np.complex64)
        for first in range(0, tx.n_padded, step):
            rows = slice(first, min(first + step, tx.n_padded))
            share = progress
            if step < tx.n_padded:
                share = part_of(progress, rows.start / tx.n_padded, rows.stop / tx.n_padded)
            self._sum_rows(cubes, rows, n_f, data[rows], share)
        return data

    def _sum_rows(
        self,
        cubes: PointCubes,
        rows: slice,
        n_f: int,
        data: np.ndarray,
        progress: Progress | None,
    ) -> None:
        """Write the S-parameters of some Tx, whole groups of them, at all frequencies to `data`."""
        up, u, rx = self._buffers.upload, np.uint32, self._antennas[1]
        n_m, n_cubes = len(self._frequency.skeleton), len(cubes.centre_m)
        tx = self._upload_antennas(self._sides[0], rows)
        fill = n_f - self.waveform.n_freq
        weights = up(np.pad(self._frequency.weights.T, ((0, 0), (0, fill))).astype(np.float32))
        k = np.stack(hi_lo(np.pad(self._k, (0, fill), mode="edge")))
        k_all, k_skeleton = up(k), up(self._k[self._frequency.skeleton].astype(np.float32))
        material = up(self._tables[:, self._frequency.skeleton].astype(np.float32))
        capture = self._buffers.zeros(8 * tx.n_padded * n_f * rx.n_padded)
        per_cube = 8 * tx.n_padded * rx.n_padded * n_m
        at_once = max(1, min(BATCH_BYTES, self._buffers.free_bytes // 4) // per_cube)
        centre = up(cubes.centre_m)
        shared = (centre, k_skeleton, material)
        for first in range(0, n_cubes, at_once):
            count = min(at_once, n_cubes - first)
            total = self._buffers.zeros(per_cube * count)
            if self._skeletons:
                self._add_full(first, count, n_m, tx, rows, shared, total)
            self._add_group(self._partial, first, count, n_m, (tx, rx), shared, total, rows)
            centres = up(cubes.centre_m[first : first + count])
            phases = []
            for side in (tx, rx):
                phases.append(self._buffers.empty(8 * side.n_padded * n_f * count))
                self._program.launch(
                    "centre_phases", (side.n_padded // self.device.width, count), u(side.n_padded),
                    u(n_f), u(count), side.rows, centres, k_all, phases[-1],
                    work=40.0 * n_f,
                )  # fmt: skip
            self._program.launch(
                "add_cubes",
                (n_f // FREQUENCIES, tx.n_padded, rx.n_padded // self.device.width),
                u(count), u(n_m), u(n_f), u(tx.n_padded), u(rx.n_padded), total, weights,
                *phases, capture, work=FREQUENCIES * count * (4.0 * n_m + 16.0),
            )  # fmt: skip
            for buffer in (total, centres, *phases):
                self._buffers.release(buffer)
            if progress is not None:
                progress(first + count, n_cubes)
        sums = self._buffers.read(capture, (tx.n_padded, n_f, 2, rx.n_padded), np.float32)
        for buffer in (capture, weights, k_all, *shared, tx.rows):
            self._buffers.release(buffer)
        sums = sums[: len(data), : self.waveform.n_freq, :, : self.array.n_rx]
        for own, row in zip(data, sums, strict=True):
            # (j k / 4 pi) (lambda / 4 pi), and Gamma = -g g.
            own[:] = (row[:, 0] + 1j * row[:, 1]).T * np.complex64(-1j / (8.0 * np.pi))

    def _add_full(
        self,
        first: int,
        count: int,
        n_m: int,
        tx: _Antennas,
        rows: slice,
        shared: tuple[Any, ...],
        total: Any,
    ) -> None:
        """Add the points that all antennas see, by way of the skeleton antennas."""
        u, width, buffers = np.uint32, self.device.width, self._buffers
        rx = self._antennas[1]
        chosen = [
            self._upload_antennas(side, part.skeleton)
            for side, part in zip(self._sides, self._skeletons, strict=True)
        ]
        few_tx, few_rx = chosen
        weights = []
        spread = zip((tx, rx), chosen, self._skeletons, (rows, slice(None)), strict=True)
        for side, few, part, some in spread:
            own = part.weights[some].T
            fill = ((0, few.n_padded - own.shape[0]), (0, side.n_padded - own.shape[1]))
            weights.append(buffers.upload(np.pad(own, fill).astype(np.float32)))
        sums = buffers.zeros(8 * count * n_m * few_tx.n_padded * few_rx.n_padded)
        self._add_group(self._full, first, count, n_m, chosen, shared, sums)
        wide = buffers.empty(8 * count * n_m * few_tx.n_padded * rx.n_padded)
        n = count * n_m
        self._program.launch(
            "spread_columns", (rx.n_padded // width, few_tx.n_padded, n), u(n), u(few_tx.n_padded),
            u(few_rx.n_padded), u(rx.n_padded), sums, weights[1], wide,
            work=4.0 * few_rx.n_padded,
        )  # fmt: skip
        self._program.launch(
            "spread_rows", (rx.n_padded // width, tx.n_padded // ROWS, n), u(n),
            u(few_tx.n_padded), u(tx.n_padded), u(rx.n_padded), wide, weights[0], total,
            work=4.0 * ROWS * few_tx.n_padded,
        )  # fmt: skip
        for buffer in (sums, wide, *weights, few_tx.rows, few_rx.rows):
            buffers.release(buffer)

    def _add_group(
        self,
        group: _Group,
        first_cube: int,
        n_cubes: int,
        n_m: int,
        antennas: Sequence[_Antennas],
        shared: tuple[Any, ...],
        sums: Any,
        rows: slice = slice(None),
    ) -> None:
        """Add the points of some cubes to their sums at the skeleton frequencies.

        `rows` are the Tx, whole groups, where `antennas` are not all of them.
        """
        centre, k, material = shared
        u, width, buffers = np.uint32, self.device.width, self._buffers
        first, stop = (int(group.start[c]) for c in (first_cube, first_cube + n_cubes))
        if first == stop:
            return
        tx, rx = antennas
        per_point = 8 * self._terms * n_m * (tx.n_padded + rx.n_padded)
        at_once = max(1, min(LEG_BYTES, buffers.free_bytes // 4) // per_point)
        part = slice(first, stop)
        points, cube = buffers.upload(group.points[part]), buffers.upload(group.cube[part])
        groups_of = slice(*(at and at // GROUP for at in (rows.start, rows.stop)))
        bits = [buffers.upload(b) for b in (group.tx_bits[part, groups_of], group.rx_bits[part])]
        starts = buffers.upload(
            (group.start[first_cube : first_cube + n_cubes + 1] - first).astype(np.uint32)
        )
        legs = [
            buffers.empty(8 * self._terms * n_m * side.n_padded * min(at_once, stop - first))
            for side in antennas
        ]
        seed = (u(self.seed & 0xFFFFFFFF), u(self.seed >> 32))
        for at in range(0, stop - first, at_once):
            n = min(at_once, stop - first - at)
            low, high = (int(group.cube[i]) - first_cube for i in (first + at, first + at + n - 1))
            for i, side in enumerate(antennas):
                groups = 0 if group is self._full else side.n_padded // GROUP
                self._program.start(
                    "legs", (side.n_padded // width, n), u(n), u(at), u(side.n_padded), u(n_m),
                    u(groups), u(i == 0), *seed, side.rows, points, cube, centre, bits[i], k,
                    material, self._patterns[i], legs[i], work=60.0 * n_m,
                )  # fmt: skip
            self._program.launch(
                "add_products",
                (tx.n_padded // ROWS, rx.n_padded // width, (high - low + 1) * n_m),
                u(at), u(n), u(low), u(high - low + 1), u(n_cubes), u(n_m), u(tx.n_padded),
                u(rx.n_padded), starts, *legs, sums,
                work=8.0 * ROWS * self._terms * n / (high - low + 1),
            )  # fmt: skip
        for buffer in (points, cube, starts, *bits, *legs):
            buffers.release(buffer)


def _towards(position_m: np.ndarray, side: Side, bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the middle of the antennas that see each point, shape (n, 3), and the RMS
    distance of all antennas from theirs over the distance to it, shape (n,)."""
    middle_m = np.tile(side.antennas_m.mean(axis=0), (len(bits), 1))
    some = np.flatnonzero((bits != _all_bits(len(side.antennas_m))).any(axis=1))
    seen = np.unpackbits(bits[some], axis=1, bitorder="little")[:, : len(side.antennas_m)]
    seen = seen.astype(np.float32)
    middle_m[some] = seen @ side.antennas_m.astype(np.float32) / seen.sum(axis=1)[:, None]
    to = middle_m - position_m
    length = np.maximum(np.sqrt(np.einsum("pa,pa->p", to, to)), 1e-9)
    return to / length[:, None], _radius_m(side.antennas_m) / length


def _radius_m(at_m: np.ndarray) -> float:
    return float(np.sqrt(at_m.var(axis=0).sum()))


def _packed(points: LegPoints, sample: np.ndarray) -> np.ndarray:
    out = np.empty((len(sample), POINT_NUMBERS), np.float32)
    out[:, :3], out[:, 3:6] = points.offset_m, points.area_m2
    out[:, 6] = points.material.astype(np.int32).view(np.float32)
    out[:, 7] = sample.astype(np.uint32).view(np.float32)
    out[:, 8:11], out[:, 11] = points.slope_m2, points.level_m2
    return out


def _all_bits(n_antennas: int) -> np.ndarray:
    """The bits of all antennas, shape (n_groups,), uint8."""
    bits = np.zeros(GROUP * n_groups(n_antennas), np.uint8)
    bits[:n_antennas] = 1
    return np.packbits(bits, bitorder="little")
