"""What is done to recorded captures before they are imaged: means, the empty room, range gates.

Frames are averaged coherently, the empty room is subtracted by generalised least squares over
delay, and a range gate is a Wiener filter over frequency, against coupling, walls and mirrors.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Literal

import numpy as np

from calibration.channels.correction import MASKS, correct
from calibration.channels.fit import rank_one
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.model import Capture, ChannelCalibration, Waveform, checks
from clradar.model.capture import check_same_radar

SCALINGS = ("none", "common", "channel")
ROUNDS = 6  # of reweighting: each takes its weights from the residual of the last
MOST_GROUPS = 3  # of frames that agree, which are averaged until the largest is known
RESIDUAL_FLOOR = 1e-12  # residual power of a delay bin over the mean: bounds the weights
POWER_FLOOR = 1e-10  # of the strongest echo's power: below are sidelobes and rounding
AGREE_DB = 1.0  # at most that echoes of frames that agree lose in their mean
MOST_LOSS_DB = 30.0  # beyond it the echoes of two captures cancel each other

EDGE_CELLS = 4.0  # default width of the transition bands, in cells c / 2B: 6 cm for 10 GHz
CLUTTER_DB = 40.0
EDGE_WEIGHT = 0.03  # of the transition bands: with less, echoes in them can grow, fourfold at 0.001
NOISE_POWER = 1e-3  # over the scene's, per delay: keeps the gate from amplifying noise
PROBES_PER_CELL = 8


def clean(
    capture: Capture,
    *,
    empty: Capture | None = None,
    scaling: Literal["none", "common", "channel"] = "none",
    gate: Mapping[str, Any] | None = None,
    channels: ChannelCalibration | None = None,
    mask: Collection[str] = MASKS,
) -> Capture:
    """Subtract the empty room, gate in range, correct the channels: in this order, what is given.

    Parameters
    ----------
    capture : Capture
    empty, scaling
        As of `subtract_background`.
    gate : mapping, optional
        Arguments of `range_gate`.
    channels, mask
        `calibration` and `mask` of `correct`.

    Examples
    --------
    >>> found = calibration.clean(frames[2], empty=frames[0])
    >>> complex(found.data[0, 0, 0]), list(found.meta)
    ((2-2j), ['background'])
    """
    if empty is not None:
        capture = subtract_background(capture, empty, scaling=scaling)
    if gate is not None:
        capture = range_gate(capture, **gate)
    return capture if channels is None else correct(capture, channels, mask=mask)


def average_frames(captures: Iterable[Capture], *, align_phase: bool = False) -> Capture:
    """Average frames of a static scene coherently: the largest group of those that agree.

    Frames agree unless echoes of any delay would be 1 dB weaker in their mean.

    Parameters
    ----------
    captures : iterable of Capture
    align_phase : bool
        First rotate every frame by the phase that maximises its correlation with the sum of those
        before it, against a drift common to all channels.

    Returns
    -------
    Capture
        With the metadata in which all frames agree, and `meta["average"]`: the number of frames,
        the phases by which they were rotated, radians, and those left out, counted from 0.

    Examples
    --------
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])
    >>> frames = [clradar.Capture([[[v]]], array, clradar.Waveform([77e9])) for v in (2, 2j)]
    >>> for align_phase in (False, True):
    ...     mean = calibration.average_frames(frames, align_phase=align_phase)
    ...     print(np.round(mean.data[0, 0, 0], 3))
    (1+1j)
    (2+0j)
    """
    groups: list[_Mean] = []
    worst, count = (0.0, 0), 0
    for count, capture in enumerate(checks.several("average_frames: captures", captures), 1):
        field = f"average_frames: frame {count - 1}"
        checks.instance(field, capture, Capture)
        if groups:
            check_same_radar(field, capture, groups[0].first)
        profiles = delay_profiles(capture)
        for group in groups:
            phase = float(np.angle(np.vdot(capture.data, group.total))) if align_phase else 0.0
            phasor = np.exp(1j * phase)
            turned = np.complex64(phasor) * profiles
            loss = averaging_loss_db(turned, group.profiles / np.float32(len(group.numbers)))
            if loss[0] <= AGREE_DB:
                group.add(capture, turned, phasor, count - 1)
                break
            worst = max(worst, loss)
        else:
            alone = [group for group in groups if len(group.numbers) == 1]
            if alone and len(groups) == MOST_GROUPS:  # as while something moved
                groups.remove(alone[0])
            if len(groups) < MOST_GROUPS:
                groups.append(_Mean(capture, profiles, count - 1))
    if not groups:
        checks.fail("average_frames", "at least one frame", "none")
    best = max(groups, key=lambda group: len(group.numbers))  # of equal ones the first
    record: dict[str, Any] = {"frames": len(best.numbers), "align_phase": bool(align_phase)}
    if align_phase:
        record["turned_rad"] = best.turned_rad
    left_out = sorted({*range(count)} - {*best.numbers})
    if left_out:
        record["left_out"] = left_out
        range_mm = 500 * path_lengths_m(best.first.waveform)[worst[1]]
        warn(
            f"{len(left_out)} of {count} frames left out of the average (the first: number "
            f"{left_out[0]}, counted from 0), since they do not agree with the others: echoes from "
            f"{range_mm:.0f} mm would be {worst[0]:.1f} dB weaker. Something moved, or the phase "
            "drifted, which align_phase takes out"
        )
    first, mean = best.first, best.total / len(best.numbers)
    return Capture(mean, first.array, first.waveform, {**best.common, "average": record})


class _Mean:
    """The sum of frames that agree, with what they have in common."""

    def __init__(self, capture: Capture, profiles: np.ndarray, number: int) -> None:
        self.first, self.profiles, self.common = capture, profiles, dict(capture.meta)
        self.total = capture.data.astype(np.complex128)
        self.numbers, self.turned_rad = [number], [0.0]

    def add(self, capture: Capture, profiles: np.ndarray, phasor: complex, number: int) -> None:
        """Add a frame that is turned by a phasor, as its delay profiles are already."""
        self.profiles += profiles
        self.total += phasor * capture.data
        self.common = {
            k: v for k, v in self.common.items() if k in capture.meta and capture.meta[k] == v
        }
        self.numbers.append(number)
        self.turned_rad.append(float(np.angle(phasor)))


def subtract_background(capture: Capture, empty: Capture, *, scaling: str = "none") -> Capture:
    """Subtract a capture that was recorded without the object.

    The noise of `empty` is added to the result: average many frames without the object.

    Parameters
    ----------
    capture, empty : Capture
        Same antennas, same frequencies.
    scaling : {"none", "common", "channel"}
        What `empty` is multiplied by first: nothing, one complex factor for all (the generator
        drifted), or one per Tx times one per Rx (the channels drifted); by feasible generalised
        least squares over the delay bins.

    Returns
    -------
    Capture
        `meta["background"]` holds the factors as [real, imaginary] and the metadata of `empty`.

    Examples
    --------
    Of a room whose echoes have become three times as strong nothing is left:

    >>> left = calibration.subtract_background(frames[2], frames[0], scaling="common")
    >>> real, imaginary = left.meta["background"]["factor"]
    >>> print(f"{real:.3f}", bool(np.abs(left.data).max() < 1e-5))
    3.000 True
    """
    checks.instance("subtract_background: capture", capture, Capture)
    checks.instance("subtract_background: empty", empty, Capture)
    check_same_radar("subtract_background: empty", empty, capture)
    scaling = checks.one_of("subtract_background: scaling", scaling, SCALINGS)
    if capture.meta.get("variant") == "emptyfiltered" or "background" in capture.meta:
        warn(
            "an empty room is subtracted already from the capture (its variant is emptyfiltered, "
            "or it has a background); take the raw one"
        )
    record: dict[str, Any] = {"scaling": scaling, "empty": dict(empty.meta)}
    tx, rx = (np.ones(n, complex) for n in (capture.array.n_tx, capture.array.n_rx))
    if scaling != "none":
        if not empty.data.any():
            checks.fail("subtract_background: empty", "something to scale", "zeros only")
        tx, rx = _fitted(delay_profiles(capture), delay_profiles(empty), scaling == "channel")
        of_tx, of_rx = (np.stack([side.real, side.imag], axis=1).tolist() for side in (tx, rx))
        common = scaling == "common"
        record |= {"factor": of_tx[0]} if common else {"tx_factor": of_tx, "rx_factor": of_rx}
    data = capture.data - np.outer(tx, rx)[:, :, None] * empty.data
    meta = {**capture.meta, "background": record}
    return Capture(data, capture.array, capture.waveform, meta)


def _fitted(
    measured: np.ndarray, known: np.ndarray, per_channel: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Factors of Tx and Rx that bring the delay profiles of the empty room nearest to others."""
    tx, rx = (np.ones(n, complex) for n in known.shape[:2])
    product = known.conj() * measured
    power = np.abs(known).astype(np.float64) ** 2
    in_bin = power.mean(axis=(0, 1))
    floor = RESIDUAL_FLOOR * float(in_bin.mean())
    # Bins without echoes hold noise in place of the background; fitted to, it would pull the
    # factors towards zero. The weakest bin estimates the noise.
    known_share = (1 - in_bin.min() / np.maximum(in_bin, floor)).clip(0) ** 2
    if not known_share.any():
        known_share[:] = 1
    weights = known_share
    for _ in range(ROUNDS):
        cross, strength = product @ weights, power @ weights
        if per_channel:
            tx, rx = rank_one(cross, strength, tx, rx)
            # The product leaves one factor free: rx gets an RMS of 1 and mean phase 0.
            between = np.sqrt((np.abs(rx) ** 2).mean()) * np.exp(1j * np.angle(rx.sum()))
            tx, rx = tx * between, rx / between
        else:
            tx = np.full_like(tx, cross.sum() / strength.sum())
        left = np.abs(measured - np.outer(tx, rx)[:, :, None] * known) ** 2
        weights = known_share / (left.mean(axis=(0, 1)) + floor)
        weights /= weights.max()
    return tx, rx


def path_lengths_m(waveform: Waveform) -> np.ndarray:
    """Path lengths of the bins of `delay_profiles`, shape (n_freq,), metres."""
    n = waveform.n_freq
    period_m = (n - 1) / n * SPEED_OF_LIGHT_M_PER_S / max(waveform.span_hz, 1.0)
    return np.asarray(np.arange(n) * period_m)


def delay_profiles(capture: Capture) -> np.ndarray:
    """Delay profiles, Hann window, shape (n_tx, n_rx, n_freq), complex64."""
    waveform, n = capture.waveform, capture.waveform.n_freq
    offsets_hz = waveform.frequencies_hz - waveform.center_hz
    cycles = np.outer(offsets_hz, path_lengths_m(waveform)) / SPEED_OF_LIGHT_M_PER_S
    # Without the two zeros at the ends, which would discard samples (all of them for two).
    window = np.hanning(n + 2)[1:-1]
    transform = window[:, None] * np.exp(2j * np.pi * cycles) / np.sqrt(n)
    return np.asarray((capture.data @ transform).astype(np.complex64))


def averaging_loss_db(one: np.ndarray, other: np.ndarray) -> tuple[float, int]:
    """How much weaker the echoes of two captures are in their mean where they lose most, and where.

    Both are delay profiles; 0 dB where they differ by no more than noise. In bin q with the powers
    P1 and P2 over all pairs and that of the difference, D, the power of the mean is
    (P1 + P2)/2 - D/4 of (P1 + P2)/2. Noise is white, so it adds the same to D in every bin: the
    median over the bins, which echoes that moved fill only a part of. The estimate of D in a bin
    from n pairs scatters by 1/sqrt(n); six times that is taken for noise, too. A phase difference
    of phi costs -20 log10(cos(phi/2)) dB: 1 dB at 54 degrees, or 0.29 mm at 77 GHz.
    """

    def powers(profiles: np.ndarray) -> np.ndarray:
        return np.asarray((np.abs(profiles) ** 2).sum(axis=(0, 1), dtype=np.float64))

    power, difference = powers(one) + powers(other), powers(one - other)
    pairs = one.shape[0] * one.shape[1]
    noise = float(np.median(difference)) * (1 + 6 / math.sqrt(pairs))
    floor = POWER_FLOOR * float(power.max())
    changed = (difference - noise).clip(0)
    share = np.divide(changed, 2 * power, out=np.zeros_like(power), where=power > floor).clip(0, 1)
    worst = int(share.argmax())
    left = max(1 - float(share[worst]), 10 ** (-MOST_LOSS_DB / 10))
    return -10 * math.log10(left), worst


def range_gate(
    capture: Capture,
    *,
    near_m: float,
    far_m: float,
    edge_m: float | None = None,
    clutter_db: float = CLUTTER_DB,
) -> Capture:
    """Remove the echoes from outside a range window.

    Range is half of the path length, ``(|p - tx| + |p - rx|) / 2``, the same window for every pair.
    docs/background.md has what is lost and rejected, E11 of docs/equations.md the gate.

    Parameters
    ----------
    capture : Capture
    near_m, far_m : float
        Echoes in between are kept; far_m is below the unambiguous range c / 2 df.
    edge_m : float, optional
        Width of the bands on either side, beyond which echoes are rejected. Default: four
        resolution cells c / 2B, 60 mm for 10 GHz.
    clutter_db : float
        Power of the echoes outside relative to those inside, roughly: more rejects better, and
        distorts the window more.

    Returns
    -------
    Capture
        `meta["range_gate"]` has the window, the smallest gain in it, `passband_db`, and suppression
        beyond the bands, `rejection_db`.

    Examples
    --------
    An echo at 0.15 m is kept, one at 0.4 m is rejected:

    >>> from clradar import reference
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
    >>> for z_m in (0.15, 0.4):
    ...     echo = reference.point_targets(array, waveform, [[0, 0, z_m]], [1.0])
    ...     gated = calibration.range_gate(echo, near_m=0.1, far_m=0.2)
    ...     gain = np.linalg.norm(gated.data) / np.linalg.norm(echo.data)
    ...     print(f"{20 * np.log10(gain):.1f} dB")
    -0.4 dB
    -67.8 dB
    """
    checks.instance("range_gate: capture", capture, Capture)
    matrix, record = gate(capture.waveform, near_m, far_m, edge_m, clutter_db)
    meta = {**capture.meta, "range_gate": record}
    return Capture(capture.data @ matrix.T, capture.array, capture.waveform, meta)


def gate(
    waveform: Waveform,
    near_m: float,
    far_m: float,
    edge_m: float | None = None,
    clutter_db: float = CLUTTER_DB,
) -> tuple[np.ndarray, dict[str, float]]:
    """Return the linear map over the frequencies of a pair, (n_freq, n_freq), and its record.

    E11 of docs/equations.md: every integral is a sinc, so the frequency steps may differ.
    """
    if waveform.n_freq < 2:
        checks.fail("range_gate: waveform", "two frequencies or more", "one, which has no range")
    cell_m = SPEED_OF_LIGHT_M_PER_S / (2 * waveform.span_hz)
    near, far = checks.real("range_gate: near_m", near_m), checks.real("range_gate: far_m", far_m)
    edge_m = EDGE_CELLS * cell_m if edge_m is None else edge_m
    edge = checks.within("range_gate: edge_m", edge_m, 0.0, math.inf, " m")
    clutter = checks.within("range_gate: clutter_db", clutter_db, 0.0, 100.0, " dB")
    given = {"near_m": near, "far_m": far, "edge_m": edge, "clutter_db": clutter}
    period_m = SPEED_OF_LIGHT_M_PER_S / (2 * float(np.diff(waveform.frequencies_hz).max()))
    if not 0 <= near < far:
        checks.fail("range_gate", "0 <= near_m < far_m", f"{near:g} and {far:g}")
    if far > period_m:
        expected = "where ranges start to repeat with these frequency steps"
        checks.fail("range_gate: far_m", f"at most {period_m:.4g} m, {expected}", f"{far:g} m")
    if far - near + 2 * edge >= period_m:
        checks.fail(
            "range_gate",
            f"a window with its edges shorter than the unambiguous {period_m:.4g} m",
            f"{far - near:g} m and two edges of {edge:g} m: nothing is left to reject",
        )

    offsets_hz = waveform.frequencies_hz - waveform.center_hz
    inside = _gram(offsets_hz, near, far, period_m)
    edges = _gram(offsets_hz, near - edge, near, period_m)
    edges += _gram(offsets_hz, far, far + edge, period_m)
    outside = _gram(offsets_hz, far + edge, period_m + near - edge, period_m)
    wanted = inside + EDGE_WEIGHT / 2 * edges
    whole = inside + EDGE_WEIGHT * edges + 10 ** (clutter / 10) * outside
    whole += NOISE_POWER * np.eye(waveform.n_freq)
    matrix = np.linalg.solve(whole, wanted).conj().T  # both are Hermitian

    def responses(low_m: float, high_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Echoes an eighth of a resolution cell apart, before and after the gate, (n_freq, n)."""
        count = int(np.ceil(PROBES_PER_CELL * (high_m - low_m) / cell_m)) + 2
        range_m = np.linspace(low_m, high_m, count)
        echoes = np.exp(-4j * np.pi / SPEED_OF_LIGHT_M_PER_S * np.outer(offsets_hz, range_m))
        return echoes, matrix @ echoes

    echoes, kept = responses(near, far)
    passband = np.abs((echoes.conj() * kept).mean(axis=0)).min()
    _, left = responses(far + edge, period_m + near - edge)
    rejected = np.sqrt((np.abs(left) ** 2).mean(axis=0)).max()
    passband_db, left_db = 20 * np.log10(np.maximum([passband, rejected], 1e-15))
    return matrix, {**given, "passband_db": float(passband_db), "rejection_db": -float(left_db)}


def _gram(offsets_hz: np.ndarray, low_m: float, high_m: float, period_m: float) -> np.ndarray:
    """Integral of a a^H over half path lengths, in periods, shape (n_freq, n_freq)."""
    difference = 2 * (offsets_hz[:, None] - offsets_hz) / SPEED_OF_LIGHT_M_PER_S
    width_m, middle_m = high_m - low_m, (high_m + low_m) / 2
    phasors = np.exp(-2j * np.pi * difference * middle_m)
    return width_m / period_m * np.sinc(difference * width_m) * phasors
