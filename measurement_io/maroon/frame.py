"""A recorded frame of the 94 x 94 imager as a `Capture`, and its antennas from text files."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clradar import arrays
from clradar.constants import PLAUSIBLE_HZ
from clradar.files.confined.process import Companion
from clradar.files.failures import clean, fail, read_bytes, reading, regular_file_size, shown
from clradar.files.limits import MAX_ANTENNA_FILE_BYTES
from clradar.model import AntennaArray, Capture, Waveform
from measurement_io.confined.reading import run
from measurement_io.maroon.folders import FrameFile, antennas_file, frame_file
from measurement_io.maroon.frame_file import EXPECTED, is_plain, read_dictionary

CHANNELS = 96  # channels of the instrument; the first and the last are no imaging antennas
IMAGING = slice(1, 95)
FileName = str | os.PathLike[str]
ANTENNAS = "an antenna file (a header x,y,z, then a row of three numbers per antenna)"
_OWN_KEYS = ("xr", "fvec", "number_of_measurements", "timestamp_us")


def read_frame_file(
    path: Path, array: AntennaArray | None = None, companion: Companion | None = None
) -> Capture:
    """Return one `.npy` frame: data[tx, rx, freq] of the imaging channels of its [rx, tx, freq].

    The name of its radar folder, if it lies in one, has to agree with the frequencies inside;
    without `array` it has the antennas.
    """
    place = frame_file(path)
    array = array or antenna_array(None, None, antennas_file(path))
    frame = _dictionary(path, companion)
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


def is_plain_array(path: Path) -> bool:
    """Whether an `.npy` file holds an array of numbers or text, and no pickled object."""
    return run(is_plain, path, expected=EXPECTED, modules=("numpy.lib.format",))


def read_time_stamp(path: Path, companion: Companion | None = None) -> int | float | None:
    """Return the time stamp of a frame, microseconds: the first of several, None if it has none."""
    return first_time_stamp(_dictionary(path, companion, "timestamp_us"))


def first_time_stamp(meta: Mapping[str, Any]) -> int | float | None:
    """Return the time stamp of a frame's `meta`, as `read_time_stamp`."""
    stamps = meta.get("timestamp_us")
    if isinstance(stamps, list):
        stamps = stamps[0] if stamps else None
    return stamps if isinstance(stamps, int | float) else None


def _dictionary(path: Path, companion: Companion | None, only: str | None = None) -> dict[str, Any]:
    size = regular_file_size(path, EXPECTED)
    found: dict[str, Any] = run(
        read_dictionary, path, only, most_bytes=2 * size, expected=EXPECTED,
        modules=("numpy.lib.format",), companion=companion,
    )  # fmt: skip
    return found


def _required(path: Path, frame: dict[str, Any], key: str, what: str) -> np.ndarray:
    if key not in frame:
        there = ", ".join(sorted(frame)[:20]) or "no readable key"
        fail(path, f"the key '{key}' ({what})", clean(there))
    value = frame[key]
    if not isinstance(value, np.ndarray):
        fail(path, f"'{key}' to be {what}", "another type")
    return value


def _check_agreement(
    place: FrameFile, xr: np.ndarray, fvec: np.ndarray, array: AntennaArray
) -> None:
    path, folder = place.path, place.folder
    if xr.dtype.kind != "c":
        fail(path, "'xr' to be complex", f"{xr.dtype}")
    if fvec.dtype.kind not in "iuf" or fvec.ndim != 1 or not len(fvec):
        fail(path, "'fvec' to be a 1-D array in Hz", f"{fvec.dtype} of shape {fvec.shape}")
    shapes = [(array.n_rx, array.n_tx)]
    if shapes == [(CHANNELS - 2, CHANNELS - 2)]:
        shapes.insert(0, (CHANNELS, CHANNELS))
    if xr.ndim != 3 or xr.shape[:2] not in shapes:
        wanted = " or ".join(f"({n_rx}, {n_tx}, Nf)" for n_rx, n_tx in shapes)
        fail(path, f"'xr' of shape {wanted}", f"shape {xr.shape}")
    counts = {"'xr'": xr.shape[2], "'fvec'": len(fvec)}
    if folder is not None:
        counts["the folder's name"] = folder.points
    if len(set(counts.values())) > 1:
        got = ", ".join(f"{count} in {where}" for where, count in counts.items())
        fail(path, "the same number of frequencies everywhere", got)
    low_hz, high_hz = PLAUSIBLE_HZ
    outside = (fvec < low_hz) | (fvec > high_hz)  # NaN is the waveform's to refuse
    if outside.any():
        wanted = f"'fvec' in Hz, between {low_hz:g} and {high_hz:g}"
        fail(path, wanted, f"{float(fvec[outside][0]):g}")
    if folder is not None and not folder.agrees_hz(float(fvec[0]), float(fvec[-1])):
        wanted = f"'fvec' from {folder.low_ghz} to {folder.high_ghz} GHz, by the folder's name"
        fail(path, wanted, f"{fvec[0] / 1e9:.9g} to {fvec[-1] / 1e9:.9g} GHz")


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
        stamps = frame["timestamp_us"]
        meta["timestamp_us"] = None if isinstance(stamps, bool | str) else _single(stamps)
    if "number_of_measurements" in frame:
        given = frame["number_of_measurements"]
        number = _single(given)
        plain = isinstance(number, int | float) and not isinstance(number, bool)
        if not plain or number < 0 or number != int(number):
            got = clean(reprlib.repr(given))[:60]
            fail(place.path, "'number_of_measurements' to be a whole number >= 0", got)
        meta["number_of_measurements"] = int(number)
    for key, value in frame.items():
        if key not in _OWN_KEYS and isinstance(value, bool | str | int | float):
            meta[key if key not in meta else f"file_{key}"] = value
    return meta


def _single(value: Any) -> Any:
    """Return the only item of a list, or what is given."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def read_antenna_file(path: FileName) -> np.ndarray:
    """Return the imaging antennas of a text file, shape (94, 3), metres: 1 to 94 of 96, from 0."""
    positions = read_position_file(path)
    if len(positions) not in (CHANNELS, CHANNELS - 2):
        fail(path, "96 rows (or the 94 imaging ones)", f"{len(positions)} rows")
    return positions[IMAGING] if len(positions) == CHANNELS else positions


def read_position_file(path: FileName) -> np.ndarray:
    """Return the rows below the header `x,y,z` of a text file, shape (n, 3), in the file's unit."""
    path = Path(path)
    content = read_bytes(path, ANTENNAS, MAX_ANTENNA_FILE_BYTES)
    with reading(path, ANTENNAS):
        header, _, rows = content.decode("utf-8-sig").strip().partition("\n")
        if [part.strip().lower() for part in header.split(",")] != ["x", "y", "z"]:
            fail(path, "a first line 'x,y,z'", repr(header[:60]) if header else "an empty file")
        if not rows:
            fail(path, "a row of three numbers per antenna", "none")
        positions = np.loadtxt(rows.splitlines(), delimiter=",", comments=None, ndmin=2)
        if positions.shape[1] != 3:
            fail(path, "three numbers in every row", f"{positions.shape[1]}")
        if not np.isfinite(positions).all():
            fail(path, "finite positions", "NaN or infinite ones")
        return positions


def antenna_array(
    rx_file: FileName | None, tx_file: FileName | None, recorded: Path | None
) -> AntennaArray:
    """Return `qar50()` with the positions of the files; without these the array of `recorded`."""
    known = arrays.qar50()
    if rx_file is None and tx_file is None:
        if recorded is not None and recorded.exists():
            return arrays.read_array(recorded)
        return known
    names = [f"{Path(f).name}" if f is not None else "qar50" for f in (rx_file, tx_file)]
    return AntennaArray(
        known.tx_m if tx_file is None else read_antenna_file(tx_file),
        known.rx_m if rx_file is None else read_antenna_file(rx_file),
        name=f"rx {names[0]}, tx {names[1]}",
    )
