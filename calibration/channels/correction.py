"""Take the channels of the instrument off a capture."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from clradar.errors import CalibrationError
from clradar.model import Capture, ChannelCalibration, checks

MASKS = ("dead", "noisy")
POSITION_TOLERANCE_M = 1e-6


def correct(
    capture: Capture,
    calibration: ChannelCalibration,
    *,
    mask: Collection[str] = MASKS,
    keep_level: bool = True,
) -> Capture:
    """Return a capture as ideal channels would have recorded it.

    a s[tx, rx, n] / (h_tx(f_n) h_rx(f_n)), and 0 for every pair with a masked channel.

    Parameters
    ----------
    capture : Capture
        Of the array and the waveform that were calibrated.
    calibration : ChannelCalibration
    mask : collection of "dead", "noisy"
        Which channels' pairs are set to 0. Dead ones cannot be left in: they have no gain.
    keep_level : bool
        a is 1 over the share of pairs that are left, so that a point in an image, which divides by
        all pairs, is as bright as with all of them. Otherwise a = 1.

    Returns
    -------
    Capture
        `meta["channels"]` has the masked channels, `live_share`, the share of pairs that are left,
        and `factor`, the a above.

    Raises
    ------
    CalibrationError
        Another array or another waveform; the message says what differs.
    ModelError
        An argument that cannot be meant, or dead channels that are not masked.
    """
    checks.instance("correct: capture", capture, Capture)
    checks.instance("correct: calibration", calibration, ChannelCalibration)
    if isinstance(mask, str) or not set(mask) <= set(MASKS):
        checks.fail("correct: mask", f"a collection out of {', '.join(MASKS)}", repr(mask))
    dead = calibration.dead_tx.size + calibration.dead_rx.size
    if dead and "dead" not in mask:
        checks.fail("correct: mask", f"'dead' in it, for {dead} channels without gain", repr(mask))
    _check_same(capture, calibration)
    frequencies_hz = capture.waveform.frequencies_hz
    masked = {}
    inverse = {}
    for side in ("tx", "rx"):
        chosen = [getattr(calibration, f"{state}_{side}") for state in MASKS if state in mask]
        masked[side] = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *chosen]))
        response = getattr(calibration.response, f"{side}_response")(frequencies_hz)
        keep = np.ones(len(response), dtype=bool)
        keep[masked[side]] = False
        inverse[side] = np.zeros_like(response)
        inverse[side][keep] = 1.0 / response[keep]
    live = [len(inverse[side]) - masked[side].size for side in ("tx", "rx")]
    live_share = live[0] * live[1] / (len(inverse["tx"]) * len(inverse["rx"]))
    factor = 1.0 / live_share if keep_level and live_share else 1.0
    data = np.empty_like(capture.data)
    for i, row in enumerate(capture.data):
        data[i] = row * (factor * inverse["tx"][i] * inverse["rx"])
    record = {
        "masked_tx": masked["tx"].tolist(),
        "masked_rx": masked["rx"].tolist(),
        "live_share": live_share,
        "factor": factor,
        "target": calibration.target,
        "residual_db": calibration.residual_db,
    }
    return replace(capture, data=data, meta={**capture.meta, "channels": record})


def _check_same(capture: Capture, calibration: ChannelCalibration) -> None:
    ours, theirs = capture.array, calibration.array
    for side in ("tx", "rx"):
        have, want = getattr(ours, f"{side}_m"), getattr(theirs, f"{side}_m")
        if len(have) != len(want):
            raise CalibrationError(
                f"correct: expected a capture with the {len(want)} {side.title()} of the array "
                f"that was calibrated ('{theirs.name}'), got {len(have)} ('{ours.name}')"
            )
        off_m = np.linalg.norm(have - want, axis=1)
        if not ours.same_positions(theirs, POSITION_TOLERANCE_M) and off_m.max() > 0:
            worst = int(off_m.argmax())
            raise CalibrationError(
                "correct: expected a capture of the array that was calibrated "
                f"('{theirs.name}'), got another ('{ours.name}'): {side.title()} {worst} is "
                f"{1e3 * off_m[worst]:.4g} mm away from where it was"
            )
    if not capture.waveform.same_frequencies(calibration.waveform):
        have_hz, want_hz = (x.waveform.frequencies_hz for x in (capture, calibration))
        raise CalibrationError(
            f"correct: expected a capture of the waveform that was calibrated ({_sweep(want_hz)}), "
            f"got another ({_sweep(have_hz)})"
        )


def _sweep(frequencies_hz: np.ndarray) -> str:
    low, high = frequencies_hz[[0, -1]] / 1e9
    return f"{frequencies_hz.size} frequencies from {low:.9g} to {high:.9g} GHz"
