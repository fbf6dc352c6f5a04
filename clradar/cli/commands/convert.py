"""``clradar convert``: native captures from any recording, and recordings from captures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

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
from clradar.cli.options.measured import AntennaOptions, FrameOptions, recording_files
from clradar.cli.outputs import check_outputs, provenance, save


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """Formats of input and output."""

    to: Literal["native", "maroon"] = option(
        "native", "One capture file, or a recording as a MAROON folder."
    )
    all_frames: bool = option(False, "Every frame of a recording to a capture of its own.")
    timestamp_us: list[int] | None = option(
        None,
        "With --to maroon: time stamp of a frame, microseconds; once for each frame. "
        "[default: those of the sources, else 0]",
        metavar="US",
    )
    layout: Path | None = option(
        None,
        "Which key and which axis of another program's file is what (docs/layouts.md). "
        "`clradar inspect` prints a template.",
        metavar="LAB.toml",
    )

    def check(self, frames: FrameOptions, sources: list[Path]) -> None:
        """Raise unless the options go together."""
        to_maroon = self.to == "maroon"
        if self.layout is not None and (self.all_frames or to_maroon):
            raise wrong_usage("--layout", "goes with one capture to a native file only")
        if self.all_frames and (to_maroon or frames.frame is not None):
            raise wrong_usage("--all-frames", "goes with neither --to maroon nor --frame")
        if not self.all_frames and not to_maroon and self.timestamp_us:
            raise wrong_usage("--timestamp-us", "goes with --to maroon only")
        if not to_maroon and len(sources) > 1:
            option = "--all-frames" if self.all_frames else "--to native"
            raise wrong_usage("SOURCE", f"expected one with {option}, got {len(sources)}")


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
    from clradar.cli.recording_conversion import RecordingOutput, write_captures

    formats.check(frames, sources)
    variant = frames.chosen["variant"]
    if formats.all_frames:
        write_captures(sources[0], output, variant, antennas, force=force)
    elif formats.to == "maroon":
        RecordingOutput(
            output=output, frame=frames.frame, variant=variant, antennas=antennas, force=force,
            timestamps_us=formats.timestamp_us,
        ).write(sources)  # fmt: skip
    else:
        convert_one(sources[0], output, frames, antennas, formats.layout, force=force)


def convert_one(
    source: Path,
    output: Path,
    frames: FrameOptions,
    antennas: AntennaOptions,
    layout: Path | None,
    *,
    force: bool,
) -> None:
    """Write one capture or frame as a native file."""
    from measurement_io import open_capture

    layouts = [] if layout is None else [layout]
    check_outputs([output], force=force, inputs=[source, *antennas.files, *layouts])
    capture = open_capture(source, layout=layout, **frames.chosen, **antennas.chosen)
    options = recorded(frames, source=source, layout=layout)
    inputs = [*recording_files(source, capture.meta), *antennas.files]
    if layout is not None:
        inputs += [layout, *antenna_files_of(capture.meta)]
        check_outputs([output], force=force, inputs=inputs)  # they are known only now
    save(output, capture, provenance("convert", options, inputs), force=force)
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    print_line(f"{output}: {shape} (tx, rx, frequency), {low:g} to {high:g} GHz")


def antenna_files_of(meta: Mapping[str, Any]) -> list[Path]:
    """The antenna files that the layout of a capture names."""
    sides = (meta["layout"][name] for name in ("tx", "rx"))
    return [Path(side["file"]) for side in sides if "file" in side]
