"""Captures of calibration targets by an instrument with errors that are known."""

from dataclasses import dataclass, replace

import numpy as np
from shapes import plate

import clradar
from calibration import response
from calibration.channels.targets import Target
from clradar import AntennaArray, Capture, ChannelResponse, Waveform

SNR_DB = 20.0
DEAD_TX, DEAD_RX = (3, 40), (17,)

QAR50 = clradar.arrays.qar50()
HALF = AntennaArray(QAR50.tx_m[::2], QAR50.rx_m[::2], "every second")
SMALL = AntennaArray(QAR50.tx_m[::4], QAR50.rx_m[::4], "every fourth")


@dataclass(frozen=True)
class Instrument:
    """Channels with errors, and a source of noise."""

    array: AntennaArray
    waveform: Waveform
    channels: ChannelResponse
    rng: np.random.Generator

    def record(self, ideal: np.ndarray, snr_db: float = SNR_DB) -> Capture:
        """Return a capture of what ideal channels would record; the ratio is that of samples."""
        frequencies_hz = self.waveform.frequencies_hz
        tx = self.channels.tx_response(frequencies_hz)
        data = ideal * tx[:, None] * self.channels.rx_response(frequencies_hz)
        level = np.sqrt(np.mean(np.abs(ideal) ** 2)) * 10 ** (-snr_db / 20)
        return Capture(data + level * self.noise(data.shape), self.array, self.waveform)

    def noise(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return complex white noise of power 1."""
        re, im = self.rng.normal(scale=np.sqrt(0.5), size=(2, *shape))
        return re + 1j * im

    def record_target(self, target: Target, snr_db: float = SNR_DB) -> Capture:
        return self.record(response(target, self.array, self.waveform), snr_db)


def instrument(
    seed: int,
    array: AntennaArray = QAR50,
    n_freq: int = 32,
    dead_tx: tuple[int, ...] = (),
    dead_rx: tuple[int, ...] = (),
    common_delay_s: float = 0.0,
) -> Instrument:
    """Return an instrument: gains +-3 dB, any phase, delays +-20 ps, all uniform."""
    waveform = Waveform.sfcw(72e9, 82e9, n_freq)
    drawn = clradar.draw_channels(array, waveform, seed=seed, dead_tx=dead_tx, dead_rx=dead_rx)
    channels = replace(
        drawn,
        tx_delay_s=drawn.tx_delay_s + common_delay_s / 2,
        rx_delay_s=drawn.rx_delay_s + common_delay_s / 2,
    )
    return Instrument(array, waveform, channels, np.random.default_rng(seed))


def edge_array(n: int) -> AntennaArray:
    """n Tx on the left and right, n Rx on the lower and upper edge of a 14 cm square."""
    along = np.tile(np.linspace(-0.069, 0.069, n // 2), 2)
    across = np.repeat([-0.0705, 0.0705], n // 2)
    zero = np.zeros(n)
    return AntennaArray(
        np.stack([across, along, zero], axis=1), np.stack([along, across, zero], axis=1)
    )


def two_plates(cells: int, wavy_m: float = 0.0) -> clradar.Scene:
    """Squares of 5 cm side by side, whose parts are left and right."""
    vertices_m, faces = plate(0.05, 0.3, cells, wavy_m)
    sides = [clradar.Scene(vertices_m + np.array([x_m, 0, 0]), faces) for x_m in (-0.03, 0.03)]
    both = clradar.Scene.combine(sides)
    return clradar.Scene(both.vertices_m, both.faces, 0.5, both.part, ("left", "right"))
