"""One side of an array, its Tx or its Rx: where they are, and what each sends to or takes from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.model.pattern import AntennaPattern


@dataclass(frozen=True, slots=True, eq=False)
class AntennaSide:
    """The antennas of one side."""

    antennas_m: np.ndarray  # (n, 3)
    pattern: AntennaPattern | None  # of each about its boresight; None: isotropic with gain 1
    boresight: np.ndarray | None  # (n, 3), unit vectors; None: all along +z
    gain: np.ndarray | None  # (n,), complex128, of amplitude, beside the pattern; None: 1

    @property
    def axes(self) -> np.ndarray:
        """The boresight of every antenna, shape (n, 3)."""
        if self.boresight is None:
            return np.tile([0.0, 0.0, 1.0], (len(self.antennas_m), 1))
        return self.boresight

    def towards(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances to points (m, 3), metres, and complex fields there, both (m, n).

        The field has the gains, without the loss over the distance.
        """
        # Axis by axis: a third of the time of vectors of three.
        x, y, z = (points_m[:, None, axis] - self.antennas_m[:, axis] for axis in range(3))
        length_m = np.sqrt(x * x + y * y + z * z)
        field = np.ones_like(length_m)
        if self.pattern is not None:
            along_m = z
            if self.boresight is not None:
                along_m = (np.stack([x, y, z], axis=2) * self.boresight).sum(axis=2)
            field = self.pattern.amplitude(along_m / np.maximum(length_m, 1e-12))
        return length_m, field if self.gain is None else field * self.gain
