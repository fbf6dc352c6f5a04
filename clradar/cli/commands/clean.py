"""``clradar clean``: average, subtract the empty room, gate in range, correct the channels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from clradar.cli.console import print_line
from clradar.cli.inputs import AverageOptions
from clradar.cli.options.common import CAPTURE, FORCE
from clradar.cli.options.groups import REQUIRED, output_option, wrong_usage
from clradar.cli.options.measured import CleaningOptions, FrameOptions
from clradar.cli.outputs import check_outputs, provenance, save


def command(
    *,
    capture: Path = CAPTURE,
    output: Path = output_option("Capture to write (HDF5).", REQUIRED),
    cleaning: CleaningOptions,
    mean: AverageOptions,
    frames: FrameOptions,
    force: bool = FORCE,
) -> None:
    """In this order: average the frames, subtract EMPTY, gate, correct. At least one has to be
    requested. `clradar process` does the same to every frame of a recording.

    --frame and --variant are those of CAPTURE. Of an EMPTY folder the first frame is taken, as
    recorded, or the mean of all. Half path lengths are (|p - tx| + |p - rx|) / 2: at least a
    point's z, and at most its distance from the farthest antenna. Pairs with a dead or noisy
    channel are set to zero. Another array or other frequencies are refused.
    """
    window, room = cleaning.gate, cleaning.empty
    if not (room or window or cleaning.channels or mean.average):
        expected = "--empty, --gate-mm, --channels or --average: nothing to do"
        raise wrong_usage("--empty", f"expected {expected}")
    sources = [path for path in (capture, room) if path is not None]
    more = [] if cleaning.channels is None else [cleaning.channels]
    mean.check(sources, "CAPTURE and EMPTY")
    check_outputs([output], force=force, inputs=[*sources, *more])
    loaded, inputs, averaged = mean.read(capture, frames)
    empty, of_empty = None, ""
    if room is not None:
        empty, files, of_empty = mean.read(room, FrameOptions())
        inputs = [*inputs, *files]
    done = cleaning.cleaned(loaded, empty)
    origin = provenance("clean", [*inputs, *more], cleaning, mean, frames, capture=capture)
    save(output, done, origin, force=force)
    steps = [averaged] if averaged else []
    if room is not None:
        steps.append(f"minus {room} (scaling {cleaning.scaling}{', ' * bool(of_empty)}{of_empty})")
    if window is not None:
        record = done.meta["range_gate"]
        steps.append(
            f"gated to {1e3 * record['near_m']:g} to {1e3 * record['far_m']:g} mm (inside "
            f"{record['passband_db']:+.1f} dB at worst, rejects {record['rejection_db']:.0f} dB or "
            f"more beyond {1e3 * record['edge_m']:.0f} mm from it)"
        )
    if cleaning.channels is not None:
        record = done.meta["channels"]
        steps.append(
            f"{100 * record['live_share']:.1f} % of the pairs left, without "
            f"{len(record['masked_tx'])} Tx and {len(record['masked_rx'])} Rx"
        )
    print_line(f"{output}: {'; '.join(steps)}")
    powers = [float(np.mean(np.abs(one.data) ** 2, dtype=np.float64)) for one in (loaded, done)]
    change = f"{10 * math.log10(powers[1] / powers[0]):+.1f} dB" if min(powers) > 0 else "zero"
    print_line(f"{output}: power against {capture}: {change}")
