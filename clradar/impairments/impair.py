"""Make a clean capture look recorded: noise, channel errors, coupling, walls, drift, converters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.impairments.channel_errors import GAIN_LIMIT_DB, checked_spread, drift_factors
from clradar.impairments.environment import coupling_rows
from clradar.impairments.random_streams import FRAME_LIMIT, SEED_LIMIT, Part, stream
from clradar.model import Capture, ChannelResponse, checks
from clradar.model.capture import check_same_radar

ADC_BITS_LIMIT = 24
"""What complex64, with its 24 binary digits, can hold."""


def impair(
    capture: Capture,
    *,
    seed: int = 0,
    frame: int = 0,
    reference_power: float | None = None,
    room: Capture | None = None,
    coupling_db: float | None = None,
    coupling_delay_s: float = 0.0,
    channels: ChannelResponse | None = None,
    drift_phase_rad: float = 0.0,
    drift_gain_db: float = 0.0,
    drift_common_phase_rad: float = 0.0,
    iq_gain_db: Any = 0.0,
    iq_phase_rad: Any = 0.0,
    snr_db: float | None = None,
    noisy_tx_db: Mapping[int, float] | None = None,
    noisy_rx_db: Mapping[int, float] | None = None,
    adc_bits: int | None = None,
    adc_full_scale: float | None = None,
) -> Capture:
    """Return the capture as an instrument with these faults would have recorded it.

    Every fault is off unless its setting is given. They act in the order of the signal's way, which
    is also that of the parameters: the echoes of scene, room and coupling add up, go through the
    channels, the mixer and the converter.

    Parameters
    ----------
    capture : Capture
        The scene alone.
    seed : int, 0 to 2**64 - 1
        Same seed and settings, same numbers. Each random part has its own stream
        (`clradar.impairments.random_streams`), so switching one fault on leaves the draws of the
        others as they are.
    frame : int, 0 to 999999
        Which frame of a recording: new noise, and more drift with every frame.
    reference_power : float, optional
        The mean |s|^2 per sample that the decibels of `coupling_db` and `snr_db` are relative to.
        That of `capture` if not given. Give the one of the scene to record the empty room.
    room : Capture, optional
        Added as it is; see `clradar.room_capture`. Same array and waveform.
    coupling_db : float, dB, optional
        Mean power of the direct coupling Tx -> Rx over all pairs. Its amplitude goes with
        1 / |tx - rx|, and it arrives after |tx - rx| / c.
    coupling_delay_s : float, seconds
        What the instrument adds to that.
    channels : ChannelResponse, optional
        Gain, phase and delay of every channel; see `clradar.draw_channels`.
    drift_phase_rad, drift_gain_db : float, radians and dB per frame
        Standard deviation of the step that every channel's phase and gain take from one frame to
        the next. Frame 0 has not drifted.
    drift_common_phase_rad : float, radians per frame
        The same for a phase that all pairs share.
    iq_gain_db, iq_phase_rad : float or array_like, shape (n_rx,), dB and radians
        How much too strong the quadrature of a receiver is, and how far from 90 degrees.
    snr_db : float, dB, optional
        Reference power over the mean power of the noise, per sample. The noise is thermal: complex
        normal, circular, independent from sample to sample, the same on weak and dead channels.
    noisy_tx_db, noisy_rx_db : mapping of int to float, dB, optional
        Channels whose noise is this much stronger.
    adc_bits : int, 2 to 24, optional
        Bits of the converters of the in-phase and the quadrature component.
    adc_full_scale : float, optional
        Amplitude at which they clip; the largest component in this frame if not given.

    Returns
    -------
    Capture
        `meta["impairments"]` is a list with one mapping per call: all settings as they were used.

    Raises
    ------
    ModelError
        A setting that cannot be meant, decibels relative to a capture that is zero, another array
        or waveform, or values beyond what complex64 can hold.

    Notes
    -----
    With s the scene, w the room, l the coupling, h the channels, d the drift, q the rounding to the
    converter's steps (docs/equations.md, E10)::

        x = (s + w + l) h_tx h_rx d_tx d_rx
        y = (1 + g exp(j phi)) / 2 x + (1 - g exp(-j phi)) / 2 conj(x)
        result = q(y + noise)

    conj(x) turns the phase of an echo the other way round: the image of a target at path length d
    lies at -d, which for equal steps df is the same as c/df - d.

    Computed in float64, one transmitter at a time, and rounded to complex64 at the end. The streams
    are numpy's, which keeps them within a version and seldom changes them between versions.
    """
    checks.instance("impair: capture", capture, Capture)
    seed = checks.whole("impair: seed", seed, 0, SEED_LIMIT)
    frame = checks.whole("impair: frame", frame, 0, FRAME_LIMIT)
    power, has_levels = None, coupling_db is not None or snr_db is not None
    if reference_power is not None:
        power = checks.positive("impair: reference_power", reference_power)
    elif has_levels:
        power = mean_power(capture)
        if power == 0:
            checks.fail(
                "impair: reference_power",
                "a power, since the capture is zero and decibels are relative to its own",
                "None",
            )
    coupling = _level("coupling_db", coupling_db)
    snr = _level("snr_db", snr_db)
    delay_s = checks.real("impair: coupling_delay_s", coupling_delay_s)
    if coupling is None and delay_s != 0:
        checks.fail("impair: coupling_delay_s", "coupling_db with it", "none")
    if room is not None:
        checks.instance("impair: room", room, Capture)
        check_same_radar("impair: room", room, capture)
    _check_channels(capture, channels)
    drift = {
        "phase_rad": checked_spread("impair: drift_phase_rad", drift_phase_rad),
        "gain_db": checked_spread("impair: drift_gain_db", drift_gain_db, GAIN_LIMIT_DB),
        "common_phase_rad": checked_spread(
            "impair: drift_common_phase_rad", drift_common_phase_rad
        ),
    }
    noisy_tx = _noisy("noisy_tx_db", noisy_tx_db, capture.array.n_tx, snr)
    noisy_rx = _noisy("noisy_rx_db", noisy_rx_db, capture.array.n_rx, snr)
    iq_gain = _per_receiver("iq_gain_db", iq_gain_db, capture.array.n_rx, GAIN_LIMIT_DB)
    iq_phase = _per_receiver("iq_phase_rad", iq_phase_rad, capture.array.n_rx, np.pi)
    bits = None
    if adc_bits is not None:
        bits = checks.whole("impair: adc_bits", adc_bits, 2, ADC_BITS_LIMIT)
    if adc_full_scale is not None:
        if bits is None:
            checks.fail("impair: adc_full_scale", "adc_bits with it", "none")
        adc_full_scale = checks.positive("impair: adc_full_scale", adc_full_scale)

    factor_tx, factor_rx = _channel_factors(capture, channels, seed, frame, drift)
    chain = _Chain(
        capture=capture,
        room=room,
        coupling_rms=0.0 if coupling is None or power is None else _amplitude(coupling, power),
        coupling_delay_s=delay_s,
        factor_tx=factor_tx,
        factor_rx=factor_rx,
        quadrature=None
        if not (iq_gain.any() or iq_phase.any())
        else 10 ** (iq_gain / 20) * np.exp(1j * iq_phase),
        noise_rms=0.0 if snr is None or power is None else _amplitude(-snr, power),
        noise_tx=10 ** (_listed(noisy_tx, capture.array.n_tx) / 20),
        noise_rx=10 ** (_listed(noisy_rx, capture.array.n_rx) / 20),
        seed=seed,
        frame=frame,
    )
    full_scale = adc_full_scale
    if bits is not None and full_scale is None:
        full_scale = max(max(np.abs(y.real).max(), np.abs(y.imag).max()) for y in chain.rows())
        full_scale = float(full_scale)
    data = np.empty(capture.data.shape, np.complex64)
    with np.errstate(over="ignore"):  # Capture refuses what complex64 cannot hold
        for out, row in zip(data, chain.rows(), strict=True):
            out[:] = row if bits is None or not full_scale else _quantised(row, bits, full_scale)
    data.flags.writeable = False

    record = {
        "seed": seed,
        "frame": frame,
        "reference_power": power,
        "room": None if room is None else {"power": mean_power(room), "meta": dict(room.meta)},
        "coupling_db": coupling,
        "coupling_delay_s": delay_s,
        "channels": None if channels is None else channel_record(channels),
        **{f"drift_{name}": value for name, value in drift.items()},
        "iq_gain_db": _short(iq_gain),
        "iq_phase_rad": _short(iq_phase),
        "snr_db": snr,
        "noisy_tx_db": {str(channel): db for channel, db in noisy_tx.items()},
        "noisy_rx_db": {str(channel): db for channel, db in noisy_rx.items()},
        "adc_bits": bits,
        "adc_full_scale": full_scale,
    }
    before = capture.meta.get("impairments", [])
    earlier = before if isinstance(before, list) else [before]
    meta = {**capture.meta, "impairments": [*earlier, record]}
    return Capture(data, capture.array, capture.waveform, meta)


def mean_power(capture: Capture) -> float:
    """Return the mean of |s|^2 over all samples, summed in float64."""
    # Not a product of vectors: how a library splits that over its threads would be in the last bit.
    total = sum(float(np.square(_double(row).view(np.float64)).sum()) for row in capture.data)
    return total / capture.data.size


def channel_record(channels: ChannelResponse) -> dict[str, Any]:
    """Return a channel response in types that JSON knows: gains as [real, imaginary]."""
    record: dict[str, Any] = {"reference_hz": channels.reference_hz}
    for side in ("tx", "rx"):
        gain = getattr(channels, f"{side}_gain")
        record[f"{side}_gain"] = np.stack([gain.real, gain.imag], axis=1).tolist()
        record[f"{side}_delay_s"] = getattr(channels, f"{side}_delay_s").tolist()
    return record


@dataclass(frozen=True, slots=True, eq=False)
class _Chain:
    """The signal's way up to the converter, with every setting as the factor that it stands for."""

    capture: Capture
    room: Capture | None
    coupling_rms: float
    coupling_delay_s: float
    factor_tx: np.ndarray
    factor_rx: np.ndarray
    quadrature: np.ndarray | None
    noise_rms: float
    noise_tx: np.ndarray
    noise_rx: np.ndarray
    seed: int
    frame: int

    def rows(self) -> Iterator[np.ndarray]:
        """Yield the signal of each transmitter, shape (n_rx, n_freq), complex128."""
        array, waveform = self.capture.array, self.capture.waveform
        coupling: Iterator[np.ndarray] | None = None
        if self.coupling_rms > 0:
            coupling = coupling_rows(array, waveform, self.coupling_rms, self.coupling_delay_s)
        noise = stream(self.seed, Part.NOISE, self.frame)
        for tx in range(array.n_tx):
            x = _double(self.capture.data[tx])
            if self.room is not None:
                x += self.room.data[tx]
            if coupling is not None:
                x += next(coupling)
            x *= self.factor_tx[tx] * self.factor_rx
            if self.quadrature is not None:
                g = self.quadrature[:, None]
                x = (1 + g) / 2 * x + (1 - g.conj()) / 2 * x.conj()
            if self.noise_rms > 0:
                drawn = noise.standard_normal((*x.shape, 2)).view(np.complex128)[..., 0]
                rms = self.noise_rms * self.noise_tx[tx] * self.noise_rx
                x += rms[:, None] / np.sqrt(2) * drawn
            yield x


def _channel_factors(
    capture: Capture,
    channels: ChannelResponse | None,
    seed: int,
    frame: int,
    drift: dict[str, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return response times drift of both sides, shape (n, n_freq) or (n, 1)."""
    tx, rx = (
        side[:, None] for side in drift_factors(capture.array, seed=seed, frame=frame, **drift)
    )
    if channels is None:
        return tx, rx
    frequencies = capture.waveform.frequencies_hz
    return tx * channels.tx_response(frequencies), rx * channels.rx_response(frequencies)


def _quantised(x: np.ndarray, bits: int, full_scale: float) -> np.ndarray:
    """Round both components to the 2**bits steps of a two's complement converter, and clip."""
    half = 2 ** (bits - 1)
    step = full_scale / half
    parts = x.view(np.float64)
    return (np.clip(np.rint(parts / step), -half, half - 1) * step).view(np.complex128)


def _check_channels(capture: Capture, channels: ChannelResponse | None) -> None:
    if channels is None:
        return
    checks.instance("impair: channels", channels, ChannelResponse)
    counts = (len(channels.tx_gain), len(channels.rx_gain))
    expected = (capture.array.n_tx, capture.array.n_rx)
    if counts != expected:
        checks.fail(
            "impair: channels", "{} Tx and {} Rx".format(*expected), "{}, {}".format(*counts)
        )


def _level(name: str, value: Any) -> float | None:
    return None if value is None else _decibels(f"impair: {name}", value)


def _decibels(field: str, value: Any) -> float:
    number = checks.real(field, value)
    if abs(number) > GAIN_LIMIT_DB:
        checks.fail(field, f"decibels within +-{GAIN_LIMIT_DB:g}", repr(value))
    return number


def _noisy(
    name: str, given: Mapping[int, float] | None, count: int, snr: float | None
) -> dict[int, float]:
    field = f"impair: {name}"
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        checks.fail(field, "a mapping of channels to decibels", type(given).__name__)
    if given and snr is None:
        checks.fail(field, "snr_db with it", "none")
    return {
        checks.whole(field, channel, 0, count - 1): _decibels(field, db)
        for channel, db in given.items()
    }


def _listed(by_channel: dict[int, float], count: int) -> np.ndarray:
    values = np.zeros(count)
    for channel, value in by_channel.items():
        values[channel] = value
    return values


def _per_receiver(name: str, value: Any, count: int, limit: float) -> np.ndarray:
    """Return one number per receiver, within +-`limit`, shape (n_rx,) float64."""
    field = f"impair: {name}"
    if checks.is_single(value):
        values = np.full(count, checks.real(field, value))
    else:
        values = checks.read_only(field, value, np.float64, (count,))
    if np.abs(values).max() > limit:
        checks.fail(field, f"numbers within +-{limit:g}", f"{np.abs(values).max():g}")
    return values


def _short(values: np.ndarray) -> float | list[float]:
    return float(values[0]) if (values == values[0]).all() else values.tolist()


def _amplitude(level_db: float, power: float) -> float:
    return float(np.sqrt(power) * 10 ** (level_db / 20))


def _double(row: np.ndarray) -> np.ndarray:
    return row.astype(np.complex128)
