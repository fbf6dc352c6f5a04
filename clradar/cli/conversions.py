"""Recordings that are written as captures, and captures as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.inputs import ReadOnAccess
from clradar.cli.outputs import (
    check_folder,
    check_outputs,
    described,
    provenance,
    save,
)
from clradar.errors import MeasurementError, ModelError
from clradar.files.failures import fail
from clradar.jobs.lock import made_folder


def write_captures(
    source: Path, output: Path, variant: str | None, antennas: opt.AntennaOptions
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time."""
    from measurement_io import open_recording
    from measurement_io.maroon.folders import find_radar_folder, frames

    check_folder(output, resumed=True)
    there = frames(find_radar_folder(source)) if source.is_dir() else {}
    first = variant or next((name for name, found in there.items() if found), "raw")
    recording = open_recording(source, variant=first, **opt.arguments_of(antennas))
    variants = recording.variants if variant is None else (variant,)
    views = {name: recording.with_variant(name) for name in variants}
    files = {
        output / f"{n:06d}{'' if name == 'raw' else f'_{name}'}.h5": partial(view.__getitem__, i)
        for name, view in views.items()
        for i, n in enumerate(view.frame_numbers)
    }
    beside, written = opt.paths_in(opt.arguments_of(antennas)), list[str]()
    if output.is_dir():
        check_outputs(files)
    with made_folder(output), progress_bar("converting") as progress:
        for done, (path, opened) in enumerate(files.items(), start=1):
            try:
                capture = opened()
            except MeasurementError as error:
                print_warning(error)
                continue
            own = {key: capture.meta[key] for key in ("frame", "variant")}
            inputs = [*(opt.frame_files(capture) if source.is_dir() else [source]), *beside]
            save(path, capture, provenance(inputs, **own), force=opt.call.force)
            written.append(path.name)
            del capture  # before the next one is read
            if progress is not None:
                progress(done, len(files))
        if len(written) < len(files):
            raise MeasurementError(f"{source}: {len(written)} of {len(files)} frames converted")
    counts = ", ".join(counted(len(view), f"{name} frame") for name, view in views.items())
    print_line(f"{output}: {counts}, {written[0]} to {written[-1]}")


def write_recording(sources: Sequence[Path], output: Path, antennas: opt.AntennaOptions) -> None:
    """Write `output/radar_<low>_<high>_<points>` with a frame for each capture."""
    from measurement_io import open_capture, save_recording
    from measurement_io.maroon.folders import BESIDE
    from measurement_io.opening import kind_of

    for path in sources:
        if path.is_dir():
            fail(path, "a capture, with --to maroon", "a folder")
    check_folder(output)
    check_folder(output, [*BESIDE, *(path.name for path in output.glob("radar_*"))], resumed=True)
    beside, opened = opt.paths_in(opt.arguments_of(antennas)), list[Path]()

    def read(path: Path) -> cl.Capture:
        opened.append(path)
        own = antennas if kind_of(path) == "frame" else opt.AntennaOptions()
        return described(open_capture(path, **opt.arguments_of(own)), provenance([path, *beside]))

    captures = ReadOnAccess(sources, read)
    with progress_bar("converting") as progress:
        try:
            radar = save_recording(output, captures, force=opt.call.force, progress=progress)
        except ModelError as error:
            raise ModelError(f"{opened[-1]}: {error}") from error
    print_line(f"{radar}: {counted(len(sources), 'frame')}")
