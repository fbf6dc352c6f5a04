"""Antenna arrays: positions of the transmit and receive antennas."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clradar.constants import PLAUSIBLE_APERTURE_M
from clradar.model import checks
from clradar.model.antenna_side import AntennaSide
from clradar.model.pattern import AntennaPattern
from clradar.model.plausible import check_plausible
from clradar.model.record import Record

GAIN_ROUNDING = 1e-9  # of gains and directions that were written as text and read back


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class AntennaArray(Record):
    """Transmit and receive antennas in the antenna frame: z along boresight, y up, right-handed.

    Apertures are 1 mm to 5 m wide and within 5 m of the origin.

    Parameters
    ----------
    tx_m, rx_m : array_like, shape (n_tx, 3) and (n_rx, 3), float64
    name : str
        In files and figures.
    tx_pattern, rx_pattern : AntennaPattern, optional
        Of all Tx and of all Rx. None: isotropic with gain 1.
    tx_gain, rx_gain : array_like, shape (n_tx,) and (n_rx,), complex128, optional
        Amplitude and phase of each antenna beside its pattern, by which samples are multiplied.
        None: 1. Images take samples as they are: see `Capture.without_gains`.
    tx_boresight, rx_boresight : array_like, shape (n_tx, 3) and (n_rx, 3), float64, optional
        What each antenna's pattern is about; stored as unit vectors. None: +z.

    Examples
    --------
    The middles of the pairs sample the aperture.

    >>> array = clradar.AntennaArray([[-0.07, 0, 0], [0.07, 0, 0]], [[0, 0.07, 0]])
    >>> (array.tx_m + array.rx_m) / 2
    array([[-0.035,  0.035,  0.   ],
           [ 0.035,  0.035,  0.   ]])
    """

    tx_m: np.ndarray
    rx_m: np.ndarray
    name: str = "array"
    tx_pattern: AntennaPattern | None = None
    rx_pattern: AntennaPattern | None = None
    tx_gain: np.ndarray | None = None
    rx_gain: np.ndarray | None = None
    tx_boresight: np.ndarray | None = None
    rx_boresight: np.ndarray | None = None

    def __post_init__(self) -> None:
        self._set_array("tx_m", np.float64, (None, 3))
        self._set_array("rx_m", np.float64, (None, 3))
        checks.text("AntennaArray.name", self.name)
        for side, antennas_m in (("tx", self.tx_m), ("rx", self.rx_m)):
            self._check_side(side, len(antennas_m))
        both_m = np.concatenate([self.tx_m, self.rx_m])
        with np.errstate(over="ignore"):
            extent_m = np.ptp(both_m, axis=0).max()
        if len(both_m) > 2 and extent_m > 0:
            # Two antennas, and all in one place, may be as close together as they like.
            check_plausible("AntennaArray", "an aperture", extent_m, PLAUSIBLE_APERTURE_M)
        away_m = np.abs(both_m).max()
        within = (0.0, PLAUSIBLE_APERTURE_M[1])
        check_plausible("AntennaArray", "a distance from the origin", away_m, within)

    def _check_side(self, side: str, count: int) -> None:
        if (pattern := getattr(self, f"{side}_pattern")) is not None:
            checks.instance(f"AntennaArray.{side}_pattern", pattern, AntennaPattern)
        if getattr(self, f"{side}_gain") is not None:
            gain = self._set_array(f"{side}_gain", np.complex128, (count,))
            if not gain.any():
                checks.fail(f"AntennaArray.{side}_gain", "gains not all of which are 0", "0")
        if getattr(self, f"{side}_boresight") is not None:
            raw = self._set_array(f"{side}_boresight", np.float64, (count, 3))
            with np.errstate(over="ignore"):
                length = np.linalg.norm(raw, axis=1, keepdims=True)
            if not ((length > 0) & (length < np.inf)).all():
                checks.fail(f"AntennaArray.{side}_boresight", "directions", "length 0 or infinite")
            # Unit vectors stay as they are, to the bit, however often they are read and written.
            unit = np.where(np.abs(length - 1) < 1e-12, raw, raw / length)
            unit.flags.writeable = False
            self._set(**{f"{side}_boresight": unit})

    @property
    def n_tx(self) -> int:
        return len(self.tx_m)

    @property
    def n_rx(self) -> int:
        return len(self.rx_m)

    @property
    def has_patterns(self) -> bool:
        """Whether a side has a pattern."""
        return self.tx_pattern is not None or self.rx_pattern is not None

    @property
    def has_gains(self) -> bool:
        """Whether a side has gains."""
        return self.tx_gain is not None or self.rx_gain is not None

    @property
    def sides(self) -> tuple[AntennaSide, AntennaSide]:
        """The Tx and the Rx, each with all that they have.

        :meta private:
        """
        return (
            AntennaSide(self.tx_m, self.tx_pattern, self.tx_boresight, self.tx_gain),
            AntennaSide(self.rx_m, self.rx_pattern, self.rx_boresight, self.rx_gain),
        )

    def with_gains(self, data: np.ndarray) -> np.ndarray:
        """Return samples, shape (n_tx, n_rx, n_freq), complex64, times the gains of both sides.

        :meta private:
        """
        if not self.has_gains:
            return data
        tx, rx = (np.ones(1) if side.gain is None else side.gain for side in self.sides)
        data = data * np.asarray(tx[:, None, None] * rx[:, None], np.complex64)
        data.flags.writeable = False
        return data

    def without_gains(self) -> AntennaArray:
        """Return the same antennas, all of gain 1."""
        return replace(self, tx_gain=None, rx_gain=None)

    def part(self, tx: Any, rx: Any, name: str | None = None) -> AntennaArray:
        """Return some of the antennas, with all that they have.

        Those of each side are given as a slice, indices or bools; `name` is that of before if None.
        """
        name = self.name if name is None else name
        own = {
            f"{side}_{field}": values[which]
            for side, which in (("tx", tx), ("rx", rx))
            for field in ("m", "gain", "boresight")
            if (values := getattr(self, f"{side}_{field}")) is not None
        }
        return replace(self, name=name, **own)

    def refuse_patterns(self, function: str) -> None:
        """Raise a `ModelError` for a function that leaves patterns out.

        :meta private:
        """
        if self.has_patterns:
            checks.fail(
                f"{function}: array",
                "antennas without a pattern, which only estimator='physical' takes (others have "
                "amplitude='spreading' and pattern_exponent)",
                f"tx_pattern={self.tx_pattern!r}, rx_pattern={self.rx_pattern!r}",
            )

    def same_positions(self, other: AntennaArray, tolerance_m: float = 1e-6) -> bool:
        """Whether both arrays have the same antennas in the same order, within `tolerance_m`."""
        return (
            self.tx_m.shape == other.tx_m.shape
            and self.rx_m.shape == other.rx_m.shape
            and bool(np.abs(self.tx_m - other.tx_m).max() <= tolerance_m)
            and bool(np.abs(self.rx_m - other.rx_m).max() <= tolerance_m)
        )

    def same_antennas(self, other: AntennaArray) -> bool:
        """Whether both have the same antennas: positions, gains, patterns and boresights."""

        def same(one: AntennaSide, two: AntennaSide) -> bool:
            ones = np.ones(len(one.antennas_m))
            gain, other_gain = (ones if side.gain is None else side.gain for side in (one, two))
            return (
                one.pattern == two.pattern
                and np.allclose(gain, other_gain, rtol=GAIN_ROUNDING)
                and np.allclose(one.axes, two.axes, rtol=0.0, atol=GAIN_ROUNDING)
            )

        return self.same_positions(other) and all(map(same, self.sides, other.sides))
