"""Whole recordings: every frame to a native capture, or captures to a MAROON folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.console import print_line, print_warning, progress_bar
from clradar.cli.options.groups import wrong_usage
from clradar.cli.options.measured import AntennaOptions, FrameOptions, recording_files
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

if TYPE_CHECKING:
    from measurement_io import Recording

Source = tuple[Path, Callable[[], cl.Capture]]
"""Where a capture comes from, which is opened when it is written."""


def write_captures(
    source: Path, output: Path, variant: str | None, antennas: AntennaOptions, *, force: bool
) -> None:
    """Write `output/000000.h5`, `000000_emptyfiltered.h5` ..., one frame in memory at a time."""
    check_place_of_folder(output)
    recording = _open(source, variant, antennas)
    _check_apart(output, recording.path)
    variants = recording.variants if variant is None else (variant,)
    views = {name: recording.with_variant(name) for name in variants}
    frames = {
        output / f"{number:06d}{'' if name == 'raw' else f'_{name}'}.h5": partial(
            view.__getitem__, i
        )
        for name, view in views.items()
        for i, number in enumerate(view.frame_numbers)
    }
    if output.is_dir():
        check_outputs(frames, force=force, inputs=[source, *antennas.files])
    written: list[str] = []
    with made_folder(output), progress_bar("converting") as progress:
        for tried, (path, opened) in enumerate(frames.items(), start=1):
            try:
                capture = opened()
            except MeasurementError as error:
                print_warning(error)
                continue
            options = {key: capture.meta[key] for key in ("frame", "variant")}
            inputs = [*recording_files(source, capture.meta), *antennas.files]
            origin = provenance("convert", inputs, source=source, **options)
            save(path, capture, origin, force=force)
            written.append(path.name)
            del capture  # before the next one is read
            if progress is not None:
                progress(tried, len(frames))
        if len(written) < len(frames):
            raise MeasurementError(f"{source}: {len(written)} of {len(frames)} frames converted")
    print_line(f"{output}: {_counts(views)} frames, {written[0]} to {written[-1]}")


def write_recording(
    sources: Sequence[Path],
    output: Path,
    frames: FrameOptions,
    antennas: AntennaOptions,
    timestamps_us: Sequence[int] | None,
    *,
    force: bool,
) -> None:
    """Write `output/radar_<low>_<high>_<points>` and the files beside it.

    `sources` is one folder, with a recording or with nothing but captures (.h5); or captures
    and frames, one for each frame to write.
    """
    from measurement_io import save_recording
    from measurement_io.maroon.folders import BESIDE, entries

    check_folder(output, force=force)
    replaced = [*BESIDE, *(path.name for path in output.glob("radar_*"))]
    check_place_of_folder(output, replaced, [*sources, *antennas.files])
    folders = [path for path in sources if path.is_dir()]
    if folders and len(sources) > 1:
        raise wrong_usage("SOURCE", "expected one folder, or several captures; got both")
    there = entries(folders[0]) if folders else list(sources)
    copied = None
    if folders and not (there and all(path.suffix == ".h5" and path.is_file() for path in there)):
        views, copied = _frames_of(folders[0], frames, antennas)
        places = [copied]
    elif frames.frame is not None:
        raise wrong_usage("--frame", "chooses a frame of a folder, which SOURCE is not")
    else:
        views, places = _captures(there, frames.variant, antennas)
    for place in places:
        if output.resolve() == place.resolve().parent:
            raise OutputError(f"{output}: holds the source recording; choose another folder")
        _check_apart(output, place)
    latest: list[Path] = []
    total, done = sum(map(len, views.values())), count(1)

    def described_captures(some: Sequence[Source]) -> Iterator[cl.Capture]:
        for path, opened in some:
            latest.append(path)
            capture = opened()
            inputs = [*recording_files(path, capture.meta), *antennas.files]
            options = {"source": str(path), "variant": frames.variant, "frame": frames.frame}
            yield described(capture, provenance("convert", inputs, to="maroon", **options))

    (variant, first), *others = views.items()
    with progress_bar("converting") as progress:
        try:
            radar = save_recording(
                output, _Sized(first, described_captures), variant=variant,
                emptyfiltered=_Sized(others[0][1], described_captures) if others else None,
                timestamps_us=timestamps_us, copy_from=copied, force=force,
                progress=lambda *_: progress(next(done), total) if progress else None,
            )  # fmt: skip
        except ModelError as error:
            if copied is not None:
                raise
            raise ModelError(f"{(latest or sources)[-1]}: {error}") from error
    single = copied is None and total == 1
    print_line(f"{radar}: {_counts(views)} frame{'' if single else 's'}")


class _Sized:
    """Captures that are opened one by one, and how many there are."""

    def __init__(
        self, some: Sequence[Source], opened: Callable[[Sequence[Source]], Iterator[cl.Capture]]
    ) -> None:
        self._some, self._opened = some, opened

    def __len__(self) -> int:
        return len(self._some)

    def __iter__(self) -> Iterator[cl.Capture]:
        return self._opened(self._some)


def _frames_of(
    source: Path, frames: FrameOptions, antennas: AntennaOptions
) -> tuple[dict[str, list[Source]], Path]:
    """The frames of a recording by variant, and its radar folder."""
    from measurement_io.maroon.folders import ranges

    recording = _open(source, frames.variant, antennas)
    views = {recording.variant: recording}
    if frames.variant is None and len(recording.variants) > 1:
        views = {name: recording.with_variant(name) for name in ("raw", "emptyfiltered")}
        orphans = set(views["emptyfiltered"].frame_numbers) - set(views["raw"].frame_numbers)
        if frames.frame is None and orphans:
            raise ModelError(
                f"{source}: expected a raw frame for every emptyfiltered one, got none for "
                f"{ranges(orphans)}; choose with --variant"
            )

    def opened(view: Recording, index: int) -> cl.Capture:
        try:
            return view[index]
        except MeasurementError as error:
            raise MeasurementError(
                f"{error}; a recording is written whole or not at all, --all-frames converts the "
                "frames that can be read"
            ) from error

    found: dict[str, list[Source]] = {}
    for name, view in views.items():
        numbers = view.frame_numbers
        chosen = [i for i, number in enumerate(numbers) if frames.frame in (None, number)]
        if not chosen and not found:
            fail(view.path, f"frame {frames.frame} ({name})", ranges(numbers))
        if chosen:
            found[name] = [(source, partial(opened, view, i)) for i in chosen]
    return found, recording.path


def _captures(
    sources: Sequence[Path], variant: str | None, antennas: AntennaOptions
) -> tuple[dict[str, list[Source]], list[Path]]:
    """Captures and frames by the variant in their names or records, and folders they lie in."""
    from measurement_io import open_capture
    from measurement_io.maroon.folders import VARIANTS, frame_file
    from measurement_io.native.records import read_header
    from measurement_io.opening import kind_of

    found: dict[str, list[Source]] = {name: [] for name in VARIANTS}
    places = [path.absolute().parent.parent for path in sources if frame_file(path).folder]
    for path in sources:
        kind = kind_of(path)
        own = frame_file(path).variant if kind == "frame" else None
        if kind == "native":
            own = read_header(path).meta.get("variant")
        name = variant or (own if own in VARIANTS else "raw")
        more = antennas.chosen if kind == "frame" else {}
        found[name].append((path, partial(open_capture, path, **more)))
    return {name: some for name, some in found.items() if some}, places


def _open(source: Path, variant: str | None, antennas: AntennaOptions) -> Recording:
    """A recording in this variant or, for None, in raw if there are such frames."""
    from measurement_io import open_recording
    from measurement_io.maroon.folders import find_radar_folder, frames

    if variant is None and source.is_dir():
        there = frames(find_radar_folder(source))
        variant = next((name for name, found in there.items() if found), None)
    return open_recording(source, variant=variant or "raw", **antennas.chosen)


def _check_apart(output: Path, radar: Path) -> None:
    """Raise unless a folder that is written is apart from the radar folder that is read."""
    place, read = output.resolve(), radar.resolve()
    if read in (place, *place.parents):
        raise OutputError(f"{output}: lies in the recording that is read; choose another folder")


def _counts(views: Mapping[str, Sequence[Any]]) -> str:
    return ", ".join(f"{len(view)} {name}" for name, view in views.items())


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
