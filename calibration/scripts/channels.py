"""Calibrate the channels on a plate: a script to run, copy and edit.

    python calibration/scripts/channels.py plate.h5 -o channels.h5 --distance-mm 300

`clradar channels` does the same with more options and targets; docs/channel-calibration.md has the
model and its observability. background.py corrects a capture by CHANNELS.
"""

import typer

from calibration import FlatPlate, estimate_channels
from calibration.scripts.scripting import Output, Recorded, run
from measurement_io import describe, open_capture, save_channels


def main(
    capture: Recorded,
    output: Output,
    distance_mm: float = typer.Option(..., help="From the aperture to the plate."),
) -> None:
    """Estimate gain, phase and delay of every channel from a capture of a flat plate."""
    # Sphere and CornerReflector of the same package are the other targets.
    save_channels(output, estimate_channels(open_capture(capture), FlatPlate(distance_mm / 1e3)))
    print(describe(output))


if __name__ == "__main__":
    run(main)
