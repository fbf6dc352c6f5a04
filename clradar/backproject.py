"""Back-projection: the complex image of a capture (E8 in ``docs/equations.md``)."""

from __future__ import annotations

import numpy as np

from clradar.errors import ModelError
from clradar.imaging import fast
from clradar.imaging.exact import ExactImager
from clradar.imaging.grid_check import warn_of_grid
from clradar.imaging.range_profiles import RangeImager
from clradar.model import Capture, ImageScale, Volume, VoxelGrid, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device

METHODS = ("exact", "range", "fast")
DEFAULT_METHOD = "fast"
WINDOWS = ("rect", "hann", "taylor")


def frequency_weights(window: str | np.ndarray, n_freq: int) -> np.ndarray:
    """Return the weight of each frequency, shape (n_freq,), float64.

    Parameters
    ----------
    window : "rect", "hann", "taylor", or array_like of shape (n_freq,)
        "hann" and "taylor" (nbar 4, -30 dB) are scipy's symmetric windows, with maximum 1, not
        scaled to mean 1.
    """
    if isinstance(window, str):
        checks.one_of("window", window, WINDOWS)
        if window == "rect" or n_freq == 1:
            return np.ones(n_freq)
        from scipy.signal import windows

        values = windows.hann(n_freq) if window == "hann" else windows.taylor(n_freq)
        return np.asarray(values, dtype=np.float64)
    return checks.read_only("window", window, np.float64, (n_freq,))


def backproject(
    capture: Capture,
    grid: VoxelGrid,
    *,
    method: str = DEFAULT_METHOD,
    window: str | np.ndarray = "rect",
    tolerance_db: float | None = None,
    check_grid: bool = True,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Volume:
    """Form the complex image of a capture by back-projection::

        V(v) = 1 / (n_tx n_rx n_freq) sum_{tx, rx, n} w_n s[tx, rx, n]
               exp(+j 2 pi f_n (|v - tx| + |v - rx|) / c)

    Parameters
    ----------
    capture : Capture
    grid : VoxelGrid
        `clradar.place_grid` finds one that shows the object.
    method : "fast", "range" or "exact"
        All take any antennas, frequencies and grid. "exact": the brute-force sum, with an RMS error
        of -80 dB relative to the image's RMS or better. "range": one range profile per pair, read
        by linear interpolation, about -54 dB. "fast": fast factorised back-projection over a tree
        of blocks of voxels, to `tolerance_db`; some hundred times faster than "range" for large
        grids, and the brute-force sum for grids so small that it is the faster.
    window : "rect", "hann", "taylor", or array_like of shape (n_freq,)
        Weights w_n over frequency; see `frequency_weights`.
    tolerance_db : float, optional
        For "fast": RMS error relative to the RMS of the whole image, -80 to -30; default -50.
    check_grid : bool
        Warn where the grid does not fit the capture. Turn it off for many images of one capture, or
        for a grid that is beside the object on purpose.
    device : Device, str or None
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    Volume
        complex64, shape (n_z, n_y, n_x). Of a capture of S-parameters (`Capture.absolute`) it can
        be read in dBsm: `Volume.rcs_dbsm`.

    Raises
    ------
    ModelError
        Unknown method or window; a tolerance out of range, or with a method other than "fast"; an
        image that complex64 cannot hold.
    DeviceError
        The device is missing, out of memory or fails. A volume larger than its memory is tiled.

    Warns
    -----
    ClradarWarning
        The strongest echo lies outside the grid, 15 dB above all that is in it. The object goes on
        beyond a face of the grid. The grid reaches beyond the unambiguous range c / (2 df), and no
        focus tells the echoes in it from their aliases.

    Examples
    --------
    The image of a point reflector has its maximum where the point is.

    >>> import numpy as np
    >>> import clradar
    >>> q = clradar.arrays.qar50()
    >>> array = clradar.AntennaArray(q.tx_m[::12], q.rx_m[::12])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> capture = clradar.room_capture(array, waveform, [], points_m=[[0.01, -0.02, 0.3]])
    >>> grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.28, 0.32), 2e-3)
    >>> image = clradar.backproject(capture, grid, window="hann")
    >>> z, y, x = np.unravel_index(np.abs(image.data).argmax(), grid.shape)
    >>> print(f"{grid.x_m[x]:.3f} {grid.y_m[y]:.3f} {grid.z_m[z]:.3f}")
    0.010 -0.020 0.300
    """
    checks.one_of("backproject: method", method, METHODS)
    checks.instance("backproject: capture", capture, Capture)
    checks.instance("backproject: grid", grid, VoxelGrid)
    weights = frequency_weights(window, capture.waveform.n_freq)
    tolerance_db = _tolerance_db(method, tolerance_db)
    opened = open_device(device)
    imager: ExactImager | RangeImager | fast.FastImager
    if method == "range":
        imager = RangeImager(capture, grid, weights, opened)
    elif method == "fast" and np.prod(grid.shape) * capture.data.size > fast.FEW_TERMS:
        imager = fast.FastImager(capture, grid, weights, opened, tolerance_db)
    else:
        imager = ExactImager(capture, grid, weights, opened)
    data = imager.run(progress)
    data.view(np.float32)[...] /= capture.data.size
    data.flags.writeable = False
    if check_grid:
        warn_of_grid(capture, grid, data, weights, opened)
    meta = {
        "kind": "image",
        "method": method,
        "window": window if isinstance(window, str) else "custom",
        **({"tolerance_db": tolerance_db} if method == "fast" else {}),
        "device": dict(opened.describe()),
        "capture": dict(capture.meta),
    }
    scale = ImageScale(capture.array, capture.waveform, weights) if capture.absolute else None
    try:
        return Volume(data, grid, meta, scale)
    except ModelError as error:
        # Finite samples, each of which complex64 holds, but not their sum.
        largest = float(np.abs(capture.data.view(np.float32)).max())
        raise ModelError(
            "backproject: expected samples whose sum complex64 holds, got an overflow with parts "
            f"of up to {largest:.3g}; scale the capture's data down"
        ) from error


def _tolerance_db(method: str, given: float | None) -> float:
    if given is not None and method != "fast":
        checks.fail("backproject: tolerance_db", "none for a method other than 'fast'", repr(given))
    return fast.checked_tolerance_db("backproject: tolerance_db", given)
