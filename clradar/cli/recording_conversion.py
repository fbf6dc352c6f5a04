"""Whole recordings: every frame to a native capture, or captures to a MAROON folder."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import clradar as cl
from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.options.groups import option
from clradar.cli.options.measured import recording_files
from clradar.cli.outputs import (
    check_folder,
    check_outputs,
    check_place_of_folder,
    made_folder,
    provenance,
    save,
)
from clradar.errors import MeasurementError, ModelError, OutputError
from clradar.files.failures import fail


@dataclass(frozen=True, kw_only=True)
class AntennaOptions:
    """Files with the positions of antennas."""

    rx_file: Path | None = option("Positions of the Rx antennas of a recorded frame.")
    tx_file: Path | None = option("Positions of the Tx antennas of a recorded frame.")

    @property
    def files(self) -> list[Path]:
        """The files that were given."""
        return [path for path in (self.rx_file, self.tx_file) if path is not None]

    @property
    def chosen(self) -> dict[str, Any]:
        """As `measurement_io.open_recording` takes them."""
        return {"rx_file": self.rx_file, "tx_file": self.tx_file}


def write_captures(
    source: Path, output: Path, variant: str | None, antennas: AntennaOptions, *, force: bool
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time."""
    from measurement_io import open_recording
    from measurement_io.maroon.folders import find_radar_folder, frames

    check_place_of_folder(output)
    there = frames(find_radar_folder(source)) if source.is_dir() else {}
    first = variant or next((name for name, found in there.items() if found), "raw")
    recording = open_recording(source, variant=first, **antennas.chosen)
    place, radar = output.resolve(), recording.path.resolve()
    if radar in (place, *place.parents):
        raise OutputError(f"{output}: lies in the recording that is read; choose another folder")
    variants = recording.variants if variant is None else (variant,)
    views = {name: recording.with_variant(name) for name in variants}
    files = {
        output / f"{number:06d}{'' if name == 'raw' else f'_{name}'}.h5": partial(
            view.__getitem__, i
        )
        for name, view in views.items()
        for i, number in enumerate(view.frame_numbers)
    }
    if output.is_dir():
        check_outputs(files, force=force, inputs=[source, *antennas.files])
    written: list[str] = []
    with made_folder(output), progress_bar("converting") as progress:
        for done, (path, opened) in enumerate(files.items(), start=1):
            try:
                capture = opened()
            except MeasurementError as error:
                print_warning(error)
                continue
            options = {key: capture.meta[key] for key in ("frame", "variant")}
            inputs = [*recording_files(source, capture.meta), *antennas.files]
            save(
                path, capture, provenance("convert", inputs, source=source, **options), force=force
            )
            written.append(path.name)
            del capture  # before the next one is read
            if progress is not None:
                progress(done, len(files))
        if len(written) < len(files):
            raise MeasurementError(f"{source}: {len(written)} of {len(files)} frames converted")
    counts = ", ".join(f"{len(view)} {name}" for name, view in views.items())
    print_line(f"{output}: {counts} frames, {written[0]} to {written[-1]}")


class _Captures(Sequence[cl.Capture]):
    """Captures that are opened one by one."""

    def __init__(self, sources: Sequence[Path], antennas: AntennaOptions) -> None:
        self.sources, self.antennas, self.latest = sources, antennas, sources[0]

    def __len__(self) -> int:
        return len(self.sources)

    def __getitem__(self, index: Any) -> Any:
        from measurement_io import open_capture
        from measurement_io.opening import kind_of

        self.latest = path = self.sources[index]
        more = self.antennas.chosen if kind_of(path) == "frame" else {}
        capture = open_capture(path, **more)
        inputs = [*recording_files(path, capture.meta), *self.antennas.files]
        return described(capture, provenance("convert", inputs, to="maroon", source=path))

    def __iter__(self) -> Iterator[cl.Capture]:
        return (self[i] for i in range(len(self)))


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
    check_place_of_folder(output, replaced, [*sources, *antennas.files])
    captures = _Captures(sources, antennas)
    with progress_bar("converting") as progress:
        try:
            radar = save_recording(output, captures, force=force, progress=progress)
        except ModelError as error:
            raise ModelError(f"{captures.latest}: {error}") from error
    print_line(f"{radar}: {counted(len(captures), 'frame')}")


def described(capture: cl.Capture, origin: Mapping[str, Any]) -> cl.Capture:
    """A capture whose provenance is a JSON text, which the file format can hold.

    A frame holds numbers and strings alone, so all of `meta` goes into one string: that of the
    capture, and `origin`, how it was converted or made.
    """
    record = {**capture.meta, **origin}
    with suppress(KeyError, TypeError, ValueError):
        # An earlier conversion's is text; as text in text its escapes would double every time.
        record["provenance"] = json.loads(record["provenance"])
    return replace(capture, meta={**capture.meta, "provenance": json.dumps(record)})
