"""``clradar clean``: average, subtract the empty room, gate in range, correct the channels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from clradar.cli.console import print_line
from clradar.cli.inputs import AverageOptions
from clradar.cli.options.common import CAPTURE, FORCE
from clradar.cli.options.groups import REQUIRED, option, output_option, wrong_usage
from clradar.cli.options.measured import ChannelOptions, EmptyOptions, FrameOptions, GateOptions
from clradar.cli.outputs import check_outputs, provenance, save
from clradar.files.failures import fail


def command(
    *,
    capture: Path = CAPTURE,
    output: Path = output_option(REQUIRED, "Capture to write (HDF5)."),
    background: EmptyOptions,
    gate: GateOptions,
    known: ChannelOptions,
    gains: bool = option(
        False,
        "Instead of --channels: divide by the gains that the array of the capture has (gain_db, "
        "phase_deg).",
        without="--channels",
    ),
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
    from calibration import clean

    window = gate.settings()
    sources = [path for path in (capture, background.empty) if path is not None]
    if not (background.empty or window or known.channels or mean.average or gains):
        raise wrong_usage(
            "--empty",
            "expected --empty, --gate-mm, --channels, --gains or --average: nothing to do",
        )
    mean.check(sources, "CAPTURE and EMPTY")
    check_outputs([output], force=force, inputs=[*sources, *known.files])
    channels = known.read()
    loaded, inputs, averaged = mean.read(capture, frames)
    if gains and not loaded.array.has_gains:
        fail(capture, "an array with gains (docs/arrays.md)", "antennas that all have gain 1")
    empty, of_empty = None, ""
    if background.empty is not None:
        empty, files, of_empty = mean.read(background.empty, FrameOptions())
        inputs = [*inputs, *files]
    done = clean(
        loaded, empty=empty, scaling=background.scaling, gate=window, channels=channels,
        mask=known.mask,
    )  # fmt: skip
    done = done.without_gains() if gains else done
    origin = provenance(
        "clean", [*inputs, *known.files], background, gate, known, mean, frames,
        capture=capture, gains=gains,
    )  # fmt: skip
    save(output, done, origin, force=force)
    steps = [averaged] if averaged else []
    if empty is not None:
        words = f"scaling {background.scaling}{', ' if of_empty else ''}{of_empty}"
        steps.append(f"minus {background.empty} ({words})")
    if window is not None:
        record = done.meta["range_gate"]
        steps.append(
            f"gated to {1e3 * record['near_m']:g} to {1e3 * record['far_m']:g} mm (inside "
            f"{record['passband_db']:+.1f} dB at worst, rejects {record['rejection_db']:.0f} dB or "
            f"more beyond {1e3 * record['edge_m']:.0f} mm from it)"
        )
    if channels is not None:
        record = done.meta["channels"]
        steps.append(
            f"{100 * record['live_share']:.1f} % of the pairs left, without "
            f"{len(record['masked_tx'])} Tx and {len(record['masked_rx'])} Rx"
        )
    if gains:
        sides = [side.gain for side in loaded.array.sides if side.gain is not None]
        gains_db = 20 * np.log10(np.abs(np.concatenate(sides)))
        steps.append(f"without gains of {gains_db.min():.1f} to {gains_db.max():.1f} dB")
    print_line(f"{output}: {'; '.join(steps)}")
    powers = [float(np.mean(np.abs(one.data) ** 2, dtype=np.float64)) for one in (loaded, done)]
    change = f"{10 * math.log10(powers[1] / powers[0]):+.1f} dB" if min(powers) > 0 else "zero"
    print_line(f"{output}: power against {capture}: {change}")
