"""Empty rooms, and the signal chain from echo to sample (E10 in ``docs/equations.md``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.impairments.channel_errors import (
    FRAME_LIMIT,
    GAIN_LIMIT_DB,
    SEED_LIMIT,
    drift_factors,
    random_stream,
)
from clradar.model import AntennaArray, Capture, ChannelResponse, Waveform, checks
from clradar.model.capture import check_same_radar
from clradar.model.plausible import place
from clradar.model.record import Record, plain


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wall(Record):
    """An infinite plane that reflects like a mirror.

    Parameters
    ----------
    point_m : array_like, shape (3,), float64
        Any point of the plane.
    normal : array_like, shape (3,), float64
        Of any length and either sign.
    amplitude : float
        RMS over the pairs of its echo, in the units of a capture; negative where the reflection
        reverses the sign.
    """

    point_m: np.ndarray
    normal: np.ndarray
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        amplitude = checks.real("Wall.amplitude", self.amplitude)
        self._set(point_m=place("Wall.point_m", self.point_m), amplitude=amplitude)
        normal = self._set_array("normal", np.float64, (3,))
        length = float(np.linalg.norm(normal))
        if not 0 < length < np.inf:
            checks.fail("Wall.normal", "a direction", f"{normal.tolist()}")
        self._set(normal=normal / length)
        self._set_array("normal", np.float64, (3,))


def room_capture(
    array: AntennaArray,
    waveform: Waveform,
    walls: Iterable[Wall],
    *,
    points_m: Any = None,
    point_amplitudes: Any = None,
) -> Capture:
    """Return the capture of an empty room: walls and small reflectors (E10 in docs/equations.md).

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    walls : iterable of Wall
        Each gives one specular reflection per pair.
    points_m : array_like, shape (n, 3), float64, optional
        Small isotropic reflectors, such as lamps and screws.
    point_amplitudes : array_like, shape (n,), complex128, optional
        As received, without patterns and gains; default 1.

    Returns
    -------
    Capture
        `meta["room"]` holds the walls and the points.

    Examples
    --------
    The slope of the phase is the path by way of the wall: ``2 |(0.3 m, 0.4 m)| = 1 m``.

    >>> array = clradar.AntennaArray([[-0.3, 0, 0]], [[0.3, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    >>> wall = clradar.Wall(point_m=(0, 0, 0.4), normal=(0, 0, -1), amplitude=2.0)
    >>> room = clradar.room_capture(array, waveform, [wall])
    >>> k = 2 * np.pi * waveform.frequencies_hz / 299_792_458
    >>> print(f"{-np.polyfit(k, np.unwrap(np.angle(room.data[0, 0])), 1)[0]:.3f} m")
    1.000 m
    """
    checks.instance("room_capture: array", array, AntennaArray)
    checks.instance("room_capture: waveform", waveform, Waveform)
    planes = list(checks.several("room_capture: walls", walls))
    lengths, levels = [], []
    for wall in planes:
        checks.instance("room_capture: walls", wall, Wall)
        heights = [(side - wall.point_m) @ wall.normal for side in (array.tx_m, array.rx_m)]
        both = np.concatenate(heights)
        if not (both > 0).all() and not (both < 0).all():
            got = f"heights of {1e3 * both.min():g} to {1e3 * both.max():g} mm over one"
            checks.fail("room_capture: walls", "all antennas on one side of each wall", got)
        image = array.tx_m - 2 * heights[0][:, None] * wall.normal
        lengths.append(np.linalg.norm(image[:, None] - array.rx_m, axis=2))
        levels.append(_spreading_loss(wall.amplitude, lengths[-1]))
    field, given = "room_capture: points_m", np.empty((0, 3)) if points_m is None else points_m
    points = checks.read_only(field, given, np.float64, (None, 3), allow_empty=True)
    n = len(points)
    if not planes and not n:
        checks.fail("room_capture", "at least one wall or one point", "none")
    field, given = "room_capture: point_amplitudes", point_amplitudes
    given = np.ones(n) if given is None else given
    amplitudes = checks.read_only(field, given, np.complex128, (n,), allow_empty=True)
    for point, amplitude in zip(points, amplitudes, strict=True):
        to_tx, to_rx = (np.linalg.norm(side - point, axis=1) for side in (array.tx_m, array.rx_m))
        lengths.append(to_tx[:, None] + to_rx)
        levels.append(np.full(lengths[-1].shape, amplitude))
    data = np.empty((array.n_tx, array.n_rx, waveform.n_freq), np.complex64)
    for tx, row in enumerate(data):
        ways = zip(lengths, levels, strict=True)
        row[:] = sum(_echo(waveform.frequencies_hz, d[tx], a[tx]) for d, a in ways)
    data.flags.writeable = False
    pairs = amplitudes.view(np.float64).reshape(-1, 2)
    room = plain({"walls": planes, "points_m": points, "point_amplitudes": pairs})
    return Capture(data, array, waveform, {"room": room})


def _spreading_loss(rms: float, length_m: np.ndarray) -> np.ndarray:
    """Return amplitudes proportional to 1 / length, with this RMS over the pairs."""
    return rms / length_m / np.sqrt((1 / length_m**2).mean())


def _echo(
    frequencies_hz: np.ndarray, length_m: np.ndarray, amplitude: np.ndarray, later_s: float = 0.0
) -> np.ndarray:
    """Return a exp(-j 2 pi f tau), shape (n, n_freq), for n lengths and amplitudes."""
    cycles = (length_m / SPEED_OF_LIGHT_M_PER_S + later_s)[:, None] * frequencies_hz
    return amplitude[:, None] * np.exp(-2j * np.pi * cycles)


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
    adc_bits: int | None = None,
    adc_full_scale: float | None = None,
) -> Capture:
    """Return the capture as an instrument with these faults would have recorded it.

    Every fault is off unless its setting is given. They act in the order of the parameters
    (docs/impairments.md; E10 in docs/equations.md).

    Parameters
    ----------
    capture : Capture
        The scene alone.
    seed : int, 0 to 2**64 - 1
        Each fault has its own stream of numbers: another fault does not change them.
    frame : int, 0 to 999999
        Of a recording: new noise, and more drift with every frame.
    reference_power : float, optional
        Mean ``|s|^2`` per sample that `coupling_db` and `snr_db` are relative to. None: that of
        `capture`. Give that of the scene to record the empty room.
    room : Capture, optional
        Added as it is; see `clradar.room_capture`.
    coupling_db, coupling_delay_s : float, optional
        Mean power of the direct coupling over all pairs, and its delay beside ``|tx - rx| / c``.
    channels : ChannelResponse, optional
        See `clradar.draw_channels`.
    drift_phase_rad, drift_gain_db, drift_common_phase_rad : float
        Standard deviation of the step per frame of every channel's phase and gain, and of a phase
        that all pairs share. Frame 0 has not drifted.
    iq_gain_db, iq_phase_rad : float or array_like, shape (n_rx,)
        Gain of a receiver's quadrature component relative to the in-phase one, and phase error.
    snr_db : float, optional
        Reference power over that of the noise, per sample; the same on weak and dead channels.
    adc_bits, adc_full_scale : int, 2 to 24, and float, optional
        Bits of the converters of both components, and the amplitude at which they clip. None: the
        largest in this frame.

    Returns
    -------
    Capture
        `meta["impairments"]` is a list with one mapping per call: all settings as they were used.

    Examples
    --------
    >>> noisy = clradar.impair(capture, snr_db=20, seed=1)
    >>> noisy.meta["impairments"][0]["snr_db"]
    20.0
    """
    checks.instance("impair: capture", capture, Capture)
    n_tx, n_rx = capture.array.n_tx, capture.array.n_rx
    if room is not None:
        checks.instance("impair: room", room, Capture)
        check_same_radar("impair: room", room, capture)
    response: dict[str, Any] | None = None
    if channels is not None:
        checks.instance("impair: channels", channels, ChannelResponse)
        counts = (len(channels.tx_gain), len(channels.rx_gain))
        if counts != (n_tx, n_rx):
            checks.fail("impair: channels", f"{n_tx} Tx and {n_rx} Rx", "{}, {}".format(*counts))
        response = {"reference_hz": channels.reference_hz}
        for side in ("tx", "rx"):
            gain, delay_s = (getattr(channels, f"{side}_{name}") for name in ("gain", "delay_s"))
            pairs = np.stack([gain.real, gain.imag], axis=1)
            response |= {f"{side}_gain": pairs.tolist(), f"{side}_delay_s": delay_s.tolist()}
    # The mantissa of complex64 has 24.
    bits = None if adc_bits is None else checks.whole("impair: adc_bits", adc_bits, 2, 24)
    full_scale = None
    if adc_full_scale is not None:
        if bits is None:
            checks.fail("impair: adc_full_scale", "adc_bits with it", "none")
        full_scale = checks.positive("impair: adc_full_scale", adc_full_scale)
    delay_s = checks.real("impair: coupling_delay_s", coupling_delay_s)
    if coupling_db is None and delay_s != 0:
        checks.fail("impair: coupling_delay_s", "coupling_db with it", "none")
    power = None
    if reference_power is not None:
        power = checks.positive("impair: reference_power", reference_power)
    elif coupling_db is not None or snr_db is not None:
        power = _mean_power(capture)
        if power == 0:
            expected = "a power, since the capture is zero and decibels are relative to its own"
            checks.fail("impair: reference_power", expected, "None")

    def number(name: str, value: Any, low: float, high: float) -> float | None:
        return None if value is None else checks.within(f"impair: {name}", value, low, high)

    common_rad = drift_common_phase_rad
    settings: dict[str, Any] = {
        "seed": checks.whole("impair: seed", seed, 0, SEED_LIMIT),
        "frame": checks.whole("impair: frame", frame, 0, FRAME_LIMIT),
        "reference_power": power,
        "room": None if room is None else {"power": _mean_power(room), "meta": dict(room.meta)},
        "coupling_db": number("coupling_db", coupling_db, -GAIN_LIMIT_DB, GAIN_LIMIT_DB),
        "coupling_delay_s": delay_s,
        "channels": response,
        "drift_phase_rad": number("drift_phase_rad", drift_phase_rad, 0.0, np.inf),
        "drift_gain_db": number("drift_gain_db", drift_gain_db, 0.0, GAIN_LIMIT_DB),
        "drift_common_phase_rad": number("drift_common_phase_rad", common_rad, 0.0, np.inf),
        "iq_gain_db": _per_receiver("iq_gain_db", iq_gain_db, n_rx, GAIN_LIMIT_DB),
        "iq_phase_rad": _per_receiver("iq_phase_rad", iq_phase_rad, n_rx, np.pi),
        "snr_db": number("snr_db", snr_db, -GAIN_LIMIT_DB, GAIN_LIMIT_DB),
        "adc_bits": bits,
        "adc_full_scale": full_scale,
    }
    chain = capture, room, channels, settings
    if bits is not None and full_scale is None:
        full_scale = max(max(np.abs(y.real).max(), np.abs(y.imag).max()) for y in _signal(*chain))
        settings["adc_full_scale"] = full_scale = float(full_scale)
    data = np.empty(capture.data.shape, np.complex64)
    with np.errstate(over="ignore"):  # Capture refuses what complex64 cannot hold
        for out, row in zip(data, _signal(*chain), strict=True):
            if bits is not None and full_scale:  # both components in two's complement
                half = 2 ** (bits - 1)
                steps = np.rint(row.view(np.float64) / (full_scale / half))
                row = (np.clip(steps, -half, half - 1) * (full_scale / half)).view(np.complex128)
            out[:] = row
    data.flags.writeable = False
    before = capture.meta.get("impairments", [])
    earlier = before if isinstance(before, list) else [before]
    meta = {**capture.meta, "impairments": [*earlier, settings]}
    return Capture(data, capture.array, capture.waveform, meta)


def _signal(
    capture: Capture,
    room: Capture | None,
    channels: ChannelResponse | None,
    settings: dict[str, Any],
) -> Iterator[np.ndarray]:
    """Yield the signal of each Tx before the converter, shape (n_rx, n_freq), complex128."""
    array, waveform, power = capture.array, capture.waveform, settings["reference_power"]
    seed, frame = settings["seed"], settings["frame"]
    factors: Any = drift_factors(
        array, seed=seed, frame=frame, phase_rad=settings["drift_phase_rad"],
        gain_db=settings["drift_gain_db"], common_phase_rad=settings["drift_common_phase_rad"],
    )  # fmt: skip
    factor_tx, factor_rx = (factor[:, None] for factor in factors)
    if channels is not None:
        factor_tx = factor_tx * channels.tx_response(waveform.frequencies_hz)
        factor_rx = factor_rx * channels.rx_response(waveform.frequencies_hz)
    iq_gain, iq_rad = (
        np.broadcast_to(settings[key], array.n_rx)[:, None]
        for key in ("iq_gain_db", "iq_phase_rad")
    )
    g = 10 ** (iq_gain / 20) * np.exp(1j * iq_rad)
    between_m = np.linalg.norm(array.tx_m[:, None] - array.rx_m, axis=2)
    if settings["coupling_db"] is not None:
        if not between_m.all():
            first = "Tx {} on Rx {}".format(*np.argwhere(between_m == 0)[0])
            checks.fail("impair: coupling_db", "antennas apart from each other", first)
        rms = float(np.sqrt(power) * 10 ** (settings["coupling_db"] / 20))
        coupling = _spreading_loss(rms, between_m)
    noise = random_stream(seed, "noise", frame)
    for tx in range(array.n_tx):
        x = capture.data[tx].astype(np.complex128)
        if room is not None:
            x += room.data[tx]
        if settings["coupling_db"] is not None:
            delay_s = settings["coupling_delay_s"]
            x += _echo(waveform.frequencies_hz, between_m[tx], coupling[tx], delay_s)
        x *= factor_tx[tx] * factor_rx
        if iq_gain.any() or iq_rad.any():
            x = (1 + g) / 2 * x + (1 - g.conj()) / 2 * x.conj()
        if settings["snr_db"] is not None:
            drawn = noise.standard_normal((*x.shape, 2)).view(np.complex128)[..., 0]
            rms = float(np.sqrt(power) * 10 ** (-settings["snr_db"] / 20))
            x += rms / np.sqrt(2) * drawn
        yield x


def _mean_power(capture: Capture) -> float:
    """Return the mean of |s|^2 over all samples, summed in float64."""
    # Not a dot product: its last bit would depend on how the library splits it over threads.
    rows = (row.astype(np.complex128).view(np.float64) for row in capture.data)
    return sum(float(np.square(row).sum()) for row in rows) / capture.data.size


def _per_receiver(name: str, value: Any, count: int, limit: float) -> float | list[float]:
    """Return numbers within +-`limit`: one per receiver, or one where all are equal."""
    field = f"impair: {name}"
    given = np.full(count, checks.real(field, value)) if checks.is_single(value) else value
    values = checks.read_only(field, given, np.float64, (count,))
    if np.abs(values).max() > limit:
        checks.fail(field, f"numbers within +-{limit:g}", f"{np.abs(values).max():g}")
    return float(values[0]) if (values == values[0]).all() else values.tolist()
