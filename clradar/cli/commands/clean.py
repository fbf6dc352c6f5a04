"""``clradar clean``: average, subtract the empty room, gate in range, correct the channels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.outputs import write
from clradar.files.failures import fail


def command(
    *,
    capture: Path = opt.CAPTURE,
    output: Path = opt.output_option("Capture to write (HDF5)."),
    cleaning: opt.CleaningOptions,
    average: bool = opt.option(
        "Take the coherent mean of all frames of each radar folder.", False, without="--frame"
    ),
    align_phase: bool = opt.option(
        "First rotate frames to a common phase.", False, needs="--average"
    ),
    frames: opt.FrameOptions,
) -> None:
    """In this order: average the frames, subtract EMPTY, gate, correct. --frame and --variant are
    those of CAPTURE; of an EMPTY folder the first frame is taken, as recorded, or the mean of all.
    Half path lengths are (|p - tx| + |p - rx|) / 2: at least a point's z. Pairs with a dead or
    noisy channel are set to zero. Every frame of a recording: `clradar process`.
    """
    room = cleaning.empty
    if not (room or cleaning.gate_mm or cleaning.channels or average):
        expected = "--empty, --gate-mm, --channels or --average: nothing to do"
        raise opt.wrong_usage("--empty", f"expected {expected}")
    if average and not any(path.is_dir() for path in (capture, room) if path is not None):
        raise opt.wrong_usage("--average", "expected a radar folder among CAPTURE and EMPTY")
    loaded, averaged = read(capture, frames, average, align_phase)
    empty, steps = None, [averaged] if averaged else []
    if room is not None:
        empty, averaged = read(room, opt.FrameOptions(), average, align_phase)
        steps.append(f"minus {room} (scaling {cleaning.scaling}{averaged and ', ' + averaged})")
    done = cleaning.cleaned(loaded, empty)
    write(output, done, "; ".join([*steps, *cleaning.steps(done.meta)]))
    powers = [float(np.mean(np.abs(one.data) ** 2, dtype=np.float64)) for one in (loaded, done)]
    change = f"{10 * math.log10(powers[1] / powers[0]):+.1f} dB" if min(powers) > 0 else "zero"
    print_line(f"{output}: power against {capture}: {change}")


def read(
    path: Path, frames: opt.FrameOptions, average: bool, align_phase: bool
) -> tuple[cl.Capture, str]:
    """One frame or the mean of all, and of how many it is the mean."""
    from calibration import average_frames
    from measurement_io import open_recording

    if not (average and path.is_dir()):
        return opt.open_frame(path, frames), ""
    variant = frames.variant or "raw"
    recording = open_recording(path, variant=variant)
    if not len(recording):
        fail(path, f"frames of variant {variant}", "none")
    with progress_bar("averaging") as progress:

        def captures() -> Iterator[cl.Capture]:
            for number, capture in enumerate(recording, start=1):
                yield opt.noted(path, capture)
                if progress is not None:
                    progress(number, len(recording))

        found = average_frames(captures(), align_phase=align_phase)
    expected, count = found.meta.get("number_of_measurements"), len(recording)
    if isinstance(expected, int) and expected != count:
        print_warning(f"{path}: {count} of {expected} frames are there; averaged those")
    return found, f"mean of {counted(found.meta['average']['frames'], 'frame')}"
