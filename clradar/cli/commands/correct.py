"""``clradar correct``: correct a capture for its channels, or for known gains of its antennas."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clradar.cli.console import print_line
from clradar.cli.options.common import CaptureArgument, CaptureOutput, ForceOption
from clradar.cli.options.groups import option, recorded
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_outputs, save
from clradar.cli.provenance import provenance
from clradar.files.failures import fail


def command(
    capture: CaptureArgument,
    *,
    channels: Path | None = option(None, "File of `clradar channels` (HDF5).", metavar="CHANNELS"),
    gains: bool = option(
        False,
        "Instead: divide by the gains that the array of the capture has (gain_db, phase_deg).",
    ),
    output: CaptureOutput,
    keep_noisy: bool = option(False, "Do not set noisy channels to zero."),
    frames: FrameOptions,
    force: ForceOption = False,
) -> None:
    """Pairs with a dead or noisy channel are set to zero. A capture of another array or other
    frequencies is refused.
    """
    if gains == (channels is not None):
        found = "both" if gains else "neither"
        raise wrong_usage("--channels", f"expected either that or --gains, got {found}")
    if gains and keep_noisy:
        raise wrong_usage("--keep-noisy", "expected together with --channels")
    if channels is None:
        _without_gains(capture, output, frames, force=force)
    else:
        _by_channels(capture, channels, output, frames, keep_noisy=keep_noisy, force=force)


def _without_gains(capture: Path, output: Path, frames: FrameOptions, *, force: bool) -> None:
    """Divide by the gains of the antennas."""
    check_outputs([output], force=force, inputs=[capture])
    loaded, files = frames.open(capture)
    if not loaded.array.has_gains:
        fail(capture, "an array with gains (docs/arrays.md)", "antennas that all have gain 1")
    options = recorded(frames, gains=True)
    corrected = loaded.without_gains()
    save(output, corrected, provenance("correct", options, files), force=force)
    levels_db = [20 * np.log10(np.abs(s.gain)) for s in loaded.array.sides if s.gain is not None]
    lowest_db, highest_db = np.concatenate(levels_db).min(), np.concatenate(levels_db).max()
    print_line(f"{output}: without gains of {lowest_db:.1f} to {highest_db:.1f} dB")


def _by_channels(
    capture: Path,
    channels: Path,
    output: Path,
    frames: FrameOptions,
    *,
    keep_noisy: bool,
    force: bool,
) -> None:
    """Divide by the responses of the channels."""
    from calibration import correct
    from calibration.channels.correction import MASKS
    from measurement_io import open_channels

    check_outputs([output], force=force, inputs=[capture, channels])
    measured = open_channels(channels)
    loaded, files = frames.open(capture)
    mask = [state for state in MASKS if state == "dead" or not keep_noisy]
    corrected = correct(loaded, measured, mask=mask)
    options = recorded(frames, channels=channels, keep_noisy=keep_noisy)
    inputs = [*files, channels]
    save(output, corrected, provenance("correct", options, inputs), force=force)
    record = corrected.meta["channels"]
    print_line(
        f"{output}: {100 * record['live_share']:.1f} % of the pairs left, without "
        f"{len(record['masked_tx'])} Tx and {len(record['masked_rx'])} Rx"
    )
