"""``clradar correct``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clradar.cli.images import recording_files
from clradar.cli.options import ForceOption, FrameOption, VariantOption
from clradar.cli.output import check_outputs, print_line
from clradar.cli.simulate import save_with_provenance


def command(
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE", help="Native capture, recorded .npy frame, or radar folder."
        ),
    ],
    channels: Annotated[
        Path, typer.Option("--channels", help="What `clradar channels` wrote (HDF5).")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture to write (HDF5).")],
    keep_noisy: Annotated[
        bool, typer.Option("--keep-noisy", help="Do not set noisy channels to zero.")
    ] = False,
    frame: FrameOption = None,
    variant: VariantOption = None,
    force: ForceOption = False,
) -> None:
    """Pairs with a dead or noisy channel are set to zero. A capture of another array or other
    frequencies is refused.
    """
    from calibration import correct
    from calibration.channels.correction import MASKS
    from measurement_io import open_capture, open_channels

    check_outputs([output], force=force, inputs=[capture, channels])
    measured = open_channels(channels)
    loaded = open_capture(capture, frame=frame, variant=None if variant is None else variant.value)
    mask = [state for state in MASKS if state == "dead" or not keep_noisy]
    corrected = correct(loaded, measured, mask=mask)
    options = {
        "channels": str(channels),
        "keep_noisy": keep_noisy,
        "frame": frame,
        "variant": None if variant is None else variant.value,
    }
    inputs = [*recording_files(capture, loaded.meta), channels]
    save_with_provenance(output, corrected, "correct", options, inputs, force=force)
    record = corrected.meta["channels"]
    print_line(
        f"{output}: {100 * record['live_share']:.1f} % of the pairs left, without "
        f"{len(record['masked_tx'])} Tx and {len(record['masked_rx'])} Rx"
    )
