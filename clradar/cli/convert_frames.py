"""``clradar convert --all-frames``: every frame of a recording to a native capture of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clradar.cli.images import recording_files
from clradar.cli.output import check_outputs, print_line, print_warning, progress_bar
from clradar.cli.simulate import save_with_provenance
from clradar.errors import MeasurementError, OutputError

if TYPE_CHECKING:
    from measurement_io import Recording


def write_captures(
    source: Path,
    output: Path,
    variant: str | None,
    antennas: tuple[Path | None, Path | None],
    *,
    force: bool,
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time.

    Parameters
    ----------
    source : Path
        A radar folder, or the folder that holds one.
    output : Path
        Folder; made, with those above it, where missing. Every file in it is whole or not there.
    variant : {"raw", "emptyfiltered"} or None
        None stands for all that there are.
    antennas : pair of Path or None
        Files of the Rx and of the Tx antennas.
    force : bool
        Replace files that are there.

    Raises
    ------
    MeasurementError
        Some frames cannot be read. Each has been named in a warning, and the others are written.
    """
    recording = open_source(source, variant, antennas)
    variants = recording.variants if variant is None else (variant,)
    check_apart(output, recording.path)
    others = [path for path in antennas if path is not None]
    views = [recording.with_variant(name) for name in variants]
    names = [[_file_name(n, view.variant) for n in view.frame_numbers] for view in views]
    make_folder(output)
    every = [output / name for of_view in names for name in of_view]
    check_outputs(every, force=force, inputs=[source, *others])
    tried = 0
    written: list[str] = []
    with progress_bar("converting") as progress:
        for view, of_view in zip(views, names, strict=True):
            frames = iter(view)
            for name in of_view:
                tried += 1
                try:
                    capture = next(frames)
                except MeasurementError as error:
                    print_warning(error)
                    continue
                options = {"source": str(source), "frame": capture.meta["frame"]}
                options["variant"] = view.variant
                inputs = [*recording_files(source, capture.meta), *others]
                save_with_provenance(
                    output / name, capture, "convert", options, inputs, force=force
                )
                written.append(name)
                del capture  # before the next one is read
                if progress is not None:
                    progress(tried, len(every))
    if len(written) < len(every):
        raise MeasurementError(f"{source}: {len(written)} of {len(every)} frames converted")
    counts = ", ".join(f"{len(view)} {view.variant}" for view in views)
    print_line(f"{output}: {counts} frames, {written[0]} to {written[-1]}")


def open_source(
    source: Path, variant: str | None, antennas: tuple[Path | None, Path | None]
) -> Recording:
    """Return a recording in this variant or, for None, in raw if there are such frames."""
    from measurement_io import open_recording
    from measurement_io.maroon.folders import find_radar_folder, frames

    if variant is None and source.is_dir():
        there = frames(find_radar_folder(source))
        variant = next((name for name, found in there.items() if found), None)
    rx_file, tx_file = antennas
    return open_recording(source, variant=variant or "raw", rx_file=rx_file, tx_file=tx_file)


def check_apart(output: Path, radar: Path) -> None:
    """Raise unless a folder that is written is apart from the radar folder that is read."""
    place, read = output.resolve(), radar.resolve()
    if read in (place, *place.parents):
        raise OutputError(f"{output}: lies in the recording that is read; choose another folder")


def make_folder(path: Path) -> None:
    """Make a folder, with those above it, where missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be made: {error}") from error


def _file_name(number: int, variant: str) -> str:
    return f"{number:06d}.h5" if variant == "raw" else f"{number:06d}_{variant}.h5"
