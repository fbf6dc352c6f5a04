"""What is done to a recorded capture before it is imaged, in one order."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Literal

from calibration.channels.correction import MASKS, correct
from calibration.clutter import range_gate, subtract_background
from clradar.model import Capture, ChannelCalibration


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
    if channels is not None:
        capture = correct(capture, channels, mask=mask)
    return capture
