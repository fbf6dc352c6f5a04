"""A hand's shape: length, breadth, lengths of the fingers, girth; and their spread among adults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from clradar.model import checks
from clradar.model.record import Record

# Beyond these the bones no longer fit into the flesh.
LENGTH_LIMITS_M = (0.12, 0.26)
BREADTH_LIMITS_M = (0.06, 0.12)
FACTOR_LIMITS = (0.7, 1.3)

N_DIGITS = 5


@dataclass(frozen=True, slots=True)
class HandShape(Record):
    """A hand's size and proportions; the defaults are an average adult's.

    Parameters
    ----------
    length_m : float
        From the wrist crease to the tip of the straight middle finger.
    breadth_m : float
        Across the knuckles of index and little finger.
    finger_lengths : tuple of 5 floats
        Of thumb, index, middle, ring and little finger, relative to those that an average hand
        scaled to this length has. `length_m` holds for any of them: the palm takes the rest.
    girth : float
        Thickness of palm and fingers, relative to that of an average hand of this breadth.
    """

    length_m: float = 0.1874
    breadth_m: float = 0.0856
    finger_lengths: tuple[float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0)
    girth: float = 1.0

    def __post_init__(self) -> None:
        for name, limits_m in (("length_m", LENGTH_LIMITS_M), ("breadth_m", BREADTH_LIMITS_M)):
            value = getattr(self, name)
            self._set(**{name: checks.within(f"HandShape.{name}", value, *limits_m, " m")})
        self._set(girth=checks.within("HandShape.girth", self.girth, *FACTOR_LIMITS))
        given, field = self.finger_lengths, "HandShape.finger_lengths"
        lengths = checks.read_only(field, given, np.float64, (N_DIGITS,)).tolist()
        self._set(finger_lengths=tuple(checks.within(field, f, *FACTOR_LIMITS) for f in lengths))


AVERAGE = HandShape()

ADULT_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "length_m": (0.1650, 0.2106),
        "breadth_m": (0.0734, 0.0976),
        "finger_lengths": (0.94, 1.06),
        "girth": (0.91, 1.09),
    }
)
"""Lowest and highest value of each field of `HandShape` that `random_shape` returns.

Length and breadth go from the 5th percentile of women to the 95th of men (docs/poses.md). Finger
lengths and girth are two and a half and two standard deviations, respectively, to either side.
"""

# Mean and standard deviation of length and breadth, millimetres: women, men.
_POPULATIONS_MM = (((180.5, 9.7), (79.4, 3.8)), ((193.8, 9.8), (90.4, 4.2)))

# Correlation of length and breadth within a sex.
_LENGTH_BREADTH_CORRELATION = 0.6

# The ratio of two fingers' lengths has a standard deviation of about 0.035 (index to ring finger:
# Manning et al., Human Reproduction 13(11), 1998), so each has 1 / sqrt(2) of that.
_FINGER_LENGTH_SIGMA = 0.024

# Breadths of fingers have standard deviations of 6 to 7 % (Garrett 1971, Greiner 1991). The hand's
# breadth with its 4.7 % accounts for part of it.
_GIRTH_SIGMA = 0.045


def random_shape(rng: np.random.Generator) -> HandShape:
    """Draw an adult's hand within `ADULT_RANGES`; docs/poses.md has the distribution.

    Examples
    --------
    >>> round(1e3 * clradar.hand.random_shape(np.random.default_rng(1)).length_m)  # millimetres
    188
    """
    checks.instance("random_shape: rng", rng, np.random.Generator)
    length, breadth = _POPULATIONS_MM[int(rng.integers(2))]
    rest = np.sqrt(1.0 - _LENGTH_BREADTH_CORRELATION**2)
    while True:
        normal = rng.standard_normal(3 + N_DIGITS)
        together = _LENGTH_BREADTH_CORRELATION * normal[0] + rest * normal[1]
        drawn = {
            "length_m": (length[0] + length[1] * normal[0]) * 1e-3,
            "breadth_m": (breadth[0] + breadth[1] * together) * 1e-3,
            "finger_lengths": 1.0 + _FINGER_LENGTH_SIGMA * normal[3:],
            "girth": 1.0 + _GIRTH_SIGMA * normal[2],
        }
        ranges = ((drawn[name], *limits) for name, limits in ADULT_RANGES.items())
        if all(np.all((low <= value) & (value <= high)) for value, low, high in ranges):
            return HandShape(**drawn)
