"""Coherent averaging of frames, and background subtraction by generalised least squares."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from calibration.clutter.delay_profiles import (
    averaging_loss_db,
    delay_profiles,
    path_lengths_m,
)
from clradar.errors import warn
from clradar.model import Capture, checks
from clradar.model.capture import check_same_radar

SCALINGS = ("none", "common", "channel")
ROUNDS = 6
"""Reweighting rounds: each takes its weights from the residual of the last."""
ALTERNATIONS = 20
"""Alternating least-squares steps between Tx and Rx factors; converged to rounding long before."""
RESIDUAL_FLOOR = 1e-12
"""Smallest residual power of a delay bin, relative to the mean: bounds the weights."""


def average_frames(
    captures: Iterable[Capture], *, align_phase: bool = False, max_loss_db: float = 1.0
) -> Capture:
    """Average frames of a static scene coherently, those that agree.

    Parameters
    ----------
    captures : iterable of Capture
        Only one at a time is held, besides the sum.
    align_phase : bool
        Rotate every frame by the phase that maximises its correlation with the sum of those before
        it. For a phase drift common to all channels; a change of the scene would be rotated, too.
    max_loss_db : float, decibel
        A frame is left out where echoes of any delay would be this much weaker in its mean with
        the average of those before it: something moved, or the generator drifted. A noisy echo is
        no weaker than others.

    Returns
    -------
    Capture
        With the metadata in which all frames agree; `meta["average"]` holds the number of frames,
        the phases by which they were rotated, radians, and the frames that were left out, counted
        from 0.

    Raises
    ------
    ModelError
        No frame, something that is not a capture, other antennas or frequencies than the first.

    Warns
    -----
    ClradarWarning
        Frames that do not agree are left out.

    Notes
    -----
    Summed in complex128. Noise that is independent from frame to frame goes down by 10 log10(n) dB.
    How the loss is told from noise: `clutter.delay_profiles.averaging_loss_db`.

    Examples
    --------
    >>> import clradar, numpy as np
    >>> from clradar import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])
    >>> waveform = clradar.Waveform([77e9])
    >>> frames = [clradar.Capture(np.full((1, 1, 1), v), array, waveform) for v in (2, 2j)]
    >>> for align_phase in (False, True):
    ...     mean = calibration.average_frames(frames, align_phase=align_phase)
    ...     print(np.round(mean.data[0, 0, 0], 3))
    (1+1j)
    (2+0j)
    """
    first: Capture | None = None
    total = np.zeros(0, np.complex128)
    common: dict[str, Any] = {}
    rotated_rad: list[float] = []
    profiles = np.zeros(0, np.complex64)
    left_out: list[int] = []
    worst = (0.0, 0)
    max_loss_db = checks.positive("average_frames: max_loss_db", max_loss_db)
    for number, capture in enumerate(captures):
        field = f"average_frames: frame {number}"
        checks.instance(field, capture, Capture)
        if first is None:
            first = capture
            total = capture.data.astype(np.complex128)
            common = dict(capture.meta)
            rotated_rad.append(0.0)
            profiles = delay_profiles(capture)
            continue
        check_same_radar(field, capture, first)
        phase = float(np.angle(_inner(capture.data, total))) if align_phase else 0.0
        phasor = np.exp(1j * phase)
        own = np.complex64(phasor) * delay_profiles(capture)
        loss_db, delay_bin = averaging_loss_db(own, profiles / np.float32(len(rotated_rad)))
        if loss_db > max_loss_db:
            left_out.append(number)
            worst = max(worst, (loss_db, delay_bin))
            continue
        profiles += own
        common = {k: v for k, v in common.items() if k in capture.meta and capture.meta[k] == v}
        rotated_rad.append(phase)
        for tx in range(len(total)):  # no name for a row, which would keep the frame
            total[tx] += phasor * capture.data[tx].astype(np.complex128)
    if first is None:
        checks.fail("average_frames", "at least one frame", "none")
    total /= len(rotated_rad)
    record: dict[str, Any] = {"frames": len(rotated_rad), "align_phase": bool(align_phase)}
    if align_phase:
        record["turned_rad"] = rotated_rad
    if left_out:
        record["left_out"] = left_out
        range_mm = 500 * path_lengths_m(first.waveform)[worst[1]]
        warn(
            f"{len(left_out)} of {len(left_out) + len(rotated_rad)} frames left out of the "
            f"average (the first: number {left_out[0]}, counted from 0), since they do not agree "
            f"with those before: echoes from {range_mm:.0f} mm would be {worst[0]:.1f} dB "
            "weaker. Something moved, or the phase drifted, which align_phase takes out"
        )
    return Capture(total, first.array, first.waveform, {**common, "average": record})


def subtract_background(capture: Capture, empty: Capture, *, scaling: str = "none") -> Capture:
    """Subtract a capture that was recorded without the object.

    Parameters
    ----------
    capture, empty : Capture
        Same antennas, same frequencies.
    scaling : {"none", "common", "channel"}
        What the empty capture is multiplied by first: nothing, one complex factor for all (the
        generator drifted), or one per Tx times one per Rx (the channels drifted).

    Returns
    -------
    Capture
        `meta["background"]` holds the factors as [real, imaginary] and the metadata of `empty`.

    Raises
    ------
    ModelError
        Other antennas or frequencies, an unknown scaling, or an empty capture that is zero where it
        has to be scaled.

    Warns
    -----
    ClradarWarning
        An empty room is subtracted from `capture` already, by its metadata.

    Notes
    -----
    The factors minimise ``sum_q w_q |Y_q - u_tx v_rx E_q|^2`` over the delay bins q of both (Hann
    window over frequency). Ordinary least squares (w = 1) would fit the background to the object as
    well. The object is the disturbance here, so each bin is weighted by the inverse of its residual
    power, averaged over the pairs, and the fit is repeated (feasible generalised least squares):
    bins that the object reaches hardly count, those of coupling and walls alone decide.
    docs/background.md has measured errors.

    The noise of `empty` is added to the result: average many frames without the object.

    Examples
    --------
    >>> import clradar, numpy as np
    >>> from clradar import calibration
    >>> from clradar import reference
    >>> q = clradar.arrays.qar50()
    >>> array = clradar.AntennaArray(q.tx_m[::12], q.rx_m[::12])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> empty = reference.point_targets(array, waveform, [[0, 0, 0.4]], [3.0])
    >>> both = reference.point_targets(
    ...     array, waveform, [[0, 0, 0.4], [0, 0, 0.3]], [3j, 1.0])
    >>> left = calibration.subtract_background(both, empty, scaling="common")
    >>> factor = complex(*left.meta["background"]["factor"])
    >>> print(f"{abs(factor):.3f} at {np.degrees(np.angle(factor)):.0f} degrees")
    1.000 at 90 degrees
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
    tx_factor = np.ones(capture.array.n_tx, np.complex128)
    rx_factor = np.ones(capture.array.n_rx, np.complex128)
    if scaling != "none":
        if not empty.data.any():
            checks.fail("subtract_background: empty", "something to scale", "zeros only")
        tx_factor, rx_factor = _fitted(capture, empty, per_channel=scaling == "channel")
        if scaling == "common":
            record["factor"] = _real_imaginary(tx_factor[:1])[0]
        else:
            record["tx_factor"] = _real_imaginary(tx_factor)
            record["rx_factor"] = _real_imaginary(rx_factor)
    data = np.empty(capture.data.shape, np.complex64)
    for tx, out in enumerate(data):
        scaled = (tx_factor[tx] * rx_factor)[:, None] * empty.data[tx].astype(np.complex128)
        out[:] = capture.data[tx] - scaled
    data.flags.writeable = False
    meta = {**capture.meta, "background": record}
    return Capture(data, capture.array, capture.waveform, meta)


def _fitted(
    capture: Capture, empty: Capture, *, per_channel: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Factors of Tx and Rx that bring the empty capture nearest to the other."""
    measured, known = delay_profiles(capture), delay_profiles(empty)
    tx = np.ones(capture.array.n_tx, np.complex128)
    rx = np.ones(capture.array.n_rx, np.complex128)
    power_in_bin = np.stack([(np.abs(k) ** 2).mean(axis=0) for k in known]).mean(axis=0)
    floor = RESIDUAL_FLOOR * float(power_in_bin.mean())
    # Bins without echoes hold noise in place of the background; fitted to, it would pull the
    # factors towards zero. The weakest bin estimates the noise.
    known_share = (1 - power_in_bin.min() / np.maximum(power_in_bin, floor)).clip(0) ** 2
    if not known_share.any():
        known_share[:] = 1
    weights = known_share
    for _ in range(ROUNDS):
        cross = np.stack([(k.conj() * m) @ weights for k, m in zip(known, measured, strict=True)])
        power = np.stack([np.abs(k) ** 2 @ weights for k in known])
        if per_channel:
            tx, rx = _rank_one_factors(cross, power, tx, rx)
        else:
            tx = np.full_like(tx, cross.sum() / power.sum())
        left = np.zeros(len(weights))
        for m, k, factor in zip(measured, known, tx, strict=True):
            left += (np.abs(m - (factor * rx)[:, None] * k) ** 2).sum(axis=0)
        weights = known_share / (left / (len(tx) * len(rx)) + floor)
        weights /= weights.max()
    return tx, rx


def _rank_one_factors(
    cross: np.ndarray, power: np.ndarray, tx: np.ndarray, rx: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Minimise sum_tr power |cross / power - tx rx|^2 by alternating least squares.

    A channel without power keeps its factor.
    """
    for _ in range(ALTERNATIONS):
        tx = _quotient(cross @ rx.conj(), power @ np.abs(rx) ** 2, tx)
        rx = _quotient(cross.T @ tx.conj(), power.T @ np.abs(tx) ** 2, rx)
    # The product leaves one factor between tx and rx free: rx gets an RMS of 1 and mean phase 0.
    between = np.sqrt((np.abs(rx) ** 2).mean()) * np.exp(1j * np.angle(rx.sum()))
    return tx * between, rx / between


def _quotient(above: np.ndarray, below: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    return np.divide(above, below, out=otherwise.copy(), where=below > 0)


def _inner(a: np.ndarray, b: np.ndarray) -> complex:
    """sum conj(a) b in double precision, a row at a time."""
    return complex(sum(np.vdot(x.astype(np.complex128), y) for x, y in zip(a, b, strict=True)))


def _real_imaginary(values: np.ndarray) -> list[list[float]]:
    return np.stack([values.real, values.imag], axis=1).tolist()
