"""Clean a capture of background, ranges and channels: a script to run, copy and edit.

    python calibration/scripts/background.py hand.h5 --empty empty.h5 -o clean.h5
    python calibration/scripts/background.py hand.h5 --gate-mm 250 400 -o clean.h5
    python calibration/scripts/background.py hand.h5 --channels channels.h5 -o clean.h5

`clradar clean` does the same with more options; docs/background.md explains them.
"""

from pathlib import Path

import numpy as np

from calibration import clean
from calibration.scripts.scripting import Output, Recorded, run
from measurement_io import open_capture, open_channels, save_capture


def main(
    capture: Recorded,
    output: Output,
    empty: Path | None = None,
    gate_mm: tuple[float, float] | None = None,
    channels: Path | None = None,
) -> None:
    """Subtract EMPTY, recorded without the object, keep ranges, divide by CHANNELS."""
    recorded = open_capture(capture)
    # "none" subtracts as recorded; "common" and "channel" scale the empty capture first.
    cleaned = clean(
        recorded,
        empty=open_capture(empty) if empty else None,
        scaling="common",
        gate={"near_m": gate_mm[0] / 1e3, "far_m": gate_mm[1] / 1e3} if gate_mm else None,
        channels=open_channels(channels) if channels else None,
    )
    save_capture(output, cleaned)
    left = np.mean(np.abs(cleaned.data) ** 2) / np.mean(np.abs(recorded.data) ** 2)
    print(f"{output}: {10 * np.log10(left):+.1f} dB of power is left")


if __name__ == "__main__":
    run(main)
