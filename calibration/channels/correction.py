"""Equalisation of a capture by the estimated channel responses."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from clradar.errors import CalibrationError
from clradar.model import Capture, ChannelCalibration, checks

MASKS = ("dead", "noisy")
POSITION_TOLERANCE_M = 1e-6


def correct(
    capture: Capture, calibration: ChannelCalibration, *, mask: Collection[str] = MASKS
) -> Capture:
    """Divide a capture by the responses of its channels.

    a s[tx, rx, n] / (h_tx(f_n) h_rx(f_n)), and 0 for every pair with a masked channel. a is 1 over
    the fraction of pairs that remain: a point is as bright in an image as with all pairs.

    Parameters
    ----------
    capture : Capture
    calibration : ChannelCalibration
        Of the same array (to 1 µm) and waveform, else a `CalibrationError`.
    mask : collection of "dead", "noisy"
        Channels whose pairs are set to 0. Dead ones have to be: they have no gain.

    Returns
    -------
    Capture
        `meta["channels"]` has the masked channels, `live_share`, the fraction of pairs that remain,
        and `factor`, the a above.

    Examples
    --------
    The second Tx of `channels` is 90 degrees ahead:

    >>> data = calibration.correct(capture, channels).data
    >>> round(float(np.degrees(np.angle(data[1, 0, 1] / data[0, 0, 1]))))
    -90
    """
    checks.instance("correct: capture", capture, Capture)
    checks.instance("correct: calibration", calibration, ChannelCalibration)
    if not set(checks.several("correct: mask", mask)) <= set(MASKS):
        checks.fail("correct: mask", f"a collection out of {', '.join(MASKS)}", repr(mask))
    dead = calibration.dead_tx.size + calibration.dead_rx.size
    if dead and "dead" not in mask:
        checks.fail("correct: mask", f"'dead' in it, for {dead} channels without gain", repr(mask))
    _check_same(capture, calibration)
    frequencies_hz = capture.waveform.frequencies_hz
    masked, inverse, live, every = {}, {}, 1, 1
    for side in ("tx", "rx"):
        chosen = [getattr(calibration, f"{state}_{side}") for state in MASKS if state in mask]
        masked[side] = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *chosen]))
        response = getattr(calibration.response, f"{side}_response")(frequencies_hz)
        keep = ~np.isin(np.arange(len(response)), masked[side])
        inverse[side] = np.divide(1.0, response, out=np.zeros_like(response), where=keep[:, None])
        live, every = live * np.count_nonzero(keep), every * len(keep)
    live_share = live / every
    factor = 1.0 / live_share if live_share else 1.0
    data = capture.data * (factor * inverse["tx"][:, None] * inverse["rx"])
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
    differs = ""
    for side in ("tx", "rx"):
        have, want = (getattr(one.array, f"{side}_m") for one in (capture, calibration))
        if len(have) != len(want):
            differs = f"{len(have)} {side.title()} in place of {len(want)}"
        elif (off_m := np.linalg.norm(have - want, axis=1)).max() > POSITION_TOLERANCE_M:
            worst = int(off_m.argmax())
            differs = f"{side.title()} {worst} is {1e3 * off_m[worst]:.4g} mm away"
    if not capture.waveform.same_frequencies(calibration.waveform):
        all_ghz = (x.waveform.frequencies_hz / 1e9 for x in (capture, calibration))
        ends = (f"{ghz.size} from {ghz[0]:.9g} to {ghz[-1]:.9g} GHz" for ghz in all_ghz)
        differs = "frequencies {} in place of {}".format(*ends)
    if differs:
        raise CalibrationError(
            "correct: expected a capture of the array and waveform that were calibrated "
            f"('{calibration.array.name}'), got another ('{capture.array.name}'): {differs}"
        )
