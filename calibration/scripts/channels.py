"""Calibrate the channels on a plate, and correct a capture: a script to run, copy and edit.

    python calibration/scripts/channels.py plate.h5 -o channels.h5 --distance-mm 300
    python calibration/scripts/channels.py plate.h5 -o channels.h5 --distance-mm 300 \
        --correct hand.h5 --corrected hand-corrected.h5

`clradar channels` and `clradar clean` do the same with more options and targets;
docs/channel-calibration.md has the model and its observability.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from calibration import FlatPlate, correct, estimate_channels
from calibration.scripts.scripting import Force, refuse_existing, run
from measurement_io import open_capture, save_capture, save_channels


def main(
    capture: Annotated[Path, typer.Argument(help="Of a metal plate that faces the aperture.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Calibration, .h5.")],
    distance_mm: Annotated[float, typer.Option(help="From the aperture to the plate.")],
    to_correct: Annotated[
        Path | None, typer.Option("--correct", help="Another capture of the same instrument.")
    ] = None,
    corrected: Annotated[Path | None, typer.Option(help="Corrected capture, .h5.")] = None,
    force: Force = False,
) -> None:
    """Estimate gain, phase and delay of every channel from a capture of a flat plate."""
    if (to_correct is None) != (corrected is None):
        raise typer.BadParameter("expected both or neither", param_hint="--correct, --corrected")
    for path in (output, corrected):
        if path is not None:
            refuse_existing(path, force=force)
    # Sphere and CornerReflector of the same package are the other targets.
    channels = estimate_channels(open_capture(capture), FlatPlate(distance_mm / 1e3))
    save_channels(output, channels, force=force)
    for side, gain, dead in (
        ("Tx", channels.response.tx_gain, channels.dead_tx),
        ("Rx", channels.response.rx_gain, channels.dead_rx),
    ):
        gain_db = 20 * np.log10(np.abs(gain[gain != 0]))
        print(f"{side}: {gain_db.min():+.2f} to {gain_db.max():+.2f} dB, dead: {dead.tolist()}")
    print(f"{output}: {channels.residual_db:.1f} dB of the echoes is left")
    if to_correct is not None and corrected is not None:
        save_capture(corrected, correct(open_capture(to_correct), channels), force=force)


if __name__ == "__main__":
    run(main)
