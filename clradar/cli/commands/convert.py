"""``clradar convert``: native captures from any recording, and a recording from captures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.outputs import (
    check_folder,
    check_outputs,
    check_place_of_folder,
    described,
    made_folder,
    provenance,
    save,
)
from clradar.errors import MeasurementError, ModelError, OutputError
from clradar.files.failures import fail


@dataclass(frozen=True, kw_only=True)
class AntennaOptions:
    """Files with the positions of antennas; as `measurement_io.open_recording` takes them."""

    rx_file: Path | None = opt.option("Positions of the Rx antennas of a recorded frame.")
    tx_file: Path | None = opt.option("Positions of the Tx antennas of a recorded frame.")


def command(
    *,
    sources: list[Path] = opt.argument(
        "Recorded .npy frame, radar folder, or the folder that holds one; with --layout another "
        "program's .h5, .mat, .npz or .npy; with --to maroon one or several captures.",
        opt.REQUIRED,
        metavar="SOURCE",
    ),
    output: Path = opt.output_option(
        "Capture to write (HDF5); else the folder to make.", opt.REQUIRED, folder=True
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
    antennas: AntennaOptions,
    force: bool = opt.FORCE,
) -> None:
    """The content of a SOURCE decides its kind, not its name. The data stays as recorded, bit by
    bit. A recording that is written (--to maroon) has one frame for each capture.
    """
    from measurement_io import open_capture

    if to == "maroon":
        if frames != opt.FrameOptions():
            raise opt.wrong_usage("--frame, --variant", "expected without --to maroon")
        write_recording(sources, output, antennas, force=force)
        return
    source, *others = sources
    if others:
        raise opt.wrong_usage("SOURCE", f"expected one, got {len(sources)}")
    if all_frames:
        write_captures(source, output, frames.variant, antennas, force=force)
        return
    beside = [*opt.files_of(antennas), *([] if layout is None else [layout])]
    check_outputs([output], force=force, inputs=[source, *beside])
    capture = open_capture(
        source, layout=layout, **opt.values_of(frames), **opt.values_of(antennas)
    )
    if layout is not None:
        sides = (capture.meta["layout"][name] for name in ("tx", "rx"))
        beside += [Path(side["file"]) for side in sides if "file" in side]
        check_outputs([output], force=force, inputs=beside)  # they are known only now
    origin = provenance([*opt.recording_files(source, capture.meta), *beside])
    save(output, capture, origin, force=force)
    low, high = capture.waveform.frequencies_hz[[0, -1]] / 1e9
    shape = " x ".join(str(n) for n in capture.data.shape)
    print_line(f"{output}: {shape} (tx, rx, frequency), {low:g} to {high:g} GHz")


def write_captures(
    source: Path, output: Path, variant: str | None, antennas: AntennaOptions, *, force: bool
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time."""
    from measurement_io import open_recording
    from measurement_io.maroon.folders import find_radar_folder, frames

    check_place_of_folder(output)
    there = frames(find_radar_folder(source)) if source.is_dir() else {}
    first = variant or next((name for name, found in there.items() if found), "raw")
    recording = open_recording(source, variant=first, **opt.values_of(antennas))
    place, radar = output.resolve(), recording.path.resolve()
    if radar in (place, *place.parents):
        raise OutputError(f"{output}: lies in the recording that is read; choose another folder")
    variants = recording.variants if variant is None else (variant,)
    views = {name: recording.with_variant(name) for name in variants}
    files = {
        output / f"{n:06d}{'' if name == 'raw' else f'_{name}'}.h5": partial(view.__getitem__, i)
        for name, view in views.items()
        for i, n in enumerate(view.frame_numbers)
    }
    beside, written = opt.files_of(antennas), list[str]()
    if output.is_dir():
        check_outputs(files, force=force, inputs=[source, *beside])
    with made_folder(output), progress_bar("converting") as progress:
        for done, (path, opened) in enumerate(files.items(), start=1):
            try:
                capture = opened()
            except MeasurementError as error:
                print_warning(error)
                continue
            own = {key: capture.meta[key] for key in ("frame", "variant")}
            inputs = [*opt.recording_files(source, capture.meta), *beside]
            save(path, capture, provenance(inputs, **own), force=force)
            written.append(path.name)
            del capture  # before the next one is read
            if progress is not None:
                progress(done, len(files))
        if len(written) < len(files):
            raise MeasurementError(f"{source}: {len(written)} of {len(files)} frames converted")
    counts = ", ".join(f"{len(view)} {name}" for name, view in views.items())
    print_line(f"{output}: {counts} frames, {written[0]} to {written[-1]}")


def write_recording(
    sources: Sequence[Path], output: Path, antennas: AntennaOptions, *, force: bool
) -> None:
    """Write `output/radar_<low>_<high>_<points>` with a frame for each capture."""
    from measurement_io import save_recording
    from measurement_io.maroon.folders import BESIDE

    for path in sources:
        if path.is_dir():
            fail(path, "a capture, with --to maroon", "a folder")
    check_folder(output, force=force)
    replaced = [*BESIDE, *(path.name for path in output.glob("radar_*"))]
    check_place_of_folder(output, replaced, [*sources, *opt.files_of(antennas)])
    captures = _Captures(sources, antennas)
    with progress_bar("converting") as progress:
        try:
            radar = save_recording(output, captures, force=force, progress=progress)
        except ModelError as error:
            raise ModelError(f"{captures.latest}: {error}") from error
    print_line(f"{radar}: {counted(len(sources), 'frame')}")


class _Captures:
    """Captures that are opened one by one."""

    def __init__(self, sources: Sequence[Path], antennas: AntennaOptions) -> None:
        self.sources, self.antennas, self.latest = sources, antennas, sources[0]

    def __len__(self) -> int:
        return len(self.sources)

    def __iter__(self) -> Iterator[cl.Capture]:
        from measurement_io import open_capture
        from measurement_io.opening import kind_of

        for path in self.sources:
            self.latest = path
            own = self.antennas if kind_of(path) == "frame" else AntennaOptions()
            capture = open_capture(path, **opt.values_of(own))
            yield described(capture, provenance([path, *opt.files_of(self.antennas)]))
