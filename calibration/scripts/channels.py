"""Calibrate the channels on a plate: a script to run, copy and edit.

    python calibration/scripts/channels.py plate.h5 -o channels.h5 --distance-mm 300

`clradar channels` does the same with more options and targets; docs/channel-calibration.md has the
model and its observability. background.py corrects a capture by CHANNELS.
"""

import numpy as np
import typer

from calibration import FlatPlate, estimate_channels
from calibration.scripts.scripting import Output, Recorded, run
from measurement_io import open_capture, save_channels


def main(
    capture: Recorded,
    output: Output,
    distance_mm: float = typer.Option(..., help="From the aperture to the plate."),
) -> None:
    """Estimate gain, phase and delay of every channel from a capture of a flat plate."""
    # Sphere and CornerReflector of the same package are the other targets.
    channels = estimate_channels(open_capture(capture), FlatPlate(distance_mm / 1e3))
    save_channels(output, channels)
    for side, gain in (("Tx", channels.response.tx_gain), ("Rx", channels.response.rx_gain)):
        gain_db = 20 * np.log10(np.abs(gain[gain != 0]))
        dead = np.flatnonzero(gain == 0).tolist()
        print(f"{side}: {gain_db.min():+.2f} to {gain_db.max():+.2f} dB, dead: {dead}")
    print(f"{output}: {channels.residual_db:.1f} dB of the echoes is left")


if __name__ == "__main__":
    run(main)
