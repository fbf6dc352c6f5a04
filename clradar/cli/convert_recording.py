"""``clradar convert --to maroon``: captures, or a whole recording, to a MAROON folder."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.convert_frames import check_apart, open_source
from clradar.cli.images import recording_files
from clradar.cli.options import wrong_usage
from clradar.cli.output import print_line, progress_bar
from clradar.cli.provenance import provenance
from clradar.errors import ModelError, OutputError

if TYPE_CHECKING:
    from clradar import Capture
    from measurement_io import Recording

Antennas = tuple["Path | None", "Path | None"]


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to be written.

    Attributes
    ----------
    output : Path
        The `<object>/<distance>` folder.
    frame : int or None
        Which frame of a recording.
    variant : str or None
        Which variant of a recording, or what single captures are written as.
    timestamps_us : sequence of int or None
        One for each frame.
    antennas : pair of Path or None
        Files of the Rx and of the Tx antennas.
    force : bool
        Replace what is there.
    """

    output: Path
    frame: int | None
    variant: str | None
    timestamps_us: Sequence[int] | None
    antennas: Antennas
    force: bool


def write_recording(sources: Sequence[Path], wanted: Wanted) -> None:
    """Write `output/radar_<low>_<high>_<points>` and what belongs beside it.

    Parameters
    ----------
    sources : sequence of Path
        One folder with a recording; or captures and frames, one for each frame to write.
    wanted : Wanted
    """
    _check_new(wanted.output, force=wanted.force)
    folders = [path for path in sources if path.is_dir()]
    if folders and len(sources) > 1:
        raise wrong_usage("SOURCE", "expected one folder, or several captures; got both")
    if folders:
        radar, text = _of_folder(folders[0], wanted)
    else:
        if wanted.frame is not None:
            raise wrong_usage("--frame", "chooses a frame of a folder, which SOURCE is not")
        radar, text = _of_files(sources, wanted)
    print_line(f"{radar}: {text}")


def _check_new(output: Path, *, force: bool) -> None:
    """Raise before anything is read if the folder is there and may not be written into."""
    try:
        if output.is_dir() and any(output.iterdir()) and not force:
            raise OutputError(f"{output}: exists already; --force replaces the recording in it")
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{output}: cannot be written: {error}") from error


def _of_folder(source: Path, wanted: Wanted) -> tuple[Path, str]:
    from measurement_io import save_recording
    from measurement_io.maroon.folders import ranges

    output, frame, variant = wanted.output, wanted.frame, wanted.variant
    recording = open_source(source, variant, wanted.antennas)
    if output.resolve() == recording.path.resolve().parent:
        raise OutputError(f"{output}: holds the recording that is read; choose another folder")
    check_apart(output, recording.path)
    filtered = None
    if variant is None and len(recording.variants) > 1:
        filtered = recording.with_variant("emptyfiltered")
        recording = recording.with_variant("raw")
        orphans = set(filtered.frame_numbers) - set(recording.frame_numbers)
        if frame is None and orphans:
            raise ModelError(
                f"{source}: expected a raw frame for every emptyfiltered one, got none for "
                f"{ranges(orphans)}; choose with --variant"
            )
    if frame is not None:
        recording = _one_frame(recording, frame)
        if filtered is not None:
            there = frame in filtered.frame_numbers
            filtered = _one_frame(filtered, frame) if there else None
    options = {"source": str(source), "frame": frame, "variant": variant, "to": "maroon"}
    views = [view for view in (recording, filtered) if view is not None]
    total = sum(len(view) for view in views)
    with progress_bar("converting") as progress:
        count = _Counter(progress, total)
        described = [_Described(source, view, options, wanted.antennas) for view in views]
        radar = save_recording(
            output,
            described[0],
            variant=recording.variant,
            emptyfiltered=described[1] if filtered is not None else None,
            timestamps_us=wanted.timestamps_us,
            copy_from=recording.path,
            progress=count,
            force=wanted.force,
        )
    return radar, ", ".join(f"{len(view)} {view.variant}" for view in views) + " frames"


def _one_frame(recording: Recording, frame: int) -> Recording:
    from measurement_io.failures import fail
    from measurement_io.maroon.folders import ranges

    numbers = recording.frame_numbers
    if frame not in numbers:
        fail(recording.path, f"frame {frame} ({recording.variant})", ranges(numbers))
    at = numbers.index(frame)
    return recording[at : at + 1]


def _of_files(sources: Sequence[Path], wanted: Wanted) -> tuple[Path, str]:
    from measurement_io import save_recording
    from measurement_io.maroon.folders import frame_file

    output = wanted.output
    for path in sources:
        if frame_file(path).folder is not None:
            read = path.absolute().parent.parent
            if output.resolve() == read.resolve().parent:
                raise OutputError(f"{output}: holds a frame that is read; choose another folder")
            check_apart(output, read)
    captures = _Files(sources, wanted.variant, wanted.antennas)
    with progress_bar("converting") as progress:
        try:
            radar = save_recording(
                output,
                captures,
                variant=captures.variant,
                timestamps_us=wanted.timestamps_us,
                progress=_Counter(progress, len(captures)),
                force=wanted.force,
            )
        except ModelError as error:
            raise ModelError(f"{captures.latest}: {error}") from error
    return radar, f"{len(captures)} {captures.variant} frame{'s' if len(captures) > 1 else ''}"


class _Counter:
    """Passes the frames written so far, of all variants, on to a progress bar."""

    def __init__(self, progress: Any, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self, done: int, total: int) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)


class _Described:
    """The frames of a recording, each with the record of how it came to be."""

    def __init__(
        self, source: Path, recording: Recording, options: dict[str, Any], antennas: Antennas
    ) -> None:
        self._source, self._recording, self._options = source, recording, options
        self._antennas = [path for path in antennas if path is not None]

    def __len__(self) -> int:
        return len(self._recording)

    def __iter__(self) -> Iterator[Capture]:
        for capture in self._recording:
            inputs = [*recording_files(self._source, capture.meta), *self._antennas]
            yield described(capture, self._options, inputs)


class _Files:
    """Captures and frames in files of their own, opened one after the other."""

    def __init__(self, paths: Sequence[Path], variant: str | None, antennas: Antennas) -> None:
        self._paths = paths
        self._antennas = antennas
        self._given = variant
        self.latest = paths[0]
        self.variant = variant or self._variant_of(self._open(paths[0]))

    def __len__(self) -> int:
        return len(self._paths)

    def __iter__(self) -> Iterator[Capture]:
        options = {"variant": self._given, "to": "maroon"}
        antennas = [path for path in self._antennas if path is not None]
        for path in self._paths:
            self.latest = path
            capture = self._open(path)
            if self._given is None and self._variant_of(capture) != self.variant:
                raise ModelError(
                    f"expected a frame of the variant of the first, {self.variant}, got "
                    f"{self._variant_of(capture)}; --variant says what to write them all as"
                )
            yield described(capture, options | {"source": str(path)}, [path, *antennas])

    def _open(self, path: Path) -> Capture:
        from measurement_io import open_capture
        from measurement_io.opening import kind_of

        if kind_of(path) != "frame":
            return open_capture(path)
        rx_file, tx_file = self._antennas
        return open_capture(path, rx_file=rx_file, tx_file=tx_file)

    @staticmethod
    def _variant_of(capture: Capture) -> str:
        from measurement_io.maroon.folders import VARIANTS

        found = capture.meta.get("variant")
        return found if found in VARIANTS else "raw"


def described(capture: Capture, options: Mapping[str, Any], inputs: Sequence[Path]) -> Capture:
    """Return a capture whose record, a JSON text, the file form can carry.

    A frame carries numbers and strings alone, so all of `meta` goes into one string: what the
    capture came with, and how it was converted.
    """
    record = {**capture.meta, **provenance("convert", options, inputs)}
    return replace(capture, meta={**capture.meta, "provenance": json.dumps(record)})
