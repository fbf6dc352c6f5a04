"""``clradar clean``: average, subtract the empty room, gate in range, correct the channels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.outputs import provenance, save
from clradar.files.failures import fail


@dataclass(frozen=True, kw_only=True)
class AverageOptions:
    """The mean over the frames of recordings."""

    average: bool = opt.option(
        "Take the coherent mean of all frames of each radar folder.", False, without="--frame"
    )
    align_phase: bool = opt.option(
        "First rotate frames to a common phase.", False, needs="--average"
    )


def command(
    *,
    capture: Path = opt.CAPTURE,
    output: Path = opt.output_option("Capture to write (HDF5).", opt.REQUIRED),
    cleaning: opt.CleaningOptions,
    mean: AverageOptions,
    frames: opt.FrameOptions,
    force: bool = opt.FORCE,
) -> None:
    """In this order: average the frames, subtract EMPTY, gate, correct. At least one has to be
    requested. `clradar process` does the same to every frame of a recording.

    --frame and --variant are those of CAPTURE. Of an EMPTY folder the first frame is taken, as
    recorded, or the mean of all. Half path lengths are (|p - tx| + |p - rx|) / 2: at least a
    point's z, and at most its distance from the farthest antenna. Pairs with a dead or noisy
    channel are set to zero. Another array or other frequencies are refused.
    """
    room = cleaning.empty
    if not (room or cleaning.gate_mm or cleaning.channels or mean.average):
        expected = "--empty, --gate-mm, --channels or --average: nothing to do"
        raise opt.wrong_usage("--empty", f"expected {expected}")
    if mean.average and not any(path.is_dir() for path in (capture, room) if path is not None):
        raise opt.wrong_usage("--average", "expected a radar folder among CAPTURE and EMPTY")
    loaded, inputs, averaged = read(capture, frames, mean)
    empty, steps = None, [averaged] if averaged else []
    if room is not None:
        empty, files, averaged = read(room, opt.FrameOptions(), mean)
        inputs = [*inputs, *files]
        steps.append(f"minus {room} (scaling {cleaning.scaling}{averaged and ', ' + averaged})")
    inputs += [] if cleaning.channels is None else [cleaning.channels]
    done = cleaning.cleaned(loaded, empty)
    save(output, done, provenance(inputs), force=force)
    print_line(f"{output}: {'; '.join([*steps, *steps_of(cleaning, done.meta)])}")
    powers = [float(np.mean(np.abs(one.data) ** 2, dtype=np.float64)) for one in (loaded, done)]
    change = f"{10 * math.log10(powers[1] / powers[0]):+.1f} dB" if min(powers) > 0 else "zero"
    print_line(f"{output}: power against {capture}: {change}")


def read(
    path: Path, frames: opt.FrameOptions, mean: AverageOptions
) -> tuple[cl.Capture, list[Path], str]:
    """One frame or the mean of all, the files it comes from, and of how many it is the mean."""
    from calibration import average_frames
    from measurement_io import open_recording

    if not (mean.average and path.is_dir()):
        return *opt.open_frame(path, frames), ""
    variant = frames.variant or "raw"
    recording, files = open_recording(path, variant=variant), list[Path]()
    if not len(recording):
        fail(path, f"frames of variant {variant}", "none")
    with progress_bar("averaging") as progress:

        def captures() -> Iterator[cl.Capture]:
            for capture in recording:
                files.extend(opt.recording_files(path, capture.meta))
                yield capture
                if progress is not None:
                    progress(len(files), len(recording))

        found = average_frames(captures(), align_phase=mean.align_phase)
    expected, count = found.meta.get("number_of_measurements"), len(files)
    if isinstance(expected, int) and expected != count:
        print_warning(f"{path}: {count} of {expected} frames are there; averaged those")
    return found, files, f"mean of {counted(found.meta['average']['frames'], 'frame')}"


def steps_of(cleaning: opt.CleaningOptions, meta: Any) -> list[str]:
    """What was done to a capture beside the empty room, as its `meta` has it."""
    steps = []
    if cleaning.gate_mm is not None:
        gate = meta["range_gate"]
        steps.append(
            f"gated to {1e3 * gate['near_m']:g} to {1e3 * gate['far_m']:g} mm (inside "
            f"{gate['passband_db']:+.1f} dB at worst, rejects {gate['rejection_db']:.0f} dB or "
            f"more beyond {1e3 * gate['edge_m']:.0f} mm from it)"
        )
    if cleaning.channels is not None:
        channels = meta["channels"]
        steps.append(
            f"{100 * channels['live_share']:.1f} % of the pairs left, without "
            f"{len(channels['masked_tx'])} Tx and {len(channels['masked_rx'])} Rx"
        )
    return steps
