"""A hand's shape: length, breadth, lengths of the fingers, girth; and what adults have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from clradar.model import checks

# Beyond these the bones no longer fit into the flesh.
_LENGTH_LIMITS_M = (0.12, 0.26)
_BREADTH_LIMITS_M = (0.06, 0.12)
_FACTOR_LIMITS = (0.7, 1.3)

N_DIGITS = 5


@dataclass(frozen=True, slots=True)
class HandShape:
    """A hand's size and proportions; the defaults are an average adult's.

    Parameters
    ----------
    length_m : float, metres
        From the wrist crease to the tip of the straight middle finger.
    breadth_m : float, metres
        Across the knuckles of index and little finger.
    finger_lengths : tuple of 5 floats
        Lengths of thumb, index, middle, ring and little finger, relative to those that an average
        hand scaled to this length has. The palm gives way: `length_m` holds for any of them.
    girth : float
        Thickness of palm and fingers, relative to that of an average hand of this breadth.
    """

    length_m: float = 0.1874
    breadth_m: float = 0.0856
    finger_lengths: tuple[float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0)
    girth: float = 1.0

    def __post_init__(self) -> None:
        for name, limits in (("length_m", _LENGTH_LIMITS_M), ("breadth_m", _BREADTH_LIMITS_M)):
            object.__setattr__(self, name, _within(name, getattr(self, name), limits, " m"))
        lengths = checks.read_only(
            "HandShape.finger_lengths", self.finger_lengths, np.float64, (N_DIGITS,)
        )
        factors = tuple(_within("finger_lengths", f, _FACTOR_LIMITS, "") for f in lengths.tolist())
        object.__setattr__(self, "finger_lengths", factors)
        object.__setattr__(self, "girth", _within("girth", self.girth, _FACTOR_LIMITS, ""))


def _within(name: str, value: object, limits: tuple[float, float], unit: str) -> float:
    label = f"HandShape.{name}"
    number = checks.real(label, value)
    if not limits[0] <= number <= limits[1]:
        checks.fail(label, f"a number in [{limits[0]:g}, {limits[1]:g}]{unit}", f"{number:g}{unit}")
    return number


AVERAGE = HandShape()

ADULT_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "length_m": (0.165, 0.2106),
        "breadth_m": (0.0734, 0.0976),
        "finger_lengths": (0.93, 1.07),
        "girth": (0.9, 1.1),
    }
)
"""Lowest and highest value of each field of `HandShape` that `random_shape` gives."""


def random_shape(rng: np.random.Generator) -> HandShape:
    """Return an adult's hand, drawn from a generator whose state alone decides."""
    draw = {name: rng.uniform(*ADULT_RANGES[name]) for name in ("length_m", "breadth_m", "girth")}
    lengths = tuple(rng.uniform(*ADULT_RANGES["finger_lengths"], N_DIGITS).tolist())
    return HandShape(finger_lengths=lengths, **draw)
