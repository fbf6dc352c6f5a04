"""Subtract the background of a capture and gate it in range: a script to run, copy and edit.

    python calibration/scripts/background.py hand.h5 --empty empty.h5 -o clean.h5
    python calibration/scripts/background.py hand.h5 --near-mm 250 --far-mm 400 -o clean.h5

`clradar clean` does the same with more options; docs/background.md explains them.
"""

from pathlib import Path

import numpy as np
import typer

from calibration import clean
from calibration.scripts.scripting import Output, Recorded, run
from measurement_io import open_capture, save_capture


def main(
    capture: Recorded,
    output: Output,
    empty: Path | None = None,
    near_mm: float | None = None,
    far_mm: float | None = None,
) -> None:
    """Subtract EMPTY, recorded without the object, and keep the ranges from NEAR to FAR."""
    if (near_mm is None) != (far_mm is None) or (empty is None and near_mm is None):
        raise typer.BadParameter("expected --empty, or --near-mm and --far-mm, or all three")
    gate = None
    if near_mm is not None and far_mm is not None:
        gate = {"near_m": near_mm / 1e3, "far_m": far_mm / 1e3}
    recorded = open_capture(capture)
    # "none" subtracts as recorded; "common" and "channel" scale the empty capture first.
    room = None if empty is None else open_capture(empty)
    cleaned = clean(recorded, empty=room, scaling="common", gate=gate)
    save_capture(output, cleaned)
    left = np.mean(np.abs(cleaned.data) ** 2) / np.mean(np.abs(recorded.data) ** 2)
    print(f"{output}: {10 * np.log10(left):+.1f} dB of power is left")


if __name__ == "__main__":
    run(main)
