"""The physical simulation of a hand against the dense sum over the same points in numpy."""

from __future__ import annotations

import numpy as np

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.hand import hand_mesh
from clradar.tracing.quadrature import LitQuadrature
from clradar.tracing.settings import resolve_settings
from core.timing import ARRAY, WAVEFORM, Row, interleaved_s, relative_rms_db

PART_POINTS = 4096
"""Points of a product of the dense sum: 12 MB, which is a third faster than all at a time."""


class PhysicalHand:
    """A hand of metal and the points of it that antennas see.

    Parameters
    ----------
    device : Device
    samples_per_mm2 : float
    n_dense : int
        Frequencies of the dense sum, of the waveform's.
    """

    def __init__(self, device: clradar.Device, samples_per_mm2: float, n_dense: int) -> None:
        self.scene, self.device = clradar.Scene.from_mesh(hand_mesh("F")), device
        self.settings = resolve_settings(estimator="physical", samples_per_mm2=samples_per_mm2)
        with LitQuadrature(self.scene, ARRAY, self.settings, device) as quadrature:
            lit = quadrature.lit_points()
            position_m = lit.position_m.astype(np.float64) + quadrature.middle_m
        self.n_points = len(position_m)
        self.chosen = np.linspace(0, WAVEFORM.n_freq - 1, n_dense).astype(int)
        self._legs = []
        for at_m, bits in ((ARRAY.tx_m, lit.tx), (ARRAY.rx_m, lit.rx)):
            seen = np.unpackbits(bits, axis=1, bitorder="little")[:, : len(at_m)]
            to = at_m - position_m[:, None]
            length = np.linalg.norm(to, axis=2)
            along = np.einsum("pxa,pa->px", to, lit.area_m2) / length
            field = seen / length
            self._legs.append((length, np.stack([along * field, field]).astype(np.float32)))

    def ours(self) -> np.ndarray:
        """The whole simulation, of the scene to all frequencies."""
        return clradar.simulate(
            self.scene, ARRAY, WAVEFORM, settings=self.settings, device=self.device
        ).data

    def dense(self) -> np.ndarray:
        """The sum at some frequencies: phase matrices, and a complex product for each.

        Lengths, angles and what is visible are given, and parts of the points stay in the cache.
        """
        out = np.zeros((ARRAY.n_tx, ARRAY.n_rx, len(self.chosen)), np.complex64)
        for i, f in enumerate(self.chosen):
            for start in range(0, self.n_points, PART_POINTS):
                tx, rx = (self._waves(side, f, start) for side in self._legs)
                out[:, :, i] += tx.reshape(-1, ARRAY.n_tx).T @ rx[::-1].reshape(-1, ARRAY.n_rx)
        return out * np.complex64(-1j / (8 * np.pi))

    @staticmethod
    def _waves(side: tuple[np.ndarray, np.ndarray], f: int, start: int) -> np.ndarray:
        length, field = (column[..., start : start + PART_POINTS, :] for column in side)
        cycles = length * (WAVEFORM.frequencies_hz[f] / SPEED_OF_LIGHT_M_PER_S)
        angle = (2 * np.pi * (cycles - np.round(cycles))).astype(np.float32)
        wave = np.empty(angle.shape, np.complex64)
        wave.real, wave.imag = np.cos(angle), -np.sin(angle)
        return np.asarray(field * wave)


def physical(device: clradar.Device, repeats: int, samples_per_mm2: float) -> list[Row]:
    """Our whole simulation, and the dense sum at two frequencies times their number."""
    hand = PhysicalHand(device, samples_per_mm2, 2)
    error = relative_rms_db(hand.ours()[:, :, hand.chosen], hand.dense())
    times_s = interleaved_s([hand.ours, hand.dense], repeats)
    share = WAVEFORM.n_freq / len(hand.chosen)
    ours_s, dense_s = np.median(times_s, axis=0)
    ratio = float(np.median(share * times_s[:, 1] / times_s[:, 0]))
    return [
        Row(
            f"physical simulation of a hand, {hand.n_points} lit points",
            f"{ours_s:.2f} s, all of it",
            f"numpy, a complex GEMM per frequency, sum alone: {share * dense_s:.1f} s "
            f"({len(hand.chosen)} of {WAVEFORM.n_freq} frequencies timed)",
            ratio,
            f"{error:.0f} dB between them; the peer leaves out the phase over a triangle, E12",
        )
    ]
