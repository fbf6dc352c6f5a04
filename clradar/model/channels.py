"""What each antenna's channel does to the signal: a complex gain and a delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.array import AntennaArray
from clradar.model.record import reduced, summary
from clradar.model.waveform import Waveform


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
    __reduce__ = reduced

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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ChannelCalibration:
    """The channels of one instrument as measured with a known target, and how well.

    Parameters
    ----------
    response : ChannelResponse
        Gain and delay of every channel. Gain and delay of a dead channel are 0.
    array : AntennaArray
    waveform : Waveform
        What it was measured with, and holds for.
    tx_noise, rx_noise : array_like, shape (n_tx,) and (n_rx,), float64
        RMS of what one sample has besides the target's echo, by channel, relative to the echo of
        a median pair: 0.1 for a signal-to-noise ratio of 20 dB.
    dead_tx, dead_rx, noisy_tx, noisy_rx : array_like of int
        Indices, ascending; a channel is not in two of them.
    target : str
        "plate", "sphere" or "corner".
    target_position : mapping of str to float
        Where the target was found. A name ends with its unit, "_m" or "_deg".
    target_covariance : array_like, shape (n, n), float64
        Of `target_position`, in its order and units; 0 for what was held.
    tx_phase_std_rad, rx_phase_std_rad : array_like, shape (n_tx,) and (n_rx,), float64
        Standard deviation of the phase (and, relative, of the gain) if the target is where it was
        found; 0 for a dead channel.
    tx_delay_std_s, rx_delay_std_s : array_like, shape (n_tx,) and (n_rx,), float64, seconds
        The same of the delay.
    target_amplitude : float
        Amplitude of the target's echo relative to the model of the target, once gains of mean 0 dB
        are taken off.
    residual_db : float
        Energy of what the fit does not explain, relative to that of all echoes, after the
        frequencies of each pair are summed coherently.
    noise_residual_db : float
        What noise alone would leave of it.
    meta : mapping
        Where it comes from, in types that JSON knows.

    Raises
    ------
    ModelError
        Lengths that do not fit the array, indices outside it, NaN or infinite values.
    """

    response: ChannelResponse
    array: AntennaArray
    waveform: Waveform
    tx_noise: np.ndarray
    rx_noise: np.ndarray
    dead_tx: np.ndarray
    dead_rx: np.ndarray
    noisy_tx: np.ndarray
    noisy_rx: np.ndarray
    target: str
    target_position: Mapping[str, float]
    target_covariance: np.ndarray
    tx_phase_std_rad: np.ndarray
    rx_phase_std_rad: np.ndarray
    tx_delay_std_s: np.ndarray
    rx_delay_std_s: np.ndarray
    target_amplitude: float
    residual_db: float
    noise_residual_db: float
    meta: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = summary
    __reduce__ = reduced

    def __post_init__(self) -> None:
        checks.instance("ChannelCalibration.response", self.response, ChannelResponse)
        checks.instance("ChannelCalibration.array", self.array, AntennaArray)
        checks.instance("ChannelCalibration.waveform", self.waveform, Waveform)
        for side, count in (("tx", self.array.n_tx), ("rx", self.array.n_rx)):
            gain = getattr(self.response, f"{side}_gain")
            if len(gain) != count:
                name = f"ChannelCalibration.response.{side}_gain"
                checks.fail(name, f"{count} channels, as the array has", f"{len(gain)}")
            for name in (f"{side}_noise", f"{side}_phase_std_rad", f"{side}_delay_std_s"):
                self._set(name, _not_negative(name, getattr(self, name), (count,)))
            states = (f"dead_{side}", f"noisy_{side}")
            for name in states:
                self._set(name, _indices(name, getattr(self, name), count))
            dead, noisy = (getattr(self, name) for name in states)
            both = np.intersect1d(dead, noisy)
            if both.size:
                name = f"ChannelCalibration.{states[1]}"
                checks.fail(name, "channels that are not dead", f"{both[0]}, which is dead, too")
            if not np.array_equal(np.flatnonzero(gain == 0), dead):
                checks.fail(
                    f"ChannelCalibration.dead_{side}",
                    "the channels of gain 0, and no others",
                    f"{dead.tolist()} for gains of 0 at {np.flatnonzero(gain == 0).tolist()}",
                )
        self._set("target", checks.text("ChannelCalibration.target", self.target))
        position = checks.frozen_mapping("ChannelCalibration.target_position", self.target_position)
        for name, value in position.items():
            checks.real(f"ChannelCalibration.target_position[{name!r}]", value)
        self._set("target_position", position)
        name = "ChannelCalibration.target_covariance"
        shape = (len(position), len(position))
        covariance = checks.read_only(name, self.target_covariance, np.float64, shape)
        if (np.diag(covariance) < 0).any():
            checks.fail(name, "a diagonal that is not negative", f"{np.diag(covariance).tolist()}")
        self._set("target_covariance", covariance)
        name = "ChannelCalibration.target_amplitude"
        self._set("target_amplitude", checks.positive(name, self.target_amplitude))
        for name in ("residual_db", "noise_residual_db"):
            self._set(name, checks.real(f"ChannelCalibration.{name}", getattr(self, name)))
        self._set("meta", checks.frozen_mapping("ChannelCalibration.meta", self.meta))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @property
    def target_std(self) -> dict[str, float]:
        """Standard deviation of each of `target_position`, in its unit."""
        values = np.sqrt(np.diag(self.target_covariance))
        return dict(zip(self.target_position, values.tolist(), strict=True))


def _not_negative(name: str, value: Any, shape: tuple[int]) -> np.ndarray:
    name = f"ChannelCalibration.{name}"
    values = checks.read_only(name, value, np.float64, shape)
    if (values < 0).any():
        checks.fail(name, "numbers that are not negative", f"{values.min():g}")
    return values


def _indices(name: str, value: Any, count: int) -> np.ndarray:
    name = f"ChannelCalibration.{name}"
    indices = checks.read_only(name, value, np.int64, (None,), allow_empty=True)
    if indices.size and (indices[0] < 0 or indices[-1] >= count or (np.diff(indices) <= 0).any()):
        checks.fail(name, f"ascending indices in [0, {count - 1}]", f"{indices.tolist()}")
    return indices
