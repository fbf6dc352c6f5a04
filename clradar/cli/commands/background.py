"""``clradar background``: subtract the empty room, average frames, gate in range."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clradar.cli.console import print_line
from clradar.cli.options.average import AverageOptions
from clradar.cli.options.clutter import EmptyOptions, GateOptions
from clradar.cli.options.common import CaptureArgument, CaptureOutput, ForceOption
from clradar.cli.options.groups import recorded
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_outputs, save
from clradar.cli.provenance import provenance

if TYPE_CHECKING:
    from clradar import Capture


def command(
    capture: CaptureArgument,
    output: CaptureOutput,
    background: EmptyOptions,
    gate: GateOptions,
    mean: AverageOptions,
    frames: FrameOptions,
    force: ForceOption = False,
) -> None:
    """In this order: average the frames, subtract EMPTY, gate. At least one has to be requested.

    --frame and --variant are those of CAPTURE. Of an EMPTY folder the first frame is taken, as
    recorded, or the mean of all. Half path lengths are (|p - tx| + |p - rx|) / 2: at least a
    point's z, and at most its distance from the farthest antenna.
    """
    from calibration import range_gate, subtract_background

    window, empty = gate.settings(), background.empty
    sources = [path for path in (capture, empty) if path is not None]
    if empty is None and window is None and not mean.average:
        raise wrong_usage("--empty", "expected --empty, --gate-mm or --average: nothing to do")
    mean.check(frames, sources, "CAPTURE and EMPTY")
    check_outputs([output], force=force, inputs=sources)
    done, inputs, words = mean.read(capture, frames)
    steps = [words] if words else []
    before = rms_amplitude(done)
    if empty is not None:
        without, files, words = mean.read(empty, FrameOptions())
        inputs = [*inputs, *files]
        scaling = background.scaling
        done = subtract_background(done, without, scaling=scaling)
        steps.append(f"minus {empty} (scaling {scaling}{', ' if words else ''}{words})")
    if window is not None:
        done = range_gate(done, **window)
        steps.append(gate_text(done.meta["range_gate"]))
    options = recorded(background, gate, mean, frames, capture=capture)
    save(output, done, provenance("background", options, inputs), force=force)
    print_line(f"{output}: {'; '.join(steps)}")
    after = rms_amplitude(done)
    change = f"{20 * math.log10(after / before):+.1f} dB" if before > 0 and after > 0 else "zero"
    print_line(f"{output}: power against {capture}: {change}")


def gate_text(record: dict[str, float]) -> str:
    """A range gate in words."""
    return (
        f"gated to {1e3 * record['near_m']:g} to {1e3 * record['far_m']:g} mm (inside "
        f"{record['passband_db']:+.1f} dB at worst, rejects {record['rejection_db']:.0f} dB or "
        f"more beyond {1e3 * record['edge_m']:.0f} mm from it)"
    )


def rms_amplitude(capture: Capture) -> float:
    """The RMS amplitude of a capture's samples."""
    return float(np.sqrt(np.mean(np.abs(capture.data) ** 2, dtype=np.float64)))
