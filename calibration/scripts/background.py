"""Take the empty room and what lies outside of a range window out of a capture: a script to edit.

    python calibration/scripts/background.py hand.h5 --empty empty.h5 -o clean.h5
    python calibration/scripts/background.py hand.h5 --near-mm 250 --far-mm 400 -o clean.h5

`clradar background` does the same with more options; docs/background.md explains them.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from calibration import range_gate, subtract_background
from calibration.scripts.scripting import run
from clradar.files.atomic import refuse_existing
from measurement_io import open_capture, save_capture

# "none" subtracts as recorded; "common" and "channel" first scale the empty room to the capture.
SCALING = "common"


def main(
    capture: Annotated[Path, typer.Argument(help="With the object.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Cleaned capture, .h5.")],
    empty: Annotated[
        Path | None,
        typer.Option(help="Capture of the room without the object."),
    ] = None,
    near_mm: Annotated[
        float | None,
        typer.Option(help="Window of half path lengths: from here ..."),
    ] = None,
    far_mm: Annotated[
        float | None,
        typer.Option(help="... to here."),
    ] = None,
    force: Annotated[bool, typer.Option(help="Replace an existing file.")] = False,
) -> None:
    """Subtract the empty room, then gate in range; at least one of the two."""
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
