"""``clradar convert``: native captures from any recording, and recordings from captures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from clradar.cli.console import print_line
from clradar.cli.options.common import FORCE
from clradar.cli.options.groups import REQUIRED, argument, option, output_option, wrong_usage
from clradar.cli.options.measured import AntennaOptions, FrameOptions, recording_files
from clradar.cli.outputs import check_outputs, provenance, save
from clradar.cli.recording_conversion import write_captures, write_recording


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """Formats of input and output."""

    to: Literal["native", "maroon"] = option(
        "native", "One capture file, or a recording as a MAROON folder."
    )
    all_frames: bool = option(
        False, "Every frame of a recording to a capture of its own.", without="--to --frame"
    )
    timestamp_us: list[int] | None = option(
        None,
        "Time stamp of a frame, microseconds; once for each frame. "
        "[default: those of the sources, else 0]",
        metavar="US",
        needs="--to",
    )
    layout: Path | None = option(
        None,
        "Which key and which axis of another program's file is what (docs/layouts.md). "
        "`clradar inspect` prints a template.",
        metavar="LAB.toml",
        without="--to --all-frames",
    )


def command(
    *,
    sources: list[Path] = argument(
        REQUIRED,
        "Recorded .npy frame, radar folder, the folder that holds one, or a capture; with "
        "--layout another program's .h5, .mat, .npz or .npy; several frames or captures with "
        "--to maroon.",
        metavar="SOURCE",
    ),
    output: Path = output_option(REQUIRED, "Capture to write (HDF5); else the folder to make."),
    formats: FormatOptions,
    frames: FrameOptions,
    antennas: AntennaOptions,
    force: bool = FORCE,
) -> None:
    """The content of a SOURCE decides its kind, not its name. The data stays as recorded, bit by
    bit.

    A recording that is written (--to maroon) holds all frames of a recording, with its products,
    meshes and transforms, or one frame for each capture that is named.
    """
    from measurement_io import open_capture

    if formats.to == "maroon":
        stamps_us = formats.timestamp_us
        write_recording(sources, output, frames, antennas, stamps_us, force=force)
        return
    if len(sources) > 1:
        name = "--all-frames" if formats.all_frames else "--to native"
        raise wrong_usage("SOURCE", f"expected one with {name}, got {len(sources)}")
    source, layout = sources[0], formats.layout
    if formats.all_frames:
        write_captures(source, output, frames.variant, antennas, force=force)
        return
    layouts = [] if layout is None else [layout]
    check_outputs([output], force=force, inputs=[source, *antennas.files, *layouts])
    capture = open_capture(source, layout=layout, **frames.chosen, **antennas.chosen)
    inputs = [*recording_files(source, capture.meta), *antennas.files, *layouts]
    if layout is not None:
        sides = (capture.meta["layout"][name] for name in ("tx", "rx"))
        inputs += [Path(side["file"]) for side in sides if "file" in side]
        check_outputs([output], force=force, inputs=inputs)  # they are known only now
    origin = provenance("convert", inputs, frames, source=source, layout=layout)
    save(output, capture, origin, force=force)
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    print_line(f"{output}: {shape} (tx, rx, frequency), {low:g} to {high:g} GHz")
