"""A recorded frame of the 94 x 94 imager as a `Capture`."""

from __future__ import annotations

import math
import os
import reprlib
from pathlib import Path
from typing import Any

import numpy as np

from clradar.constants import PLAUSIBLE_HZ
from clradar.files.confined.process import Companion
from clradar.files.failures import clean, fail, reading, regular_file_size, shown
from clradar.files.limits import MAX_FRAME_BYTES, MAX_TIME_STAMPS
from clradar.model import AntennaArray, Capture, Waveform
from measurement_io.antenna_file import CHANNELS, IMAGING, antenna_array
from measurement_io.confined.reading import run
from measurement_io.maroon.folders import (
    ANTENNAS_FILE,
    FrameFile,
    find_frame,
    find_radar_folder,
    frame_file,
)
from measurement_io.maroon.frame_file import EXPECTED, is_plain, read_dictionary

_OWN_KEYS = ("xr", "fvec", "number_of_measurements", "timestamp_us")


def read_frame_file(
    path: Path,
    *,
    rx_file: str | os.PathLike[str] | None = None,
    tx_file: str | os.PathLike[str] | None = None,
    array: AntennaArray | None = None,
    companion: Companion | None = None,
) -> Capture:
    """Return one `.npy` frame: data[tx, rx, freq] of the imaging channels of the file's [rx, tx,
    freq].

    The name of its radar folder, if it lies in one, has to agree with the frequencies inside.
    Antennas are `array`, or those of the files, else of the radar folder, else of
    `clradar.arrays.qar50()`.
    """
    place = frame_file(path)
    if array is None:
        folder = None if place.folder is None else path.absolute().parent.parent
        array = antenna_array(rx_file, tx_file, folder and folder / ANTENNAS_FILE)
    frame = frame_dictionary(path, companion)
    with reading(path, "a recorded frame"):
        xr = _required(path, frame, "xr", "a complex array [rx, tx, freq]")
        fvec = _required(path, frame, "fvec", "the frequencies in Hz")
        _check_agreement(place, xr, fvec, array)
        if xr.shape[0] != array.n_rx:
            xr = xr[IMAGING, IMAGING, :]
        data = _transposed(path, xr)
        meta = _meta(place, frame)
        del frame, xr  # the file's bytes: the record below makes one more copy of the data
        return Capture(data, array, Waveform(fvec), meta)


def frame_dictionary(
    path: Path, companion: Companion | None = None, only: str | None = None
) -> dict[str, Any]:
    """Return what a frame's file holds: numbers, texts, arrays of them, lists of numbers."""
    found = _read(path, companion, only)
    if found["plain"]:
        fail(path, "a recorded frame (a pickled dictionary in a 0-d object array)", found["what"])
    frame: dict[str, Any] = found["frame"]
    return frame


def is_plain_array(path: Path) -> bool:
    """Whether an `.npy` file holds an array of numbers or text, and no pickled object."""
    found: bool = run(
        is_plain, path, expected=EXPECTED, library="numpy", modules=("numpy.lib.format",)
    )
    return found


def _read(path: Path, companion: Companion | None, only: str | None) -> dict[str, Any]:
    size = regular_file_size(path, EXPECTED)
    if size > MAX_FRAME_BYTES:
        fail(path, f"{EXPECTED} of at most {MAX_FRAME_BYTES} bytes", f"{size} bytes")
    found: dict[str, Any] = run(
        read_dictionary, path, only, most_bytes=2 * size, expected=EXPECTED,
        library="Python's pickle", modules=("numpy.lib.format",), companion=companion,
    )  # fmt: skip
    return found


def read_time_stamp(path: Path, companion: Companion | None = None) -> int | float | None:
    """Return the time stamp of a frame, microseconds: the first of several, None if it has none."""
    return _first(
        _time_stamps(frame_dictionary(path, companion, "timestamp_us").get("timestamp_us"))
    )


def first_time_stamp(capture: Capture) -> int | float | None:
    """Return the time stamp of a frame that was read, as `read_time_stamp`."""
    return _first(capture.meta.get("timestamp_us"))


def _first(stamps: Any) -> int | float | None:
    if isinstance(stamps, list):
        return stamps[0] if stamps else None
    return stamps if isinstance(stamps, int | float) else None


def read_folder(
    folder: Path,
    *,
    frame: int = 0,
    variant: str = "raw",
    rx_file: str | os.PathLike[str] | None = None,
    tx_file: str | os.PathLike[str] | None = None,
) -> Capture:
    """Return one frame of a radar folder, or of the folder that holds exactly one."""
    path = find_frame(find_radar_folder(folder), frame, variant)
    return read_frame_file(path, rx_file=rx_file, tx_file=tx_file)


def _required(path: Path, frame: dict[str, Any], key: str, what: str) -> np.ndarray:
    if key not in frame:
        there = ", ".join(sorted(frame)[:20]) or "no readable key"
        fail(path, f"the key '{key}' ({what})", clean(there))
    value = frame[key]
    if not isinstance(value, np.ndarray):
        fail(path, f"'{key}' to be {what}", type(value).__name__)
    return value


def _check_agreement(
    place: FrameFile, xr: np.ndarray, fvec: np.ndarray, array: AntennaArray
) -> None:
    path = place.path
    if xr.dtype.kind != "c":
        fail(path, "'xr' to be complex", f"{xr.dtype}")
    if fvec.dtype.kind not in "iuf" or fvec.ndim != 1:
        fail(path, "'fvec' to be a 1-D array in Hz", f"{fvec.dtype} of shape {fvec.shape}")
    shapes = [(array.n_rx, array.n_tx)]
    if shapes == [(CHANNELS - 2, CHANNELS - 2)]:
        shapes.insert(0, (CHANNELS, CHANNELS))
    if xr.ndim != 3 or xr.shape[:2] not in shapes:
        wanted = " or ".join(f"({n_rx}, {n_tx}, Nf)" for n_rx, n_tx in shapes)
        fail(path, f"'xr' of shape {wanted}", f"shape {xr.shape}")
    counts = {"'xr'": xr.shape[2], "'fvec'": len(fvec)}
    if place.folder is not None:
        counts["the folder's name"] = place.folder.points
    if len(set(counts.values())) > 1:
        fail(
            path,
            "the same number of frequencies everywhere",
            ", ".join(f"{count} in {where}" for where, count in counts.items()),
        )
    if len(fvec) == 0:
        fail(path, "at least one frequency", "none")
    low_hz, high_hz = PLAUSIBLE_HZ
    outside = (fvec < low_hz) | (fvec > high_hz)  # NaN is the waveform's to refuse
    if outside.any():
        fail(
            path,
            f"'fvec' in Hz, between {low_hz:g} and {high_hz:g}",
            f"{float(fvec[outside][0]):g}",
        )
    if place.folder is not None and not place.folder.agrees_hz(float(fvec[0]), float(fvec[-1])):
        fail(
            path,
            f"'fvec' from {place.folder.low_ghz} to {place.folder.high_ghz} GHz, by the folder's "
            "name",
            f"{fvec[0] / 1e9:.9g} to {fvec[-1] / 1e9:.9g} GHz",
        )


def _transposed(path: Path, xr: np.ndarray) -> np.ndarray:
    """Return [rx, tx, freq] as read-only complex64 [tx, rx, freq]."""
    bad = int(xr.size - np.count_nonzero(np.isfinite(xr)))
    if bad:
        fail(path, "finite values in 'xr'", f"{bad} of {xr.size} that are NaN or infinite")
    with np.errstate(over="ignore"):
        data = np.ascontiguousarray(xr.transpose(1, 0, 2), dtype=np.complex64)
    if not np.isfinite(data).all():
        fail(path, "values in 'xr' that complex64 can hold", "an overflow")
    if data is xr or data.base is not None:
        data = data.copy()
    data.flags.writeable = False  # the record keeps a read-only array without another copy
    return data


def _meta(place: FrameFile, frame: dict[str, Any]) -> dict[str, Any]:
    meta: dict[str, Any] = {
        "source": shown(place.path),
        "format": "maroon",
        "frame": place.frame,
        "variant": place.variant,
    }
    if "timestamp_us" in frame:
        meta["timestamp_us"] = _time_stamps(frame["timestamp_us"])
    if "number_of_measurements" in frame:
        given = frame["number_of_measurements"]
        number = _count(given)
        if number is None:
            got = clean(reprlib.repr(given))[:60]
            fail(place.path, "'number_of_measurements' to be a whole number >= 0", got)
        meta["number_of_measurements"] = number
    for key, value in frame.items():
        plain = _plain(value)
        if key not in _OWN_KEYS and plain is not None:
            meta[key if key not in meta else f"file_{key}"] = plain
    return meta


def _count(value: Any) -> int | None:
    """Return a whole number, given as such, as a float, or as an array of one; None for others."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    elif isinstance(value, list | tuple):
        value = value[0] if len(value) == 1 else None
    number = _plain(value)
    if isinstance(number, bool | str) or number is None or number < 0 or number != int(number):
        return None
    return int(number)


def _time_stamps(value: Any) -> int | float | list[int | float] | None:
    """Return one time stamp as a number, several as a list; None for what holds no numbers."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
        value = value.ravel()[: MAX_TIME_STAMPS + 1].tolist()
    if isinstance(value, list | tuple):
        plain = [_plain(stamp) for stamp in value[: MAX_TIME_STAMPS + 1]]
        stamps = [stamp for stamp in plain if isinstance(stamp, int | float)]
        if len(stamps) != len(plain) or len(stamps) > MAX_TIME_STAMPS:
            return None
        return stamps[0] if len(stamps) == 1 else stamps
    stamp = _plain(value)
    return stamp if isinstance(stamp, int | float) else None


def _plain(value: Any) -> str | int | float | None:
    """Return a number or a string as JSON knows it, None for anything else."""
    if isinstance(value, np.ndarray):
        if value.ndim != 0:
            return None
        value = value[()]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return value if abs(value) < 2**64 else None
    if isinstance(value, float) and math.isfinite(value):
        return value
    return None
