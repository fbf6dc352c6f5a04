"""Back-projection: the complex image of a capture (E8 in ``docs/equations.md``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from clradar.imaging.frame_imager import DEFAULT_METHOD, METHODS, FrameImager
from clradar.imaging.grid_check import warn_of_grid
from clradar.imaging.memory import BYTES_OF_SEVERAL, check_memory
from clradar.imaging.several_captures import KeptCaptures, mean_over_pairs
from clradar.imaging.windows import WINDOWS, frequency_weights
from clradar.model import Capture, Volume, VoxelGrid, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device

__all__ = ["METHODS", "WINDOWS", "backproject", "frequency_weights"]


def backproject(
    capture: Capture | Iterable[Capture],
    grid: VoxelGrid,
    *,
    method: str = DEFAULT_METHOD,
    window: str | np.ndarray = "rect",
    tolerance_db: float | None = None,
    check_grid: bool = True,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Volume:
    """Form the complex image of a capture by back-projection (E8 in docs/equations.md)::

        V(v) = 1 / (n_tx n_rx n_freq) sum_{tx, rx, n} w_n s[tx, rx, n]
               exp(+j 2 pi f_n (|v - tx| + |v - rx|) / c)

    For many captures by one radar make one `clradar.FrameImager`.

    Parameters
    ----------
    capture : Capture, or iterable of Capture
        Of several, such as clusters, the sum goes over all pairs; one is held at a time.
    grid : VoxelGrid
        `clradar.place_grid` finds one.
    method : "fast", "range" or "exact"
        "exact": this sum, to -80 dB of the image's RMS or better. "range": one range profile per
        pair, read by linear interpolation, about -54 dB. "fast": over a tree of blocks of voxels,
        to `tolerance_db`; some hundred times faster for large grids.
    window : "rect", "hann", "taylor", or array_like of shape (n_freq,)
        Weights w_n over frequency.
    tolerance_db : float, optional
        For "fast": RMS error relative to the image's RMS, -80 to -30; default -50.
    check_grid : bool
        Warn where the grid does not fit the capture (docs/messages.md); off for many images of one
        capture, or a grid that is beside the object on purpose.
    device
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    Volume
        complex64, shape (n_z, n_y, n_x). Of one capture of S-parameters it can be read in dBsm. Of
        several `meta["capture"]` is the list of theirs.

    Raises
    ------
    ModelError
        Also where this machine's memory is too small: 9 bytes per voxel, of several captures 24.
        The device's may be smaller.

    Examples
    --------
    The maximum is where the point is.

    >>> array = clradar.arrays.qar50().part(slice(None, None, 12), slice(None, None, 12))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> capture = clradar.room_capture(array, waveform, [], points_m=[[0.01, -0.02, 0.3]])
    >>> grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.28, 0.32), 2e-3)
    >>> image = clradar.backproject(capture, grid, window="hann")
    >>> z, y, x = np.unravel_index(np.abs(image.data).argmax(), grid.shape)
    >>> print(f"{grid.x_m[x]:.3f} {grid.y_m[y]:.3f} {grid.z_m[z]:.3f}")
    0.010 -0.020 0.300
    """
    if not isinstance(capture, Capture):
        way = {"method": method, "window": window, "tolerance_db": tolerance_db, "device": device}
        return _of_all(capture, grid, way, progress, check_grid=check_grid)
    with FrameImager(
        capture.array, capture.waveform, grid,
        method=method, window=window, tolerance_db=tolerance_db, device=device,
    ) as imager:  # fmt: skip
        imager.form(capture, progress)
        volume = imager.volume()
    if check_grid:
        warn_of_grid(capture, grid, volume.data, imager.weights, imager.device)
    return volume


def _of_all(
    captures: Iterable[Capture],
    grid: VoxelGrid,
    way: dict[str, Any],
    progress: Progress | None,
    *,
    check_grid: bool,
) -> Volume:
    """The image of all pairs of several captures: the mean of theirs, weighted by their terms."""
    if isinstance(captures, str) or not isinstance(captures, Iterable):
        checks.instance("backproject: capture", captures, Capture)
    check_memory(grid, BYTES_OF_SEVERAL)
    metas: list[Mapping[str, Any]] = []
    kept = KeptCaptures()

    def images() -> Iterator[tuple[np.ndarray, int]]:
        for capture in captures:
            checks.instance("backproject: capture", capture, Capture)
            image = backproject(capture, grid, check_grid=False, progress=progress, **way)
            metas.append(image.meta)
            kept.add(capture)
            yield image.data, capture.data.size
            del image  # before the next is formed

    data = mean_over_pairs(images(), grid.shape)
    if not metas:
        checks.fail("backproject: capture", "at least one capture", "none")
    if check_grid:
        window = frequency_weights(way["window"], kept.captures[0].waveform.n_freq)
        warn_of_grid(kept, grid, data, window, open_device(way["device"]))
    data.flags.writeable = False
    return Volume(data, grid, {**metas[-1], "capture": [meta["capture"] for meta in metas]})
