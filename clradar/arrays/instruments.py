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
    row_m = np.stack([steps_m, np.full(47, 0.0705), np.zeros(47)], axis=1)
    column_m = row_m[:, [1, 0, 2]]
    column_m[[0, -1], 0] = 0.072
    tx_m = np.concatenate([column_m * [-1, 1, 1], column_m])
    return AntennaArray(tx_m, np.concatenate([row_m * [1, -1, 1], row_m]), name="qar50")


KNOWN = {"qar50": qar50}  # name in files and on the command line -> what makes the array
