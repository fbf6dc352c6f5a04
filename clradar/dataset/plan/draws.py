"""Random variables of a plan, and one stream of random numbers for each quantity of a sample."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

KINDS = {"uniform": "[low, high]", "normal": "[mean, standard deviation]", "choice": "[a, b, ...]"}
"""Distributions, and the parameters that a plan gives for each."""

SIGMAS = 6.0
"""So many standard deviations of a normal draw have to be within the limits of a plan; 1 in 500
million draws is beyond, and not cut."""


@dataclass(frozen=True, slots=True)
class Draw:
    """A number, or the distribution that it is drawn from for every sample.

    Attributes
    ----------
    kind : "fixed", "uniform", "normal" or "choice"
    values : tuple of float
        The number; low and high; mean and standard deviation; or the numbers to choose from, with
        equal probabilities.
    """

    kind: str
    values: tuple[float, ...]

    def draw(self, random: np.random.Generator) -> float:
        """Return one draw."""
        if self.kind == "fixed":
            return self.values[0]
        if self.kind == "uniform":
            return float(random.uniform(self.values[0], self.values[1]))
        if self.kind == "normal":
            return float(random.normal(self.values[0], self.values[1]))
        return self.values[int(random.integers(len(self.values)))]

    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest value; of a normal draw `SIGMAS` about the mean."""
        if self.kind == "normal":
            mean, deviation = self.values
            return mean - SIGMAS * deviation, mean + SIGMAS * deviation
        return min(self.values), max(self.values)

    def to_plain(self) -> Any:
        """Return it in the syntax of plans."""
        return self.values[0] if self.kind == "fixed" else {self.kind: list(self.values)}


def fixed(value: float) -> Draw:
    return Draw("fixed", (value,))


def stream(seed: int, index: int, quantity: str) -> np.random.Generator:
    """Return the random numbers of one quantity, such as "placement.x_mm", of one sample.

    They depend on the plan's seed, the sample's index and the quantity's name alone, not on other
    quantities of the plan, nor on the number of samples or the order in which they are made.

    Notes
    -----
    PCG64 from ``SeedSequence(seed, spawn_key=(index, crc32(quantity)))``.
    """
    key = (index, zlib.crc32(quantity.encode("utf-8")))
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
