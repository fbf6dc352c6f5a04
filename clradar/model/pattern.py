"""Antenna patterns: gain over the angle to boresight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.record import Record

MOST_GAIN_DB = 100.0
MOST_EXPONENT = 10_000.0
"""cos^q falls to a tenth at 1.2 degrees: a beam narrower than any antenna of an imaging array."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class AntennaPattern(Record):
    """Gain of an antenna over the angle to its boresight, the same all around it.

    The field amplitude, relative to an isotropic antenna without loss, is ``sqrt(10^(gain_dbi /
    10))`` times cos^q of the angle, or times a table over the angle; with neither the same
    everywhere.

    Parameters
    ----------
    gain_dbi : float
        Power gain where cos^q or the table is 1; within 100 dB of 0.
    exponent : float
        q, 0 to 10 000; with q > 0 the field is zero beyond 90 degrees.
    angle_deg : array_like, shape (n,), float64, optional
        Angles of a table, ascending from 0 to 180.
    field : array_like, shape (n,), float64, optional
        Field amplitude at each angle, relative to the gain; at least 0, linear in between.
    """

    gain_dbi: float = 0.0
    exponent: float = 0.0
    angle_deg: np.ndarray | None = None
    field: np.ndarray | None = None

    def __post_init__(self) -> None:
        gain_dbi = checks.real("AntennaPattern.gain_dbi", self.gain_dbi)
        if abs(gain_dbi) > MOST_GAIN_DB:
            checks.fail("AntennaPattern.gain_dbi", f"within {MOST_GAIN_DB:g} dB of 0", gain_dbi)
        exponent = checks.within("AntennaPattern.exponent", self.exponent, 0, MOST_EXPONENT)
        self._set(gain_dbi=gain_dbi, exponent=exponent)
        if self.angle_deg is not None or self.field is not None:
            self._check_table()

    def _check_table(self) -> None:
        name = "AntennaPattern"
        if self.angle_deg is None or self.field is None:
            checks.fail(f"{name}.angle_deg, field", "both or neither", "one of the two")
        if self.exponent > 0:
            checks.fail(f"{name}.exponent", "0 beside a table of angle_deg, field", self.exponent)
        angle_deg = checks.one_axis(f"{name}.angle_deg", self.angle_deg)
        if angle_deg[0] != 0 or angle_deg[-1] != 180:
            found = f"{angle_deg[0]:g} to {angle_deg[-1]:g}"
            checks.fail(f"{name}.angle_deg", "angles from 0 to 180 degrees", found)
        self._set(angle_deg=angle_deg)
        table = self._set_array("field", np.float64, angle_deg.shape)
        if table.min() < 0 or table.max() == 0:
            found = f"{table.min():g} to {table.max():g}"
            checks.fail(f"{name}.field", "amplitudes >= 0, not all of them 0", found)

    def amplitude(self, cos_angle: np.ndarray) -> np.ndarray:
        """Return the field amplitude, float64, over the cosine of the angle to boresight.

        Its square is the power gain.
        """
        cosine = np.clip(np.asarray(cos_angle, dtype=np.float64), -1.0, 1.0)
        top = 10.0 ** (self.gain_dbi / 20.0)
        if self.angle_deg is not None and self.field is not None:
            return top * np.interp(np.rad2deg(np.arccos(cosine)), self.angle_deg, self.field)
        if self.exponent > 0:
            return top * np.maximum(cosine, 0.0) ** self.exponent
        return np.full(cosine.shape, top)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, AntennaPattern) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def _values(self) -> tuple[Any, ...]:
        table = (None if t is None else tuple(t.tolist()) for t in (self.angle_deg, self.field))
        return (self.gain_dbi, self.exponent, *table)
