"""The arrays of a record by name, as .npz (numpy) and .mat (MATLAB v5) files hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import OutputError
from clradar.files.failures import shown
from clradar.files.json_text import to_json
from clradar.model import Capture, DepthMap, Volume

MAT_BYTES = 2**31 - 2**16
"""Of one array: more does not fit the 32-bit sizes of MATLAB v5."""


def arrays_of(record: Capture | Volume | DepthMap) -> dict[str, Any]:
    """Return arrays and texts under the names that they have in a native file."""
    if isinstance(record, Capture):
        return {
            "data": record.data,
            "tx_m": record.array.tx_m,
            "rx_m": record.array.rx_m,
            "frequency_hz": record.waveform.frequencies_hz,
            "array_name": record.array.name,
            "axes": "tx, rx, frequency_hz",
            "provenance": to_json("Capture.meta", record.meta),
        }
    if isinstance(record, Volume):
        grid = record.grid
        return {
            "data": record.data,
            "x_m": grid.x_m,
            "y_m": grid.y_m,
            "z_m": grid.z_m,
            "axes": "z_m, y_m, x_m",
            "provenance": to_json("Volume.meta", record.meta),
        }
    return {
        "depth_m": record.depth_m,
        "amplitude": record.amplitude,
        "x_m": record.x_m,
        "y_m": record.y_m,
        "axes": "y_m, x_m",
        "dynamic_range_db": record.dynamic_range_db,
    }


def write_npz(path: Path, record: Capture | Volume | DepthMap) -> None:
    """Write an .npz file, not compressed; texts are 0-d arrays."""
    with open(path, "xb") as file:
        np.savez(file, **arrays_of(record))


def require_mat(target: Path, record: Capture | Volume | DepthMap) -> None:
    """Raise `OutputError` where an array is larger than a MATLAB v5 file can hold."""
    for name, value in arrays_of(record).items():
        if isinstance(value, np.ndarray) and value.nbytes > MAT_BYTES:
            raise OutputError(
                f"{shown(target)}: expected at most {MAT_BYTES} bytes in an array of a .mat file, "
                f"got {value.nbytes} in '{name}'; a .npz file holds more"
            )


def write_mat(path: Path, record: Capture | Volume | DepthMap) -> None:
    """Write a MATLAB v5 file; an axis is a column."""
    from scipy.io import savemat

    with open(path, "xb") as file:
        savemat(file, arrays_of(record), do_compression=True, oned_as="column")
