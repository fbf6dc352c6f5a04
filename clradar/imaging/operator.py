"""The imaging operator, from reflectivity to capture, and its adjoint (E13)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M
from clradar.errors import ModelError
from clradar.imaging import fast
from clradar.imaging.direct_sum import DirectSum, PointSet
from clradar.imaging.fast import (
    FastSum,
    GridPiece,
    PointPiece,
    Report,
    grid_pieces,
    point_pieces,
    reported,
)
from clradar.model import AntennaArray, Capture, Volume, VoxelGrid, Waveform, checks
from clradar.model.plausible import check_plausible
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device

STEPS = 1000  # steps of progress of one application

_Part = FastSum | DirectSum
"""The same for some of the voxels or points each; both add to their results."""


class ImagingOperator:
    """The linear map from reflectivity, of voxels or points, to a capture; and its adjoint::

        s[tx, rx, n] = sum_p rho_p exp(-j 2 pi f_n (|p - tx| + |p - rx|) / c)
        V(p) = sum_{tx, rx, n} s[tx, rx, n] exp(+j 2 pi f_n (|p - tx| + |p - rx|) / c)

    V is the image by `backproject` times the number of samples. See docs/operators.md.

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    grid_or_points : VoxelGrid, or array_like of shape (n_points, 3), float64
        What reflects, within 100 m; points also at antennas.
    tolerance_db : float, optional
        RMS error of captures and images relative to their RMS, -80 to -30; default -50.
    tx_visible, rx_visible : array_like, shape (n_points, n_tx) and (n_points, n_rx), bool, optional
        Whether an antenna sees a point, without which its pairs have no echo from there; not for
        grids. Points hidden from some antennas are summed term by term. None: all see all.
    device
        See `clradar.open_device`.

    Attributes
    ----------
    array, waveform, tolerance_db, device
    grid : VoxelGrid or None
        None for points.
    domain_shape : tuple of ints
        Of the reflectivity: (n_z, n_y, n_x), or (n_points,).
    range_shape : tuple of ints
        (n_tx, n_rx, n_freq).
    """

    def __init__(
        self,
        array: AntennaArray,
        waveform: Waveform,
        grid_or_points: Any,
        *,
        tolerance_db: float | None = None,
        tx_visible: Any = None,
        rx_visible: Any = None,
        device: Device | str | None = None,
    ) -> None:
        checks.instance("ImagingOperator: array", array, AntennaArray)
        checks.instance("ImagingOperator: waveform", waveform, Waveform)
        tolerance_db = fast.checked_tolerance_db("ImagingOperator: tolerance_db", tolerance_db)
        self.array, self.waveform, self.tolerance_db = array, waveform, tolerance_db
        self.range_shape = (array.n_tx, array.n_rx, waveform.n_freq)
        self.device = open_device(device)
        self.grid: VoxelGrid | None = None
        self.domain_shape: tuple[int, ...]
        self._parts: list[_Part]
        if isinstance(grid_or_points, VoxelGrid):
            if tx_visible is not None or rx_visible is not None:
                checks.fail("ImagingOperator: visibility", "points where it is given", "a grid")
            self.grid, self.domain_shape = grid_or_points, grid_or_points.shape
            self._parts = [self._grid_part(grid_or_points)]
        else:
            points_m = _points_m(grid_or_points)
            n = len(points_m)
            tx_seen = _visible("ImagingOperator: tx_visible", tx_visible, (n, array.n_tx))
            rx_seen = _visible("ImagingOperator: rx_visible", rx_visible, (n, array.n_rx))
            self.domain_shape = (n,)
            self._parts = self._point_parts(points_m, tx_seen, rx_seen)

    def _grid_part(self, grid: VoxelGrid) -> _Part:
        n = int(np.prod(grid.shape))
        if self._few(n):
            return self._direct(slice(None), PointSet(n, partial(_voxels_m, grid)))
        return self._fast(grid_pieces(grid))

    def _point_parts(
        self, points_m: np.ndarray, tx_seen: np.ndarray | None, rx_seen: np.ndarray | None
    ) -> list[_Part]:
        """Return the points that all antennas see, and the others."""
        by_all = np.ones(len(points_m), bool)
        for seen in (tx_seen, rx_seen):
            if seen is not None:
                by_all &= seen.all(axis=1)
        if self._few(int(by_all.sum())):
            by_all[:] = False
        parts: list[_Part] = []
        if by_all.all():
            parts.append(self._fast(point_pieces(points_m)))
        elif by_all.any():
            number = np.flatnonzero(by_all)
            parts.append(self._fast(point_pieces(points_m[number], number)))
        if not by_all.all():
            number = np.flatnonzero(~by_all)
            some_m = points_m[number]
            seen_by = [None if seen is None else seen[number] for seen in (tx_seen, rx_seen)]
            points = PointSet(len(number), lambda start, stop: some_m[start:stop], *seen_by)
            parts.append(self._direct(number, points))
        return parts

    def _few(self, n: int) -> bool:
        return n * int(np.prod(self.range_shape)) <= fast.FEW_TERMS

    def _fast(self, pieces: Sequence[GridPiece | PointPiece]) -> FastSum:
        found = FastSum(
            self.array, self.waveform, pieces, self.tolerance_db, self.device, both_ways=True
        )
        found.prepare()
        return found

    def _direct(self, number: Any, points: PointSet) -> DirectSum:
        return DirectSum(self.array, self.waveform, number, points, self.device)

    @property
    def shape(self) -> tuple[int, int]:
        """Samples of a capture, and voxels or points."""
        return int(np.prod(self.range_shape)), int(np.prod(self.domain_shape))

    def forward(self, reflectivity: Any, progress: Progress | None = None) -> np.ndarray:
        """Return the samples of a reflectivity, complex64, shape `range_shape`.

        It is a `Volume` or an array of `domain_shape`.
        """
        field = "ImagingOperator.forward: reflectivity"
        if isinstance(reflectivity, Volume):
            if self.grid is None or not reflectivity.grid.same_voxels(self.grid):
                checks.fail(field, "a volume on the operator's grid", "one on another")
            reflectivity = reflectivity.data
        values = checks.read_only(field, reflectivity, np.complex64, self.domain_shape)
        out = np.zeros(self.range_shape, np.complex64)
        for part, report in self._reported(progress):
            part.forward(values, out, report)
        return _finite(field, out, values)

    def adjoint(self, samples: Any, progress: Progress | None = None) -> np.ndarray:
        """Return the image of samples, complex64, shape `domain_shape`, not scaled.

        They are a `Capture` or an array of `range_shape`.
        """
        field = "ImagingOperator.adjoint: samples"
        if isinstance(samples, Capture):
            same = samples.array.same_positions(self.array)
            if not (same and samples.waveform.same_frequencies(self.waveform)):
                checks.fail(field, "a capture by the operator's array and waveform", "another one")
            samples = samples.data
        values = checks.read_only(field, samples, np.complex64, self.range_shape)
        out = np.zeros(self.domain_shape, np.complex64)
        weights = np.ones(self.waveform.n_freq)
        for part, report in self._reported(progress):
            part.adjoint(values, weights, out, report)
        return _finite(field, out, values)

    def _reported(self, progress: Progress | None) -> Iterator[tuple[_Part, Report]]:
        """Yield each part of the work, and what reports its progress."""
        whole, n = reported(progress, STEPS), len(self._parts)
        for i, part in enumerate(self._parts):
            yield part, lambda share, i=i: whole((i + share) / n)  # type: ignore[misc]

    def as_linear_operator(self) -> Any:
        """Return a `scipy.sparse.linalg.LinearOperator`, for scipy's solvers and PyLops.

        Vectors are raveled reflectivity, [z, y, x] or points, and raveled samples, [tx, rx, freq].
        """
        from scipy.sparse.linalg import LinearOperator

        return LinearOperator(
            dtype=np.complex64,
            shape=self.shape,
            matvec=lambda x: self.forward(np.reshape(x, self.domain_shape)).ravel(),
            rmatvec=lambda y: self.adjoint(np.reshape(y, self.range_shape)).ravel(),
        )


def forward(
    points_m: Any,
    reflectivity: Any,
    array: AntennaArray,
    waveform: Waveform,
    *,
    tolerance_db: float | None = None,
    tx_visible: Any = None,
    rx_visible: Any = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Return what an array records of points that reflect: `ImagingOperator.forward`, once.

    There is one path per point and pair, and no spreading loss.

    Parameters
    ----------
    points_m : array_like, shape (n_points, 3), float64; or VoxelGrid
    reflectivity : array_like, shape (n_points,) or that of the grid, complex64
    array : AntennaArray
    waveform : Waveform
    tolerance_db, tx_visible, rx_visible, device
        As of `ImagingOperator`.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    Capture

    Examples
    --------
    A point alone has unit samples.

    >>> array = clradar.AntennaArray([[-0.05, 0, 0]], [[0.05, 0, 0]])
    >>> capture = clradar.forward([[0, 0, 0.3]], [1.0], array, clradar.Waveform([77e9]))
    >>> print(abs(capture.data).round(4))
    [[[1.]]]
    """
    operator = ImagingOperator(
        array, waveform, points_m,
        tolerance_db=tolerance_db, tx_visible=tx_visible, rx_visible=rx_visible, device=device,
    )  # fmt: skip
    meta = {
        "kind": "forward",
        "tolerance_db": operator.tolerance_db,
        "device": dict(operator.device.describe()),
    }
    return Capture(operator.forward(reflectivity, progress), array, waveform, meta)


def _points_m(given: Any) -> np.ndarray:
    points_m = checks.read_only("ImagingOperator: grid_or_points", given, np.float64, (None, 3))
    farthest_m = np.abs(points_m).max()
    within = (0.0, PLAUSIBLE_RANGE_M[1])
    check_plausible("ImagingOperator", "a distance of the farthest point", farthest_m, within)
    return points_m


def _visible(field: str, given: Any, shape: tuple[int, int]) -> np.ndarray | None:
    if given is None:
        return None
    values = checks.read_only(field, given, np.float32, shape)
    if not np.isin(values, (0.0, 1.0)).all():
        checks.fail(field, "True and False", "other numbers")
    return values.astype(bool)


def _voxels_m(grid: VoxelGrid, start: int, stop: int) -> np.ndarray:
    index = np.unravel_index(np.arange(start, stop), grid.shape)
    return grid.origin_m + grid.spacing_m * np.stack(index[::-1], axis=1)


def _finite(field: str, result: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return the result, or raise: finite numbers, each of which complex64 holds, but not their
    sum."""
    if not np.isfinite(result.view(np.float32)).all():
        largest = float(np.abs(given.view(np.float32)).max())
        raise ModelError(
            f"{field}: expected values whose sum complex64 holds, got an overflow with parts of up "
            f"to {largest:.3g}; scale them down"
        )
    return result
