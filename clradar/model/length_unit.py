"""The unit in which lengths are shown, in figures, pages and messages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LengthUnit:
    """The unit that lengths are drawn and labelled in."""

    name: str
    per_m: float


MILLIMETRES, METRES = LengthUnit("mm", 1e3), LengthUnit("m", 1.0)

METRES_FROM_M = 1.0
"""Lengths from here on are shown in metres: millimetres would have four digits and more, and
neighbouring labels run together."""


def unit_for(*lengths_m: float) -> LengthUnit:
    """The unit in which these lengths are shown together."""
    return METRES if max(map(abs, lengths_m)) >= METRES_FROM_M else MILLIMETRES
