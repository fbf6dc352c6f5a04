"""Subtract the background of a capture and gate it in range: a script to run, copy and edit.

    python calibration/scripts/background.py hand.h5 --empty empty.h5 -o clean.h5
    python calibration/scripts/background.py hand.h5 --near-mm 250 --far-mm 400 -o clean.h5

`clradar clean` does the same with more options; docs/background.md explains them.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from calibration import range_gate, subtract_background
from calibration.scripts.scripting import Force, refuse_existing, run
from measurement_io import open_capture, save_capture

# "none" subtracts as recorded; "common" and "channel" scale the empty capture first.
SCALING = "common"


def main(
    capture: Annotated[Path, typer.Argument(help="With the object.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Cleaned capture, .h5.")],
    empty: Annotated[Path | None, typer.Option(help="Capture without the object.")] = None,
    near_mm: Annotated[float | None, typer.Option(help="Start of the range window.")] = None,
    far_mm: Annotated[float | None, typer.Option(help="End of the range window.")] = None,
    force: Force = False,
) -> None:
    """Subtract the background, then gate in range; at least one of the two."""
    if (near_mm is None) != (far_mm is None) or (empty is None and near_mm is None):
        raise typer.BadParameter("expected --empty, or --near-mm and --far-mm, or all three")
    refuse_existing(output, force=force)
    recorded = cleaned = open_capture(capture)
    if empty is not None:
        cleaned = subtract_background(cleaned, open_capture(empty), scaling=SCALING)
    if near_mm is not None and far_mm is not None:
        cleaned = range_gate(cleaned, near_m=near_mm / 1e3, far_m=far_mm / 1e3)
    save_capture(output, cleaned, force=force)
    left = np.mean(np.abs(cleaned.data) ** 2) / np.mean(np.abs(recorded.data) ** 2)
    print(f"{output}: {10 * np.log10(left):+.1f} dB of power is left")


if __name__ == "__main__":
    run(main)
