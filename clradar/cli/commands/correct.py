"""``clradar correct``: correct a capture for gain and delay of its channels."""

from __future__ import annotations

from pathlib import Path

from clradar.cli.console import print_line
from clradar.cli.options.common import CaptureArgument, CaptureOutput, ForceOption
from clradar.cli.options.groups import REQUIRED, option, recorded
from clradar.cli.options.recording import FrameOptions
from clradar.cli.outputs import check_outputs, save
from clradar.cli.provenance import provenance


def command(
    capture: CaptureArgument,
    *,
    channels: Path = option(REQUIRED, "File of `clradar channels` (HDF5)."),
    output: CaptureOutput,
    keep_noisy: bool = option(False, "Do not set noisy channels to zero."),
    frames: FrameOptions,
    force: ForceOption = False,
) -> None:
    """Pairs with a dead or noisy channel are set to zero. A capture of another array or other
    frequencies is refused.
    """
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
