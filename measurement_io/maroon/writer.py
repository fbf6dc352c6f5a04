"""Write a capture in the form in which recorded frames of the 94 x 94 imager are exchanged."""

from __future__ import annotations

import json
import math
import os
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clradar import arrays
from clradar.arrays.array_file import array_text
from clradar.errors import OutputError
from clradar.files.atomic import replacing, write_file
from clradar.files.failures import clean, shown
from clradar.model import AntennaArray, Capture, VoxelGrid, Waveform, checks
from measurement_io.antenna_file import CHANNELS, IMAGING, antenna_array
from measurement_io.maroon.folders import (
    ANTENNAS_FILE,
    CALIBRATION_FILE,
    FRAMES_FOLDER,
    VARIANTS,
    RadarFolderName,
)

_OF_THE_FORM = frozenset(
    ("xr", "fvec", "number_of_measurements", "timestamp_us", "source", "format", "frame", "variant")
)
"""Keys of `Capture.meta` that the reader sets anew, or that mean something else in the form."""


def frequency_entries(waveform: Waveform) -> dict[str, float | int]:
    """Return the frequencies as `calibration.json` has them."""
    low_ghz, high_ghz = (float(f) / 1e9 for f in waveform.frequencies_hz[[0, -1]])
    return {
        "frequency_low_ghz": low_ghz,
        "frequency_high_ghz": high_ghz,
        "frequency_points": waveform.n_freq,
    }


def radar_folder_name(waveform: Waveform) -> str:
    """Return the name of the radar folder that a waveform belongs into."""
    return "_".join(map(str, ("radar", *frequency_entries(waveform).values())))


def save_maroon_frame(
    path: str | os.PathLike[str],
    capture: Capture,
    *,
    frame: int = 0,
    variant: str = "raw",
    timestamp_us: int | Sequence[int] | None = None,
    number_of_measurements: int | None = None,
    channels: int = CHANNELS,
    force: bool = False,
) -> Path:
    """Write one frame into `path/radar_<low>_<high>_<points>/calibrated_data/`.

    Parameters
    ----------
    path : path-like
        The `<object>/<distance>` folder; it is made, with the folders above it, where missing.
    capture : Capture
        Of antennas other than those of `clradar.arrays.qar50()` the folder gets an `antennas.toml`.
    frame : int
        Number of the frame, 0 to 999999.
    variant : {"raw", "emptyfiltered"}
    timestamp_us : number or sequence of numbers, microseconds, optional
        That of `capture.meta` if not given, else 0.
    number_of_measurements : int, optional
        Frames of the whole recording; `frame + 1` if not given.
    channels : {96, 94}
        96 as the instrument writes (channels 0 and 95 are zero), or the imaging antennas alone;
        without a meaning for arrays of other sizes.
    force : bool
        Write into a radar folder that exists already, and replace the frame if it is there.

    Returns
    -------
    Path
        The frame's file. Reading it gives the same bits of data and frequencies, and the numbers
        and strings of `capture.meta`.

    Raises
    ------
    ModelError
        An invalid argument.
    OutputError
        The radar folder exists and `force` is not set, it belongs to another waveform or to
        other antennas, or the system refuses to write.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from measurement_io import open_capture, save_maroon_frame
    >>> array, waveform = clradar.arrays.qar50(), clradar.Waveform([72e9, 77e9, 82e9])
    >>> data = np.full((94, 94, 3), 1 - 1j, np.complex64)
    >>> capture = clradar.Capture(data, array, waveform, {"object": "plate"})
    >>> path = save_maroon_frame("plate/30", capture, frame=7, timestamp_us=1_700_000)
    >>> path.as_posix()
    'plate/30/radar_72.0_82.0_3/calibrated_data/000007.npy'
    >>> read = open_capture(path)
    >>> np.array_equal(read.data, data), read.meta["frame"], read.meta["timestamp_us"]
    (True, 7, 1700000)
    """
    number = checks.whole("save_maroon_frame: frame", frame, 0, 999_999)
    total = number + 1 if number_of_measurements is None else number_of_measurements
    total = checks.whole("save_maroon_frame: number_of_measurements", total, 1)
    variant = checks.one_of("save_maroon_frame: variant", variant, VARIANTS)
    if channels not in (CHANNELS, CHANNELS - 2):
        checks.fail("save_maroon_frame: channels", "96 or 94", repr(channels))
    stamp = time_stamp("save_maroon_frame: timestamp_us", capture, timestamp_us)
    radar = check_target_folder(Path(path)) / radar_folder_name(capture.waveform)
    _make_folders(radar, force=force)
    write_antennas(radar, capture.array)
    _write_calibration(radar / CALIBRATION_FILE, capture.waveform, number)
    target = radar / FRAMES_FOLDER / frame_name(number, variant)
    write_frame_file(target, capture, total, stamp, channels=channels, force=force)
    return target


def write_antennas(radar: Path, array: AntennaArray) -> None:
    """Write the antennas into a radar folder, unless they are the imager's, as in the form."""
    if any((radar / FRAMES_FOLDER).glob("*.npy")):
        there = antenna_array(None, None, radar / ANTENNAS_FILE)
        if there.same_antennas(array):
            return
        raise OutputError(
            f"{shown(radar)}: expected frames of its antennas, '{there.name}' with {there.n_tx} Tx "
            f"and {there.n_rx} Rx, got '{array.name}' with {array.n_tx} Tx and {array.n_rx} Rx, or "
            "with other gains or patterns"
        )
    plain = not (array.has_patterns or array.has_gains)
    if not (plain and array.same_positions(arrays.qar50())):
        write_file(radar / ANTENNAS_FILE, array_text(array).encode("utf-8"), force=True)


def check_target_folder(path: Path) -> Path:
    """Return `path`, or raise if it has the name of the folder that is to be made in it."""
    if RadarFolderName.parse(path.absolute().name) is not None:
        raise OutputError(
            f"{shown(path)}: expected the folder that is to hold the radar folder, got a name of "
            "the latter, which is made by itself"
        )
    return path


def frame_name(number: int, variant: str) -> str:
    """Return the name of a frame's file."""
    return f"{number:06d}.npy" if variant == "raw" else f"{number:06d}_{variant}.npy"


def time_stamp(field: str, capture: Capture, given: Any) -> np.ndarray:
    """Return the time stamps of a frame as the form has them: an array, shape (n,)."""
    value = capture.meta.get("timestamp_us") if given is None else given
    if value is None:
        value = 0
    try:
        stamps = np.atleast_1d(np.asarray(value))
    except ValueError:  # nested lists of different lengths
        stamps = np.empty(0, dtype=object)
    if stamps.ndim != 1 or not stamps.size or stamps.dtype.kind not in "iuf":
        checks.fail(field, "a number of microseconds, or several", repr(value)[:60])
    if stamps.dtype.kind == "f" and not np.isfinite(stamps).all():
        checks.fail(field, "finite numbers", repr(value)[:60])
    return stamps


def write_frame_file(
    target: Path,
    capture: Capture,
    total: int,
    stamp: np.ndarray,
    *,
    channels: int = CHANNELS,
    force: bool = False,
) -> None:
    """Write one `.npy` file, whole or not at all; the arguments are taken as checked."""
    xr = capture.data.transpose(1, 0, 2)
    if channels == CHANNELS and xr.shape[:2] == (CHANNELS - 2, CHANNELS - 2):
        whole = np.zeros((CHANNELS, CHANNELS, capture.waveform.n_freq), np.complex64)
        whole[IMAGING, IMAGING, :] = xr
        xr = whole
    holder = np.empty((), dtype=object)
    holder[()] = {
        "xr": np.ascontiguousarray(xr),
        "fvec": np.array(capture.waveform.frequencies_hz),
        "number_of_measurements": total,
        "timestamp_us": stamp,
        **_carried(capture.meta),
    }
    with replacing(target, force=force) as temporary, open(temporary, "xb") as file:
        header = {"descr": "|O", "fortran_order": False, "shape": ()}
        np.lib.format.write_array_header_1_0(file, header)
        _PortablePickler(file, protocol=3).dump(holder)


_Pickler: Any = pickle._Pickler
"""The one in Python, whose names can be replaced."""


class _PortablePickler(_Pickler):
    """Writes what every numpy reads: numpy 2 knows the names of numpy 1, but not the reverse."""

    def save_global(self, obj: Any, name: str | None = None) -> None:
        module = getattr(obj, "__module__", None) or ""
        if not module.startswith("numpy._core."):
            super().save_global(obj, name)
            return
        old = module.replace("numpy._core.", "numpy.core.", 1)
        self.write(f"c{old}\n{obj.__name__}\n".encode("ascii"))
        self.memoize(obj)


def _carried(meta: Mapping[str, Any]) -> dict[str, str | int | float]:
    """Return the entries of a capture's `meta` for a frame's dictionary: numbers and strings."""
    carried: dict[str, str | int | float] = {}
    for key, value in meta.items():
        if key in _OF_THE_FORM:
            continue
        if isinstance(value, float):
            if math.isfinite(value):
                carried[key] = float(value)
        elif isinstance(value, str) or (isinstance(value, int) and abs(value) < 2**64):
            carried[key] = value
    return carried


def default_grid() -> VoxelGrid:
    """Return the grid that a frame without an image names: where objects of the dataset are."""
    return VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.2, 0.6), (1e-3, 1e-3, 2e-3))


def grid_entry(grid: VoxelGrid | None = None) -> dict[str, Any]:
    """Return the entry of a frame in `calibration.json`: a grid alone, in radar space."""
    grid = default_grid() if grid is None else grid
    x_m, y_m, z_m = -grid.x_m[::-1], grid.y_m, grid.z_m
    ends = {"bb_min": 0, "bb_max": -1}
    box = {name: [float(axis[i]) for axis in (x_m, y_m, z_m)] for name, i in ends.items()}
    return {"volume": {**box, "grid_size": list(grid.counts)}}


def write_calibration(path: Path, waveform: Waveform, frames: Mapping[int, Any]) -> None:
    """Write a new `calibration.json` with the entries of frames."""
    content = {**frequency_entries(waveform), **{f"{n:06d}": frames[n] for n in sorted(frames)}}
    write_file(path, (json.dumps(content, indent=2) + "\n").encode("ascii"), force=False)


def _make_folders(radar: Path, *, force: bool) -> None:
    try:
        if radar.exists() and not force:
            raise OutputError(
                f"{shown(radar)}: exists already; a frame is added or replaced only with force"
            )
        (radar / FRAMES_FOLDER).mkdir(parents=True, exist_ok=True)
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{shown(radar)}: cannot be made: {clean(error)}") from error


def _write_calibration(path: Path, waveform: Waveform, number: int) -> None:
    if not path.exists():
        # The dataset's program asks for the grid of every frame.
        write_calibration(path, waveform, {number: grid_entry()})
        return
    # A recording's own file holds more than these three entries, so it is never rewritten.
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
        agrees = all(there.get(k) == value for k, value in frequency_entries(waveform).items())
    except (OSError, ValueError, AttributeError) as error:
        raise OutputError(f"{shown(path)}: cannot be read: {clean(error)}") from error
    if not agrees:
        raise OutputError(f"{shown(path)}: belongs to another waveform than the capture")
