"""What each antenna's channel does to the signal: a complex gain and a delay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.model import checks
from clradar.model.summary import summary


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ChannelResponse:
    """Complex gain and delay of every transmit and receive channel.

    The response of channel k at frequency f is

        h_k(f) = g_k exp(-j 2 pi (f - f_ref) tau_k),

    so that the gain is the response at `reference_hz`, and a capture s becomes
    s[tx, rx, n] h_tx(f_n) h_rx(f_n).

    Parameters
    ----------
    tx_gain, rx_gain : array_like, shape (n_tx,) and (n_rx,), complex128
        Linear; 0 for a dead channel.
    tx_delay_s, rx_delay_s : array_like, shape (n_tx,) and (n_rx,), float64, seconds
    reference_hz : float
        Frequency at which the gain is the whole response.

    Raises
    ------
    ModelError
        Lengths that differ, NaN or infinite values.
    """

    tx_gain: np.ndarray
    rx_gain: np.ndarray
    tx_delay_s: np.ndarray
    rx_delay_s: np.ndarray
    reference_hz: float

    __repr__ = summary

    def __post_init__(self) -> None:
        for side in ("tx", "rx"):
            gain = checks.read_only(
                f"ChannelResponse.{side}_gain",
                getattr(self, f"{side}_gain"),
                np.complex128,
                (None,),
            )
            delay = checks.read_only(
                f"ChannelResponse.{side}_delay_s",
                getattr(self, f"{side}_delay_s"),
                np.float64,
                gain.shape,
            )
            object.__setattr__(self, f"{side}_gain", gain)
            object.__setattr__(self, f"{side}_delay_s", delay)
        reference = checks.positive("ChannelResponse.reference_hz", self.reference_hz)
        object.__setattr__(self, "reference_hz", reference)

    def tx_response(self, frequencies_hz: np.ndarray) -> np.ndarray:
        """Return the response of the transmit channels, shape (n_tx, n_freq), complex128."""
        return _response(self.tx_gain, self.tx_delay_s, frequencies_hz - self.reference_hz)

    def rx_response(self, frequencies_hz: np.ndarray) -> np.ndarray:
        """Return the response of the receive channels, shape (n_rx, n_freq), complex128."""
        return _response(self.rx_gain, self.rx_delay_s, frequencies_hz - self.reference_hz)


def _response(gain: np.ndarray, delay_s: np.ndarray, offset_hz: np.ndarray) -> np.ndarray:
    return gain[:, None] * np.exp(-2j * np.pi * delay_s[:, None] * offset_hz)
