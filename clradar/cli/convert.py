"""``clradar convert``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, Optional

import typer

from clradar.cli.images import recording_files
from clradar.cli.layout import LayoutOption, layout_files, skeleton_if_needed
from clradar.cli.options import ForceOption, FrameOption, VariantOption, wrong_usage
from clradar.cli.output import check_outputs, print_line
from clradar.cli.simulate import save_with_provenance


class Form(str, Enum):
    """What is written."""

    native = "native"
    maroon = "maroon"


def command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE",
            help="Recorded .npy frame, radar folder, the folder that holds one, or a capture; with "
            "--layout another program's .h5, .mat, .npz or .npy; several frames or captures with "
            "--to maroon.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Capture to write (HDF5); else the folder to make."),
    ],
    to: Annotated[
        Form, typer.Option("--to", help="One capture file, or a recording as a MAROON folder.")
    ] = Form.native,
    all_frames: Annotated[
        bool,
        typer.Option("--all-frames", help="Every frame of a recording to a capture of its own."),
    ] = False,
    frame: FrameOption = None,
    variant: VariantOption = None,
    timestamp_us: Annotated[
        Optional[list[int]],  # noqa: UP045
        typer.Option(
            "--timestamp-us",
            metavar="US",
            help="With --to maroon: time stamp of a frame, microseconds; once for each frame. "
            "[default: those of the sources, else 0]",
        ),
    ] = None,
    rx_file: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--rx-file", help="Positions of the Rx antennas of a recorded frame."),
    ] = None,
    tx_file: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--tx-file", help="Positions of the Tx antennas of a recorded frame."),
    ] = None,
    layout: LayoutOption = None,
    force: ForceOption = False,
) -> None:
    """What a SOURCE is, its content decides, not its name. The data stays as recorded, bit by bit.

    A recording that is written (--to maroon) holds all frames of a recording, with its products,
    meshes and transforms, or one frame for each capture that is named.
    """
    from clradar.cli import convert_frames, convert_recording

    antennas = (rx_file, tx_file)
    chosen = None if variant is None else variant.value
    if layout is not None and (all_frames or to is Form.maroon):
        raise wrong_usage("--layout", "goes with one capture to a native file only")
    if all_frames:
        if to is Form.maroon or frame is not None:
            raise wrong_usage("--all-frames", "goes with neither --to maroon nor --frame")
        check_one_source(sources, "--all-frames")
        convert_frames.write_captures(sources[0], output, chosen, antennas, force=force)
        return
    if to is Form.maroon:
        wanted = convert_recording.Wanted(output, frame, chosen, timestamp_us, antennas, force)
        convert_recording.write_recording(sources, wanted)
        return
    if timestamp_us:
        raise wrong_usage("--timestamp-us", "goes with --to maroon only")
    check_one_source(sources, "--to native")
    convert_one(sources[0], output, frame, chosen, antennas, layout, force=force)


def check_one_source(sources: list[Path], option: str) -> None:
    """Raise the error of wrong usage if several sources are named."""
    if len(sources) > 1:
        raise wrong_usage("SOURCE", f"expected one with {option}, got {len(sources)}")


def convert_one(
    source: Path,
    output: Path,
    frame: int | None,
    variant: str | None,
    antennas: tuple[Path | None, Path | None],
    layout: Path | None,
    *,
    force: bool,
) -> None:
    """Write one capture or frame as a native file."""
    from measurement_io import open_capture

    rx_file, tx_file = antennas
    others = [path for path in (*antennas, layout) if path is not None]
    check_outputs([output], force=force, inputs=[source, *others])
    with skeleton_if_needed():
        capture = open_capture(
            source, frame=frame, variant=variant, rx_file=rx_file, tx_file=tx_file, layout=layout
        )
    options = {
        "source": str(source),
        "frame": frame,
        "variant": variant,
        "layout": None if layout is None else str(layout),
    }
    inputs = [*recording_files(source, capture.meta), *(p for p in antennas if p is not None)]
    inputs += layout_files(layout, capture.meta)
    save_with_provenance(output, capture, "convert", options, inputs, force=force)
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    print_line(f"{output}: {shape} (tx, rx, frequency), {low:g} to {high:g} GHz")
