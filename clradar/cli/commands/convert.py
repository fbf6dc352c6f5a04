"""``clradar convert``: native captures from any recording, and a recording from captures."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from clradar.cli import conversions, options as opt
from clradar.cli.outputs import check_outputs, write


def command(
    *,
    sources: list[Path] = opt.argument(
        "Recorded .npy frame, radar folder, or the folder that holds one; with --layout another "
        "program's .h5, .mat, .npz or .npy; with --to maroon one or several captures.",
    ),
    output: Path = opt.output_option(
        "Capture to write (HDF5); else the folder to make.", folder=True
    ),
    to: Literal["native", "maroon"] = opt.option(
        "One capture file, or a recording as a MAROON folder.", "native"
    ),
    all_frames: bool = opt.option(
        "Every frame of a recording to a capture of its own.", False, without="--to --frame"
    ),
    layout: Path | None = opt.option(
        "Which key and axis of another program's file is what (docs/layouts.md); `clradar inspect` "
        "prints a template.",
        metavar="LAB.toml",
        without="--to --all-frames",
    ),
    frames: opt.FrameOptions,
    antennas: opt.AntennaOptions,
) -> None:
    """The content of a SOURCE decides its kind, not its name. The data stays as recorded, bit by
    bit.
    """
    from measurement_io import open_capture

    if to == "maroon":
        if frames != opt.FrameOptions():
            raise opt.wrong_usage("--frame, --variant", "expected without --to maroon")
        conversions.write_recording(sources, output, antennas)
        return
    source, *others = sources
    if others:
        raise opt.wrong_usage("SOURCE", f"expected one, got {len(sources)}")
    if all_frames:
        conversions.write_captures(source, output, frames.variant, antennas)
        return
    check_outputs([output])
    how = {**opt.arguments_of(frames), **opt.arguments_of(antennas)}
    capture = opt.noted(source, open_capture(source, layout=layout, **how))
    if layout is not None:
        sides = (capture.meta["layout"][name] for name in ("tx", "rx"))
        opt.call.inputs["--layout"] += [Path(side["file"]) for side in sides if "file" in side]
        check_outputs([output])  # they are known only now
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    write(output, capture, f"{shape} (tx, rx, frequency), {low:g} to {high:g} GHz")
