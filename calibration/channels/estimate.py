"""Complex gain and delay of every channel, from a capture of a known target."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calibration.channels.fit import (
    TUKEY_CUTOFF,
    Fit,
    Prior,
    Samples,
    Side,
    by_channel,
    fit,
    pairs_of,
    start,
)
from calibration.channels.slepian_taper import MIN_CELLS, delay_taper
from calibration.channels.targets import Echo, Target
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CalibrationError
from clradar.model import AntennaArray, Capture, ChannelCalibration, ChannelResponse, checks

COMMON_DELAYS = ("zero", "free")
LEVELS = ("mean", "target")

MIN_FREQUENCIES = 4
"""A pair's mean and slope over frequency take two; what is left tells its noise."""

MIN_PAIRS = 3
"""Fewest pairs with an echo that a channel is estimated from."""

MIN_CHANNELS = 3
"""Fewest live channels on either side: two by two fit any four phases but one."""

SEARCHED = 2.0
"""In units of the tolerance, how far from its place the echo of a target is looked for."""

DETECTABLE = 5.0
"""Of its standard deviation, the least gain that counts as an echo."""

MAX_OUTLYING = 0.15
"""Largest share of pairs with quite another echo. Of wrong targets it is a third and more."""

QUIET = 1e-3
"""Noise below -60 dB of the echo is never called noisy, whatever that of other channels is."""


def estimate_channels(
    capture: Capture,
    target: Target,
    *,
    refine_position: bool = True,
    position_tolerance_m: float = 0.010,
    tilt_tolerance_deg: float = 2.0,
    max_delay_s: float = 100e-12,
    common_delay: str = "zero",
    level: str = "mean",
    gate_m: float | None = None,
    dead_db: float = 20.0,
    noisy_db: float = 6.0,
    max_residual_db: float = -10.0,
    max_iterations: int = 60,
) -> ChannelCalibration:
    """Estimate gain and delay of every channel, and where the target stands.

    Parameters
    ----------
    capture : Capture
        Of the target, and as little else as possible.
    target : FlatPlate, Sphere or CornerReflector
        Where it is said to stand.
    refine_position : bool
        Estimate its place (a plate's distance and tilt), too. Else it is held.
    position_tolerance_m : float, metres
        Standard deviation of where it is said to stand, per axis. It may be found up to three times
        as far away.
    tilt_tolerance_deg : float, degrees
        The same of a plate's tilt.
    max_delay_s : float, seconds
        Largest delay of a pair of channels that is looked for.
    common_delay : "zero" or "free"
        Whether delays scatter about zero or about an unknown common delay. "free" leaves the range
        of a corner reflector as it is given; plate and sphere tell theirs by their shape.
    level : "mean" or "target"
        What tells a strong target from channels with much gain. "mean": gains have a mean of 0 dB,
        so that a correction leaves levels as they are, on average. "target": the echo is as strong
        as the target's model has it (its `amplitude`), so that levels are relative to it.
    gate_m : float, metres, optional
        Use only echoes whose range is at most this far from the target's. It has to leave room for
        the tolerance and the delays. None uses the whole capture.
    dead_db : float, decibel
        A channel with this much less gain than the median of its side is dead, as is one whose
        echo is below five standard deviations of its noise.
    noisy_db : float, decibel
        A live channel with this much more noise than the median of its side is noisy.
    max_residual_db : float, decibel
        Most that may be left of the echoes' energy, after the frequencies of each pair are summed.
    max_iterations : int

    Returns
    -------
    ChannelCalibration
        Gauge: gains have the same mean in dB over the live channels of either side, 0 unless
        `level` is "target"; the first live Tx has phase 0; the means of the delays of Tx and Rx are
        equal. `meta["outlying_pairs"]` is the share of pairs whose echo is another than the
        model's: they had no say, and are not in the residual.

    Raises
    ------
    CalibrationError
        The target does not explain the capture: wrong target, wrong place, nothing but noise, too
        few live channels, or a fit that does not settle.
    ModelError
        An argument that cannot be meant.

    Notes
    -----
    docs/channel-calibration.md has the model and what can be told apart: a phase or a delay that
    is the sum of a part of the Tx and a part of the Rx is the channels' as well as the path's.
    """
    name = "estimate_channels"
    checks.instance(f"{name}: capture", capture, Capture)
    if not isinstance(getattr(target, "kind", None), str):
        expected = "a FlatPlate, Sphere or CornerReflector"
        checks.fail(f"{name}: target", expected, type(target).__name__)
    tolerance_m = checks.positive(f"{name}: position_tolerance_m", position_tolerance_m)
    tolerance_deg = checks.positive(f"{name}: tilt_tolerance_deg", tilt_tolerance_deg)
    max_delay_s = checks.positive(f"{name}: max_delay_s", max_delay_s)
    checks.one_of(f"{name}: common_delay", common_delay, COMMON_DELAYS)
    checks.one_of(f"{name}: level", level, LEVELS)
    dead_db = checks.positive(f"{name}: dead_db", dead_db)
    noisy_db = checks.positive(f"{name}: noisy_db", noisy_db)
    max_residual_db = checks.real(f"{name}: max_residual_db", max_residual_db)
    max_iterations = checks.whole(f"{name}: max_iterations", max_iterations, 1)
    # A target that stands elsewhere is late by its legs' difference.
    search_s = max_delay_s + 2 * SEARCHED * tolerance_m / SPEED_OF_LIGHT_M_PER_S
    _check_waveform(capture, search_s)
    echo = target.echo(capture.array)
    _check_coverage(echo)
    if not capture.data.any():
        raise CalibrationError(f"{name}: expected an echo, got a capture that is zero everywhere")
    samples = _samples(capture, gate_m, search_s)
    by_name = {"m": tolerance_m, "deg": tolerance_deg}
    units = [parameter.rsplit("_", 1)[1] for parameter in target.parameter_names]
    prior = Prior(
        np.array([by_name[unit] for unit in units]), bool(refine_position), common_delay == "zero"
    )

    sides = start(samples, echo, search_s)
    stds = _gain_stds(samples, echo, *sides)
    live = [_live(s, std, dead_db) for s, std in zip(sides, stds, strict=True)]
    for side, alive in zip(("Tx", "Rx"), live, strict=True):
        if np.count_nonzero(alive) < MIN_CHANNELS:
            raise CalibrationError(
                f"{name}: expected an echo of the {target.kind} in at least {MIN_CHANNELS} {side}, "
                f"found it in {np.count_nonzero(alive)} of {alive.size}"
            )
    array = AntennaArray(capture.array.tx_m[live[0]], capture.array.rx_m[live[1]])
    _check_coverage(target.echo(array))
    part = replace(samples, data=samples.data[np.ix_(*live)])
    tx, rx = (
        Side(s.log_gain[a], s.phase_rad[a], s.delay_s[a]) for s, a in zip(sides, live, strict=True)
    )
    found = fit(part, array, target, tx, rx, prior, max_iterations)
    return _judged(capture, samples, found, live, noisy_db, max_residual_db, level)


def _check_waveform(capture: Capture, search_s: float) -> None:
    frequencies_hz = capture.waveform.frequencies_hz
    if frequencies_hz.size < MIN_FREQUENCIES:
        checks.fail(
            "estimate_channels: capture",
            f"at least {MIN_FREQUENCIES} frequencies, over which delays are slopes of the phase",
            f"{frequencies_hz.size}",
        )
    longest_hz = float(np.diff(frequencies_hz).max())
    if 2 * search_s * longest_hz >= 1:
        checks.fail(
            "estimate_channels: max_delay_s, position_tolerance_m",
            f"delays within +-{0.5e12 / longest_hz:.0f} ps, which steps of up to "
            f"{longest_hz / 1e6:.6g} MHz can tell apart",
            f"+-{1e12 * search_s:.0f} ps: {1e12 * search_s:.0f} ps is max_delay_s and the delay of "
            f"a target that is off by {SEARCHED:g} times the tolerance",
        )


def _check_coverage(echo: Echo) -> None:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    few = [np.flatnonzero(echo.seen.sum(axis=axis) < MIN_PAIRS) for axis in (1, 0)]
    if any(f.size for f in few):
        raise CalibrationError(
            "estimate_channels: the target has to give every live channel an echo in at least "
            f"{MIN_PAIRS} pairs; {few[0].size} Tx and {few[1].size} Rx have fewer whose point of "
            "reflection lies on it. Use a larger one, or put it elsewhere"
        )
    n_tx, n_rx = echo.seen.shape
    graph = np.zeros((n_tx + n_rx, n_tx + n_rx), dtype=np.int8)
    graph[:n_tx, n_tx:] = echo.seen
    parts, _ = connected_components(csr_array(graph), directed=False)
    if parts > 1:
        raise CalibrationError(
            f"estimate_channels: the target's echoes leave the channels in {parts} groups that no "
            "pair connects. Use a larger one, or put it elsewhere"
        )


def _samples(capture: Capture, gate_m: float | None, search_s: float) -> Samples:
    """Return the capture as the fit takes it, gated round the target if that is asked for."""
    frequencies_hz = capture.waveform.frequencies_hz
    n = frequencies_hz.size
    if gate_m is None:
        return Samples(capture.data, frequencies_hz, np.full(n, 1.0 / n), None)
    gate_m = checks.positive("estimate_channels: gate_m", gate_m)
    least_s = max(search_s, MIN_CELLS / float(np.ptp(frequencies_hz)))
    if 2 * gate_m / SPEED_OF_LIGHT_M_PER_S < least_s:
        checks.fail(
            "estimate_channels: gate_m",
            f"at least {least_s * SPEED_OF_LIGHT_M_PER_S / 2:.4g} m, which is room for max_delay_s "
            f"and {SEARCHED:g} times the tolerance, and not below the range resolution",
            f"{gate_m:g} m",
        )
    weight, basis = delay_taper(frequencies_hz, 2 * gate_m / SPEED_OF_LIGHT_M_PER_S)
    return Samples(capture.data, frequencies_hz, weight, basis)


def _gain_stds(samples: Samples, echo: Echo, tx: Side, rx: Side) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard deviation of the gain of each channel that noise causes."""
    pairs = pairs_of(samples, echo, tx, rx)
    noise = by_channel(pairs.scatter, echo.seen)
    strength = np.square(echo.amplitude) * echo.seen * samples.count
    reach = (strength @ np.exp(2 * rx.log_gain), strength.T @ np.exp(2 * tx.log_gain))
    with np.errstate(divide="ignore", invalid="ignore"):
        stds = [np.sqrt(n / r) for n, r in zip(noise, reach, strict=True)]
    return stds[0], stds[1]


def _live(side: Side, std: np.ndarray, dead_db: float) -> np.ndarray:
    gain = np.exp(side.log_gain)
    least = float(np.median(gain)) * 10 ** (-dead_db / 20)
    # Not above: a channel that is zero everywhere has no noise, either.
    return (gain > 0) & (gain >= least) & (gain > DETECTABLE * std)


def _judged(
    capture: Capture,
    samples: Samples,
    found: Fit,
    live: list[np.ndarray],
    noisy_db: float,
    max_residual_db: float,
    level: str,
) -> ChannelCalibration:
    """Say how good a fit is, raise where it is none, and bring it into the gauge."""
    pairs, seen, kind = found.pairs, found.echo.seen, found.target.kind
    typical = float(np.median(pairs.model[seen]))
    noise = [np.sqrt(power) / typical for power in by_channel(pairs.total, seen)]
    loud = [n > max(QUIET, 10 ** (noisy_db / 20) * float(np.median(n))) for n in noise]
    good = seen & ~loud[0][:, None] & ~loud[1][None, :]
    square = np.square(np.abs(pairs.mean - pairs.model))
    # A few pairs with quite another echo are no reason to doubt the rest, where they have no say.
    outlying = good & (square > TUKEY_CUTOFF**2 * float(np.median(square[good])) / np.log(2.0))
    share = np.count_nonzero(outlying) / np.count_nonzero(good)
    if share > MAX_OUTLYING:
        raise CalibrationError(
            f"estimate_channels: the {kind} does not explain the capture: {100 * share:.0f} % of "
            f"the pairs have quite another echo, and {100 * MAX_OUTLYING:.0f} % is the most. "
            "Another target, or another place"
        )
    good &= ~outlying
    echoes = float(np.square(np.abs(pairs.mean[good])).sum())
    left = float(square[good].sum())
    by_noise = float(found.noise[good].sum()) / samples.count
    residual_db, noise_residual_db = (_db(energy / echoes) for energy in (left, by_noise))
    # What is left beyond noise, of what is there beyond noise.
    excess_db = _db(max(left - by_noise, 0.0) / max(echoes - by_noise, by_noise, 1e-300))
    if excess_db > max_residual_db:
        raise CalibrationError(
            f"estimate_channels: the {kind} does not explain the capture: {excess_db:.1f} dB of "
            f"the echoes' energy is left, and {max_residual_db:g} dB is the most. Another target, "
            "another place, or other echoes beside it (gate_m)"
        )

    log_gain = [side.log_gain for side in (found.tx, found.rx)]
    mean_log = [float(g.mean()) for g in log_gain]
    taken = [0.0, 0.0] if level == "mean" else [sum(mean_log) / 2] * 2
    first = float(found.tx.phase_rad[0])
    phase = [found.tx.phase_rad - first, found.rx.phase_rad + first]
    offset_s = (float(found.tx.delay_s.mean()) - float(found.rx.delay_s.mean())) / 2
    delay_s = [found.tx.delay_s - offset_s, found.rx.delay_s + offset_s]
    gain = [np.exp(log_gain[k] - mean_log[k] + taken[k] + 1j * phase[k]) for k in range(2)]
    # A dead channel shows its noise against the live ones of the other side.
    power = samples.power()
    alone = (np.median(power[:, live[1]], axis=1), np.median(power[live[0]], axis=0))
    std = (found.tx_std_rad, found.rx_std_rad)
    spread = samples.spread_rad_per_s
    fields: dict[str, Any] = {}
    for k, side in enumerate(("tx", "rx")):
        fields[f"{side}_noise"] = _filled(noise[k], live[k], np.sqrt(alone[k]) / typical)
        fields[f"dead_{side}"] = np.flatnonzero(~live[k])
        fields[f"noisy_{side}"] = np.flatnonzero(live[k])[loud[k]]
        fields[f"{side}_phase_std_rad"] = _filled(std[k], live[k])
        fields[f"{side}_delay_std_s"] = _filled(std[k] / spread, live[k])
    return ChannelCalibration(
        response=ChannelResponse(
            tx_gain=_filled(gain[0], live[0]),
            rx_gain=_filled(gain[1], live[1]),
            tx_delay_s=_filled(delay_s[0], live[0]),
            rx_delay_s=_filled(delay_s[1], live[1]),
            reference_hz=samples.reference_hz,
        ),
        array=capture.array,
        waveform=capture.waveform,
        target=kind,
        target_position=dict(
            zip(found.target.parameter_names, found.target.parameters.tolist(), strict=True)
        ),
        target_covariance=found.covariance,
        target_amplitude=float(np.exp(sum(mean_log))),
        residual_db=residual_db,
        noise_residual_db=noise_residual_db,
        meta={"level": level, "outlying_pairs": share, "capture": dict(capture.meta)},
        **fields,
    )


def _filled(values: np.ndarray, live: np.ndarray, dead: np.ndarray | None = None) -> np.ndarray:
    """Return the values of live channels among those of all, the others 0 or from `dead`."""
    every = np.zeros(live.size, dtype=values.dtype) if dead is None else dead.copy()
    every[live] = values
    return every


def _db(share: float) -> float:
    return 10 * float(np.log10(max(share, 1e-30)))
