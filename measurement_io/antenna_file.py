"""Antenna positions as text: comma-separated x, y, z in metres, one antenna per line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from clradar import arrays
from clradar.files.failures import fail, read_bytes, reading
from clradar.files.limits import MAX_ANTENNA_FILE_BYTES
from clradar.model import AntennaArray

CHANNELS = 96
"""Channels of the instrument; the first and the last are no imaging antennas."""

IMAGING = slice(1, 95)
_EXPECTED = "an antenna file (a header x,y,z, then a row of three numbers per antenna)"


def read_antenna_file(path: str | os.PathLike[str]) -> np.ndarray:
    """Return the imaging antennas of a text file, shape (94, 3), metres, in the antenna frame.

    Of 96 rows below the header `x,y,z` these are rows 1 to 94 (counted from 0); or it has those
    alone.
    """
    positions = read_position_file(path)
    if len(positions) not in (CHANNELS, CHANNELS - 2):
        fail(path, "96 rows (or the 94 imaging ones)", f"{len(positions)} rows")
    return positions[IMAGING] if len(positions) == CHANNELS else positions


def read_position_file(path: str | os.PathLike[str]) -> np.ndarray:
    """Return the rows below the header `x,y,z` of a text file, shape (n, 3), in the file's unit."""
    path = Path(path)
    content = read_bytes(path, _EXPECTED, MAX_ANTENNA_FILE_BYTES)
    with reading(path, _EXPECTED):
        header, _, rows = content.decode("utf-8-sig").strip().partition("\n")
        if [part.strip().lower() for part in header.split(",")] != ["x", "y", "z"]:
            fail(path, "a first line 'x,y,z'", repr(header[:60]) if header else "an empty file")
        if not rows.strip():
            return np.empty((0, 3))
        positions = np.loadtxt(rows.splitlines(), delimiter=",", comments=None, ndmin=2)
        if positions.shape[1] != 3:
            fail(path, "three numbers in every row", f"{positions.shape[1]}")
        if not np.isfinite(positions).all():
            fail(path, "finite positions", "NaN or infinite ones")
        return positions


def antenna_array(
    rx_file: str | os.PathLike[str] | None,
    tx_file: str | os.PathLike[str] | None,
    recorded: Path | None = None,
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
