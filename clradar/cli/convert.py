"""``clradar convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from clradar.cli.images import recording_files
from clradar.cli.layout import LayoutOption, layout_files, skeleton_if_needed
from clradar.cli.options import ForceOption, FrameOption, VariantOption
from clradar.cli.output import check_outputs, print_line
from clradar.cli.simulate import save_with_provenance


def command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="Recorded .npy frame, radar folder, the folder that holds one, a capture, or, "
            "with --layout, another program's .h5, .mat, .npz or .npy.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture to write (HDF5).")],
    frame: FrameOption = None,
    variant: VariantOption = None,
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
    """What SOURCE is, its content decides, not its name. The data stays as recorded, bit by bit."""
    from measurement_io import open_capture

    antennas = [path for path in (rx_file, tx_file) if path is not None]
    check_outputs([output], force=force, inputs=[p for p in (source, *antennas, layout) if p])
    with skeleton_if_needed():
        capture = open_capture(
            source,
            frame=frame,
            variant=None if variant is None else variant.value,
            rx_file=rx_file,
            tx_file=tx_file,
            layout=layout,
        )
    options = {
        "source": str(source),
        "frame": frame,
        "variant": None if variant is None else variant.value,
        "layout": None if layout is None else str(layout),
    }
    inputs = [*recording_files(source, capture.meta), *antennas]
    inputs += layout_files(layout, capture.meta)
    save_with_provenance(output, capture, "convert", options, inputs, force=force)
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    print_line(f"{output}: {shape} (tx, rx, frequency), {low:g} to {high:g} GHz")
