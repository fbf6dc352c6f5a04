"""Channel responses: complex gain and delay of every Tx and Rx, as drawn or as calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.array import AntennaArray
from clradar.model.record import Record
from clradar.model.waveform import Waveform


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ChannelResponse(Record):
    """Complex gain and delay of every channel, whose response at frequency f is::

        h_k(f) = g_k exp(-j 2 pi (f - f_ref) tau_k)

    A capture s becomes ``s[tx, rx, n] h_tx(f_n) h_rx(f_n)``.

    Parameters
    ----------
    tx_gain, rx_gain : array_like, shape (n_tx,) and (n_rx,), complex128
        g_k, linear; 0 for a dead channel.
    tx_delay_s, rx_delay_s : array_like, shape (n_tx,) and (n_rx,), float64
    reference_hz : float
        f_ref, where the gain is the whole response.

    Examples
    --------
    10 ps rotate the phase by -36 degrees from the reference to 10 GHz above it.

    >>> channels = clradar.ChannelResponse([1.0, 0.5j], [1.0], [10e-12, 0.0], [0.0], 77e9)
    >>> np.round(np.degrees(np.angle(channels.tx_response(np.array([77e9, 87e9])))))
    array([[  0., -36.],
           [ 90.,  90.]])
    """

    tx_gain: np.ndarray
    rx_gain: np.ndarray
    tx_delay_s: np.ndarray
    rx_delay_s: np.ndarray
    reference_hz: float

    def __post_init__(self) -> None:
        for side in ("tx", "rx"):
            gain = self._set_array(f"{side}_gain", np.complex128, (None,))
            self._set_array(f"{side}_delay_s", np.float64, gain.shape)
        reference_hz = checks.positive("ChannelResponse.reference_hz", self.reference_hz)
        self._set(reference_hz=reference_hz)

    def tx_response(self, frequencies_hz: np.ndarray) -> np.ndarray:
        """Return the response of the Tx, shape (n_tx, n_freq), complex128."""
        return _response(self.tx_gain, self.tx_delay_s, frequencies_hz - self.reference_hz)

    def rx_response(self, frequencies_hz: np.ndarray) -> np.ndarray:
        """Return the response of the Rx, shape (n_rx, n_freq), complex128."""
        return _response(self.rx_gain, self.rx_delay_s, frequencies_hz - self.reference_hz)


def _response(gain: np.ndarray, delay_s: np.ndarray, offset_hz: np.ndarray) -> np.ndarray:
    return gain[:, None] * np.exp(-2j * np.pi * delay_s[:, None] * offset_hz)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ChannelCalibration(Record):
    """The channel responses of an instrument as measured with a known target, with uncertainties.

    `calibration.estimate_channels` makes one (docs/channel-calibration.md).

    Parameters
    ----------
    response : ChannelResponse
        Gain and delay both 0 for a dead channel.
    array : AntennaArray
    waveform : Waveform
        Those of the measurement, to which alone it applies.
    tx_noise, rx_noise : array_like, shape (n_tx,) and (n_rx,), float64
        RMS noise of a sample, relative to the target's echo in a median pair.
    dead_tx, dead_rx, noisy_tx, noisy_rx : array_like of int
        Indices, ascending; a channel is not in two of them.
    target : str
        "plate", "sphere" or "corner".
    target_position : mapping of str to float
        Names end with the unit, "_m" or "_deg".
    target_covariance : array_like, shape (n, n), float64
        Of `target_position`, in its order and units; 0 for what was held fixed.
    tx_phase_std_rad, rx_phase_std_rad : array_like, shape (n_tx,) and (n_rx,), float64
        Standard deviation of phase and relative gain, given the target's position; 0 if dead.
    tx_delay_std_s, rx_delay_std_s : array_like, shape (n_tx,) and (n_rx,), float64
    target_amplitude : float
        Of the echo relative to the model of the target, for gains of mean 0 dB.
    residual_db : float
        Energy that the fit leaves of the echoes, each pair's frequencies summed coherently.
    noise_residual_db : float
        What noise alone would leave.
    meta : mapping
        Provenance, in types of JSON.
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
                values = self._set_array(name, np.float64, (count,))
                if (values < 0).any():
                    field = f"ChannelCalibration.{name}"
                    checks.fail(field, "numbers that are not negative", f"{values.min():g}")
            states = (f"dead_{side}", f"noisy_{side}")
            for name in states:
                self._set_indices(name, count)
            dead, noisy = (getattr(self, name) for name in states)
            both = np.intersect1d(dead, noisy)
            if both.size:
                name = f"ChannelCalibration.{states[1]}"
                checks.fail(name, "channels that are not dead", f"{both[0]}, which is dead")
            if not np.array_equal(np.flatnonzero(gain == 0), dead):
                checks.fail(
                    f"ChannelCalibration.dead_{side}",
                    "exactly the channels of gain 0",
                    f"{dead.tolist()} for gains of 0 at {np.flatnonzero(gain == 0).tolist()}",
                )
        checks.text("ChannelCalibration.target", self.target)
        position = checks.frozen_mapping("ChannelCalibration.target_position", self.target_position)
        for name, value in position.items():
            checks.real(f"ChannelCalibration.target_position[{name!r}]", value)
        shape = (len(position), len(position))
        covariance = self._set_array("target_covariance", np.float64, shape)
        diagonal = np.diag(covariance)
        if (diagonal < 0).any():
            name = "ChannelCalibration.target_covariance"
            checks.fail(name, "a diagonal that is not negative", f"{diagonal.tolist()}")
        amplitude = checks.positive("ChannelCalibration.target_amplitude", self.target_amplitude)
        for name in ("residual_db", "noise_residual_db"):
            self._set(**{name: checks.real(f"ChannelCalibration.{name}", getattr(self, name))})
        meta = checks.frozen_mapping("ChannelCalibration.meta", self.meta)
        self._set(target_position=position, target_amplitude=amplitude, meta=meta)

    def _set_indices(self, name: str, count: int) -> None:
        indices = self._set_array(name, np.int64, (None,), allow_empty=True)
        inside = not indices.size or (indices[0] >= 0 and indices[-1] < count)
        if not inside or (np.diff(indices) <= 0).any():
            field = f"ChannelCalibration.{name}"
            checks.fail(field, f"ascending indices in [0, {count - 1}]", f"{indices.tolist()}")

    @property
    def target_std(self) -> dict[str, float]:
        """Standard deviation of each of `target_position`, in its unit."""
        values = np.sqrt(np.diag(self.target_covariance))
        return dict(zip(self.target_position, values.tolist(), strict=True))
