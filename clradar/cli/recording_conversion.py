"""Whole recordings: every frame to a native capture, or captures to a MAROON folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.options.groups import wrong_usage
from clradar.cli.options.measured import AntennaOptions, recording_files
from clradar.cli.outputs import (
    check_folder,
    check_outputs,
    check_place_of_folder,
    made_folder,
    provenance,
    save,
)
from clradar.errors import MeasurementError, ModelError, OutputError

if TYPE_CHECKING:
    from measurement_io import Recording


def write_captures(
    source: Path, output: Path, variant: str | None, antennas: AntennaOptions, *, force: bool
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time."""
    check_place_of_folder(output)
    recording = open_source(source, variant, antennas)
    check_apart(output, recording.path)
    variants = recording.variants if variant is None else (variant,)
    views = [recording.with_variant(name) for name in variants]
    frames = [
        (view, i, output / _file_name(number, view.variant))
        for view in views
        for i, number in enumerate(view.frame_numbers)
    ]
    if output.is_dir():
        inputs = [source, *antennas.files]
        check_outputs([path for _, _, path in frames], force=force, inputs=inputs)
    with made_folder(output):
        written = _write_each(frames, source, antennas, force=force)
        if len(written) < len(frames):
            raise MeasurementError(f"{source}: {len(written)} of {len(frames)} frames converted")
    print_line(f"{output}: {_counts(views)} frames, {written[0]} to {written[-1]}")


def _write_each(
    frames: Sequence[tuple[Recording, int, Path]],
    source: Path,
    antennas: AntennaOptions,
    *,
    force: bool,
) -> list[str]:
    """Write each frame that can be read; return the names of their files."""
    written: list[str] = []
    with progress_bar("converting") as progress:
        for tried, (view, i, path) in enumerate(frames, start=1):
            try:
                capture = view[i]
            except MeasurementError as error:
                print_warning(error)
                continue
            frame = capture.meta["frame"]
            options = {"source": str(source), "frame": frame, "variant": view.variant}
            inputs = [*recording_files(source, capture.meta), *antennas.files]
            save(path, capture, provenance("convert", options, inputs), force=force)
            written.append(path.name)
            del capture  # before the next one is read
            if progress is not None:
                progress(tried, len(frames))
    return written


def _file_name(number: int, variant: str) -> str:
    return f"{number:06d}.h5" if variant == "raw" else f"{number:06d}_{variant}.h5"


def _counts(views: Sequence[Recording | _Frames]) -> str:
    return ", ".join(f"{len(view)} {view.variant}" for view in views)


def open_source(source: Path, variant: str | None, antennas: AntennaOptions) -> Recording:
    """A recording in this variant or, for None, in raw if there are such frames."""
    from measurement_io import open_recording
    from measurement_io.maroon.folders import find_radar_folder, frames

    if variant is None and source.is_dir():
        there = frames(find_radar_folder(source))
        variant = next((name for name, found in there.items() if found), None)
    return open_recording(source, variant=variant or "raw", **antennas.chosen)


def check_apart(output: Path, radar: Path) -> None:
    """Raise unless a folder that is written is apart from the radar folder that is read."""
    place, read = output.resolve(), radar.resolve()
    if read in (place, *place.parents):
        raise OutputError(f"{output}: lies in the recording that is read; choose another folder")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOutput:
    """The recording to write."""

    output: Path
    frame: int | None = None
    variant: str | None = None
    timestamps_us: Sequence[int] | None = None
    antennas: AntennaOptions
    force: bool = False

    def write(self, sources: Sequence[Path]) -> None:
        """Write `output/radar_<low>_<high>_<points>` and the files beside it.

        `sources` is one folder, with a recording or with nothing but captures (.h5); or captures
        and frames, one for each frame to write.
        """
        from measurement_io.maroon.folders import BESIDE

        check_folder(self.output, force=self.force)
        replaced = [*BESIDE, *(path.name for path in self.output.glob("radar_*"))]
        check_place_of_folder(self.output, replaced, [*sources, *self.antennas.files])
        folders = [path for path in sources if path.is_dir()]
        if folders and len(sources) > 1:
            raise wrong_usage("SOURCE", "expected one folder, or several captures; got both")
        captures = _captures_in(folders[0]) if folders else sources
        if folders and not captures:
            self._write_folder(folders[0])
            return
        if self.frame is not None:
            raise wrong_usage("--frame", "chooses a frame of a folder, which SOURCE is not")
        self._write_files(captures)

    def _write_folder(self, source: Path) -> None:
        from measurement_io.maroon.folders import ranges

        recording = open_source(source, self.variant, self.antennas)
        self._check_apart(recording.path)
        views = [recording]
        if self.variant is None and len(recording.variants) > 1:
            views = [recording.with_variant(name) for name in ("raw", "emptyfiltered")]
            orphans = set(views[1].frame_numbers) - set(views[0].frame_numbers)
            if self.frame is None and orphans:
                raise ModelError(
                    f"{source}: expected a raw frame for every emptyfiltered one, got none for "
                    f"{ranges(orphans)}; choose with --variant"
                )
        if self.frame is not None:
            beside = [view for view in views[1:] if self.frame in view.frame_numbers]
            views = [_one_frame(view, self.frame) for view in (views[0], *beside)]
        options = {"frame": self.frame, "variant": self.variant, "to": "maroon"}
        self._save(
            [
                _Frames(
                    view.variant,
                    [(source, partial(_whole_or_not, view, i)) for i in range(len(view))],
                    options,
                    self.antennas.files,
                )
                for view in views
            ],
            copy_from=recording.path,
        )

    def _write_files(self, sources: Sequence[Path]) -> None:
        from measurement_io.maroon.folders import VARIANTS, frame_file

        for path in sources:
            if frame_file(path).folder is not None:
                self._check_apart(path.absolute().parent.parent)
        variants = [_variant_of(path) if self.variant is None else self.variant for path in sources]
        options = {"variant": self.variant, "to": "maroon"}
        views = []
        for name in VARIANTS:
            paths = [p for p, variant in zip(sources, variants, strict=True) if variant == name]
            opened = [(path, partial(_open_file, path, self.antennas)) for path in paths]
            if paths:
                views.append(_Frames(name, opened, options, self.antennas.files))
        try:
            self._save(views)
        except ModelError as error:
            tried = [view.latest for view in views if view.latest is not None]
            raise ModelError(f"{(tried or sources)[-1]}: {error}") from error

    def _check_apart(self, radar: Path) -> None:
        if self.output.resolve() == radar.resolve().parent:
            raise OutputError(f"{self.output}: holds the source recording; choose another folder")
        check_apart(self.output, radar)

    def _save(self, views: Sequence[_Frames], copy_from: Path | None = None) -> None:
        from measurement_io import save_recording

        total, done = sum(map(len, views)), count(1)
        with progress_bar("converting") as progress:

            def show(_: int, __: int) -> None:
                if progress is not None:
                    progress(next(done), total)

            radar = save_recording(
                self.output,
                views[0],
                variant=views[0].variant,
                emptyfiltered=views[1] if len(views) > 1 else None,
                timestamps_us=self.timestamps_us,
                copy_from=copy_from,
                progress=show,
                force=self.force,
            )
        single = copy_from is None and total == 1
        print_line(f"{radar}: {_counts(views)} frame{'' if single else 's'}")


def _captures_in(folder: Path) -> list[Path]:
    """The files of a folder with nothing but .h5 files, by name; none of any other."""
    from measurement_io.maroon.folders import entries

    there = entries(folder)
    return there if all(path.suffix == ".h5" and path.is_file() for path in there) else []


def _one_frame(recording: Recording, frame: int) -> Recording:
    from clradar.files.failures import fail
    from measurement_io.maroon.folders import ranges

    numbers = recording.frame_numbers
    if frame not in numbers:
        fail(recording.path, f"frame {frame} ({recording.variant})", ranges(numbers))
    at = numbers.index(frame)
    return recording[at : at + 1]


def _whole_or_not(recording: Recording, index: int) -> cl.Capture:
    try:
        return recording[index]
    except MeasurementError as error:
        raise MeasurementError(
            f"{error}; a recording is written whole or not at all, --all-frames converts the "
            "frames that can be read"
        ) from error


def _open_file(path: Path, antennas: AntennaOptions) -> cl.Capture:
    from measurement_io import open_capture
    from measurement_io.opening import kind_of

    return open_capture(path, **(antennas.chosen if kind_of(path) == "frame" else {}))


def _variant_of(path: Path) -> str:
    """The variant in the name of a frame, or in the record of a capture; else raw."""
    from measurement_io.maroon.folders import VARIANTS, frame_file
    from measurement_io.native.records import read_header
    from measurement_io.opening import kind_of

    kind = kind_of(path)
    if kind == "frame":
        return frame_file(path).variant
    found = read_header(path).meta.get("variant") if kind == "native" else None
    return found if found in VARIANTS else "raw"


@dataclass(slots=True)
class _Frames:
    """Captures of one variant, each opened when it is written, with its provenance."""

    variant: str
    sources: Sequence[tuple[Path, Callable[[], cl.Capture]]]
    options: Mapping[str, Any]
    antenna_files: Sequence[Path]
    latest: Path | None = field(default=None, init=False)

    def __len__(self) -> int:
        return len(self.sources)

    def __iter__(self) -> Iterator[cl.Capture]:
        for path, opened in self.sources:
            self.latest = path
            capture = opened()
            inputs = [*recording_files(path, capture.meta), *self.antenna_files]
            options = {"source": str(path), **self.options}
            yield described(capture, provenance("convert", options, inputs))


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
