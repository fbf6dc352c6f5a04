"""``clradar convert``: native captures from any recording, and a recording from captures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from clradar.cli.console import print_line
from clradar.cli.options.common import FORCE
from clradar.cli.options.groups import (
    REQUIRED,
    argument,
    option,
    output_option,
    recorded,
    wrong_usage,
)
from clradar.cli.options.measured import FrameOptions, recording_files
from clradar.cli.outputs import check_outputs, provenance, save
from clradar.cli.recording_conversion import AntennaOptions, write_captures, write_recording


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """Formats of input and output."""

    to: Literal["native", "maroon"] = option(
        "One capture file, or a recording as a MAROON folder.", "native"
    )
    all_frames: bool = option(
        "Every frame of a recording to a capture of its own.", False, without="--to --frame"
    )
    layout: Path | None = option(
        "Which key and axis of another program's file is what (docs/layouts.md); `clradar inspect` "
        "prints a template.",
        metavar="LAB.toml",
        without="--to --all-frames",
    )


def command(
    *,
    sources: list[Path] = argument(
        "Recorded .npy frame, radar folder, or the folder that holds one; with --layout another "
        "program's .h5, .mat, .npz or .npy; with --to maroon one or several captures.",
        REQUIRED,
        metavar="SOURCE",
    ),
    output: Path = output_option("Capture to write (HDF5); else the folder to make.", REQUIRED),
    formats: FormatOptions,
    frames: FrameOptions,
    antennas: AntennaOptions,
    force: bool = FORCE,
) -> None:
    """The content of a SOURCE decides its kind, not its name. The data stays as recorded, bit by
    bit. A recording that is written (--to maroon) has one frame for each capture.
    """
    from measurement_io import open_capture

    if formats.to == "maroon":
        if frames != FrameOptions():
            raise wrong_usage("--frame, --variant", "expected without --to maroon")
        write_recording(sources, output, antennas, force=force)
        return
    if len(sources) > 1:
        raise wrong_usage("SOURCE", f"expected one, got {len(sources)}")
    source, layout = sources[0], formats.layout
    if formats.all_frames:
        write_captures(source, output, frames.variant, antennas, force=force)
        return
    layouts = [] if layout is None else [layout]
    check_outputs([output], force=force, inputs=[source, *antennas.files, *layouts])
    capture = open_capture(source, layout=layout, **recorded(frames), **antennas.chosen)
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
