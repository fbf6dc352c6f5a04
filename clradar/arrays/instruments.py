"""Antenna arrays of known instruments."""

from __future__ import annotations

import numpy as np

from clradar.model.array import AntennaArray


def qar50() -> AntennaArray:
    """Return the 94 Tx x 94 Rx imager with a 14 cm aperture (QAR50 submodule, 72-82 GHz).

    Rx are 47 at y = -70.5 mm, then 47 at y = +70.5 mm, each row x = -69 … +69 mm in 3 mm steps. Tx
    are 47 at x = -70.5 mm, then 47 at x = +70.5 mm, each column y = -69 … +69 mm in 3 mm steps, but
    that its end elements are at x = -/+72 mm.

    Examples
    --------
    >>> print(1e3 * clradar.arrays.qar50().rx_m.max(axis=0))  # millimetres
    [69.  70.5  0. ]
    """
    steps_m = np.arange(-23, 24) * 3e-3
    edge_m = 0.0705
    zeros = np.zeros_like(steps_m)
    rx_rows = [
        np.stack([steps_m, np.full_like(steps_m, y), zeros], axis=1) for y in (-edge_m, edge_m)
    ]
    tx_columns = []
    for side in (-1.0, 1.0):
        x = np.full_like(steps_m, side * edge_m)
        x[[0, -1]] = side * 0.072
        tx_columns.append(np.stack([x, steps_m, zeros], axis=1))
    return AntennaArray(np.concatenate(tx_columns), np.concatenate(rx_rows), name="qar50")


KNOWN = {"qar50": qar50}
"""Name in files and on the command line -> the function that makes the array."""
