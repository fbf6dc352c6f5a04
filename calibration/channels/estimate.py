"""Estimation of complex gain and delay of every channel from a capture of a known target."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calibration.channels import fit
from calibration.channels.targets import Echo, Target
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CalibrationError, ModelError, warn
from clradar.model import Capture, ChannelCalibration, ChannelResponse, Waveform, checks
from clradar.model.progress import Progress

COMMON_DELAYS = ("zero", "free")

MIN_FREQUENCIES = 4  # mean and slope take two degrees of freedom of a pair, its noise the rest
MIN_PAIRS = 3  # with an echo, for the estimate of a channel
MIN_CHANNELS = 3  # live, on either side: two by two channels fit three of any four phases
SEARCHED = 2.0  # range of the search about the nominal range, in tolerances
DETECTABLE = 5.0  # smallest gain that counts as an echo, in standard deviations
DEAD_DB = 20.0  # below the median gain of its side, a channel is dead
MAX_OUTLYING = 0.15  # share of the pairs; for wrong targets it is a third and more
NOISY_DB = 6.0  # above the median noise of its side, a channel is noisy
QUIET = 1e-3  # -60 dB of the echo: with less noise no channel is noisy, whatever the others have
MAX_RESIDUAL_DB = -10.0  # energy beyond noise that a target may leave, relative to the echoes'

UNEXPLAINED_DB, NEGLIGIBLE_DB = 10.0, -60.0
"""A residual so far above that of noise alone is warned of, unless it is below the second, which
shifts a gain by a thousandth at most."""


def estimate_channels(
    capture: Capture,
    target: Target,
    *,
    position_tolerance_m: float = 0.010,
    tilt_tolerance_deg: float = 2.0,
    max_delay_s: float = 100e-12,
    common_delay: str = "zero",
    progress: Progress | None = None,
) -> ChannelCalibration:
    """Estimate gain and delay of every channel, and the pose of the target.

    docs/channel-calibration.md has the model, what cannot be determined, and the set-up.

    Parameters
    ----------
    capture : Capture
        Of the target, with as few other echoes as possible: `range_gate`.
    target : FlatPlate, Sphere or CornerReflector
        In its nominal pose.
    position_tolerance_m, tilt_tolerance_deg : float
        Standard deviations of the nominal pose, which is estimated, too (position, or a plate's
        distance and tilt), and may be up to three times as far off.
    max_delay_s : float
        Largest delay of a pair of channels in the search.
    common_delay : "zero" or "free"
        What delays scatter about: zero, or an unknown delay, with which the range of a corner
        reflector stays nominal.

    Returns
    -------
    ChannelCalibration
        Gains have a mean of 0 dB on either side, the first live Tx has phase 0, delays of Tx and Rx
        have equal means. `meta["outlying_pairs"]` is the share of pairs with another echo.

    Raises
    ------
    CalibrationError
        The target does not explain the capture, or too few channels are live.

    Examples
    --------
    A Tx of twice the gain, and 6 degrees ahead:

    >>> array = clradar.arrays.qar50().part(np.s_[::12], np.s_[::12])
    >>> plate = calibration.FlatPlate(0.3)
    >>> echo = calibration.response(plate, array, waveform := clradar.Waveform.sfcw(72e9, 82e9, 16))
    >>> echo[3] *= 2 * np.exp(1j * np.radians(6))
    >>> capture = clradar.Capture(echo, array, waveform)
    >>> channels = calibration.estimate_channels(capture, plate)
    >>> ratio = channels.response.tx_gain[3] / channels.response.tx_gain[0]
    >>> print(f"{abs(ratio):.3f} at {np.degrees(np.angle(ratio)):.2f} degrees")
    2.000 at 6.00 degrees
    """
    name = "estimate_channels"
    checks.instance(f"{name}: capture", capture, Capture)
    checks.instance(f"{name}: target", target, Target)
    tolerances = {
        "m": checks.positive(f"{name}: position_tolerance_m", position_tolerance_m),
        "deg": checks.positive(f"{name}: tilt_tolerance_deg", tilt_tolerance_deg),
    }
    max_delay_s = checks.positive(f"{name}: max_delay_s", max_delay_s)
    checks.one_of(f"{name}: common_delay", common_delay, COMMON_DELAYS)
    # A displaced target changes the delay by twice the displacement over c.
    search_s = max_delay_s + 2 * SEARCHED * tolerances["m"] / SPEED_OF_LIGHT_M_PER_S
    _check_steps(capture.waveform, search_s)
    samples = fit.Samples(capture.data, capture.waveform.frequencies_hz)
    echo = target.echo(capture.array)
    _check_coverage(echo)
    if not capture.data.any():
        raise CalibrationError(f"{name}: expected an echo, got a capture that is zero everywhere")
    units = [parameter.rsplit("_", 1)[1] for parameter in target.parameter_names]
    tolerance = np.array([tolerances[unit] for unit in units])

    gain, delay_s = fit.start(samples, echo, search_s)
    live = _live(samples, echo, gain, delay_s)
    for side, alive in zip(("Tx", "Rx"), live, strict=True):
        if np.count_nonzero(alive) < MIN_CHANNELS:
            raise CalibrationError(
                f"{name}: expected an echo of the {target.kind} in at least {MIN_CHANNELS} {side}, "
                f"found it in {np.count_nonzero(alive)} of {alive.size}"
            )
    array = capture.array.part(live[0], live[1])
    _check_coverage(target.echo(array))
    part = replace(samples, data=samples.data[np.ix_(*live)])
    own, zero_mean = np.concatenate(live), common_delay == "zero"
    try:
        found = fit.fit_channels(
            part, array, target, gain[own], delay_s[own], tolerance, zero_mean, progress
        )
    except (ModelError, np.linalg.LinAlgError) as error:
        why = str(error) if isinstance(error, ModelError) else "singular equations"
        raise CalibrationError(
            f"{name}: the {target.kind} does not explain the capture: its fit leads to an "
            f"impossible pose, or to channels without an echo ({why})"
        ) from error
    return _calibration(capture, samples, found, live)


def _check_steps(waveform: Waveform, search_s: float) -> None:
    if waveform.n_freq < MIN_FREQUENCIES:
        expected = f"at least {MIN_FREQUENCIES} frequencies, over which delays are slopes of phase"
        checks.fail("estimate_channels: capture", expected, f"{waveform.n_freq}")
    longest_hz = float(np.diff(waveform.frequencies_hz).max())
    if 2 * search_s * longest_hz >= 1:
        checks.fail(
            "estimate_channels: max_delay_s, position_tolerance_m",
            f"delays within +-{0.5e12 / longest_hz:.0f} ps, which are unambiguous with steps of up "
            f"to {longest_hz / 1e6:.6g} MHz",
            f"+-{1e12 * search_s:.0f} ps: max_delay_s and the delay of a target that is off by "
            f"{SEARCHED:g} times the tolerance",
        )


def _check_coverage(echo: Echo) -> None:
    from scipy.sparse.csgraph import connected_components

    few = [np.count_nonzero(echo.seen.sum(axis=axis) < MIN_PAIRS) for axis in (1, 0)]
    groups, _ = connected_components(echo.seen.astype(int) @ echo.seen.T, directed=False)
    if any(few) or groups > 1:
        raise CalibrationError(
            "estimate_channels: the target has to give every live channel an echo in at least "
            f"{MIN_PAIRS} pairs, which connect all of them: {few[0]} Tx and {few[1]} Rx have fewer "
            f"whose point of reflection lies on it, and the Tx are in {groups} groups. Use a "
            "larger one, or put it elsewhere"
        )


def _live(
    samples: fit.Samples, echo: Echo, gain: np.ndarray, delay_s: np.ndarray
) -> list[np.ndarray]:
    """Which Tx and Rx have an echo, by their gain and its standard deviation due to noise."""
    noise = fit.by_channel(fit.pairs_of(samples, echo, gain, delay_s).scatter, echo.seen)
    tx, rx = np.split(np.abs(gain), [len(samples.data)])
    strength = echo.seen * samples.frequencies_hz.size
    live = []
    for own, power, reach in ((tx, noise[0], strength @ rx**2), (rx, noise[1], strength.T @ tx**2)):
        least = float(np.median(own)) * 10 ** (-DEAD_DB / 20)
        # The first term is for a channel that is zero everywhere: it has no noise, either.
        live.append((own > 0) & (own >= least) & (own**2 * reach > DETECTABLE**2 * power))
    return live


def _calibration(
    capture: Capture,
    samples: fit.Samples,
    found: fit.ChannelFit,
    live: list[np.ndarray],
) -> ChannelCalibration:
    """The fit in the gauge of `estimate_channels`, with dead channels filled in."""
    pairs, seen = found.pairs, found.echo.seen
    typical = float(np.median(pairs.model[seen]))
    noise = [np.sqrt(power) / typical for power in fit.by_channel(pairs.total, seen)]
    noisy = [n > max(QUIET, 10 ** (NOISY_DB / 20) * float(np.median(n))) for n in noise]
    good = seen & ~noisy[0][:, None] & ~noisy[1]
    outlying, left, by_noise = _residual(found, good, samples.frequencies_hz.size)
    residual_db, noise_residual_db = _decibel(left), _decibel(by_noise)
    # Residual beyond noise, relative to the echoes beyond noise.
    excess_db = _decibel(max(left - by_noise, 0.0) / max(1 - by_noise, by_noise, 1e-30))
    if excess_db > MAX_RESIDUAL_DB:
        raise CalibrationError(
            f"estimate_channels: the {found.target.kind} does not explain the capture: "
            f"{excess_db:.1f} dB of the echoes' energy is left, and at most {MAX_RESIDUAL_DB:g} dB "
            "may be. Another target, another position, or other echoes beside it (range_gate)"
        )
    if residual_db > max(noise_residual_db + UNEXPLAINED_DB, NEGLIGIBLE_DB):
        warn(
            f"estimate_channels: {residual_db - noise_residual_db:.0f} dB more is left than by "
            "noise: other echoes (range_gate, clean --gate-mm), or a target that differs from its "
            "description"
        )
    gain, delay_s, phase_std_rad = (
        np.split(one, [len(seen)]) for one in (found.gain, found.delay_s, found.phase_std_rad)
    )
    mean_log = [float(np.log(np.abs(own)).mean()) for own in gain]
    first = gain[0][0] / abs(gain[0][0])
    offset_s = (float(delay_s[0].mean()) - float(delay_s[1].mean())) / 2
    # The noise of a dead channel, from its pairs with the live ones of the other side.
    power = samples.power()
    alone = (np.median(power[:, live[1]], axis=1), np.median(power[live[0]], axis=0))
    response, fields = dict[str, np.ndarray](), dict[str, Any]()
    for k, (name, turn, later_s) in enumerate(
        (("tx", first.conj(), -offset_s), ("rx", first, offset_s))
    ):
        response[f"{name}_gain"] = _filled(gain[k] * np.exp(-mean_log[k]) * turn, live[k])
        response[f"{name}_delay_s"] = _filled(delay_s[k] + later_s, live[k])
        std = _filled(phase_std_rad[k], live[k])
        fields[f"{name}_phase_std_rad"] = std
        fields[f"{name}_delay_std_s"] = std / samples.spread_rad_per_s
        fields[f"{name}_noise"] = _filled(noise[k], live[k], np.sqrt(alone[k]) / typical)
        fields[f"dead_{name}"] = np.flatnonzero(~live[k])
        fields[f"noisy_{name}"] = np.flatnonzero(live[k])[noisy[k]]
    names, position = found.target.parameter_names, found.target.parameters.tolist()
    return ChannelCalibration(
        response=ChannelResponse(**response, reference_hz=samples.reference_hz),
        array=capture.array,
        waveform=capture.waveform,
        target=found.target.kind,
        target_position=dict(zip(names, position, strict=True)),
        target_covariance=found.covariance,
        target_amplitude=float(np.exp(sum(mean_log))),
        residual_db=residual_db,
        noise_residual_db=noise_residual_db,
        meta={"outlying_pairs": outlying, "capture": dict(capture.meta)},
        **fields,
    )


def _residual(
    found: fit.ChannelFit, good: np.ndarray, samples_per_pair: int
) -> tuple[float, float, float]:
    """Shares of outlying pairs, and of the others' energy that is left, and that noise leaves."""
    square = np.square(np.abs(found.pairs.mean - found.pairs.model))
    # A few outlying pairs have nearly no weight, and do not invalidate the rest.
    outlying = good & (square > fit.TUKEY_CUTOFF**2 * float(np.median(square[good])) / np.log(2.0))
    share = np.count_nonzero(outlying) / np.count_nonzero(good)
    if share > MAX_OUTLYING:
        raise CalibrationError(
            f"estimate_channels: the {found.target.kind} does not explain the capture: "
            f"{100 * share:.0f} % of the pairs have another echo, and at most "
            f"{100 * MAX_OUTLYING:.0f} % may. Another target, or another position"
        )
    good = good & ~outlying
    echoes = float(np.square(np.abs(found.pairs.mean[good])).sum())
    by_noise = float(found.noise[good].sum()) / samples_per_pair
    return share, float(square[good].sum()) / echoes, by_noise / echoes


def _filled(values: np.ndarray, live: np.ndarray, dead: np.ndarray | None = None) -> np.ndarray:
    """Values of all channels from those of the live ones; the others are 0 or from `dead`."""
    every = np.zeros(live.size, dtype=values.dtype) if dead is None else dead.copy()
    every[live] = values
    return every


def _decibel(share: float) -> float:
    return 10 * float(np.log10(max(share, 1e-30)))
