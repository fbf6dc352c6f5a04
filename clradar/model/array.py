"""Antenna arrays: positions of the transmit and receive antennas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.model import checks
from clradar.model.record import Record


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class AntennaArray(Record):
    """Positions of the transmit and receive antennas in the antenna frame.

    Parameters
    ----------
    tx_m : array_like, shape (n_tx, 3), float64, metres
        Transmit antennas in the antenna frame: z along boresight, y up, right-handed.
    rx_m : array_like, shape (n_rx, 3), float64, metres
        Receive antennas, same frame.
    name : str
        Name in files and figures.

    Raises
    ------
    ModelError
        Wrong shape, empty, NaN or infinite.

    Examples
    --------
    Two transmitters 14 cm apart and one receiver; the middles of the pairs sample the aperture.

    >>> import clradar
    >>> array = clradar.AntennaArray([[-0.07, 0, 0], [0.07, 0, 0]], [[0, 0.07, 0]], name="cross")
    >>> array.n_tx, array.n_rx
    (2, 1)
    >>> (array.tx_m + array.rx_m) / 2
    array([[-0.035,  0.035,  0.   ],
           [ 0.035,  0.035,  0.   ]])
    """

    tx_m: np.ndarray
    rx_m: np.ndarray
    name: str = "array"

    def __post_init__(self) -> None:
        self._set_array("tx_m", np.float64, (None, 3))
        self._set_array("rx_m", np.float64, (None, 3))
        checks.text("AntennaArray.name", self.name)

    @property
    def n_tx(self) -> int:
        return len(self.tx_m)

    @property
    def n_rx(self) -> int:
        return len(self.rx_m)

    def same_positions(self, other: AntennaArray, tolerance_m: float = 1e-6) -> bool:
        """Whether both arrays have the same antennas in the same order, within `tolerance_m`."""
        return (
            self.tx_m.shape == other.tx_m.shape
            and self.rx_m.shape == other.rx_m.shape
            and bool(np.abs(self.tx_m - other.tx_m).max() <= tolerance_m)
            and bool(np.abs(self.rx_m - other.rx_m).max() <= tolerance_m)
        )
