"""``clradar convert --to maroon``: captures, or a whole recording, to a MAROON folder."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.convert_frames import check_apart, open_source
from clradar.cli.images import recording_files
from clradar.cli.options import wrong_usage
from clradar.cli.output import print_line, progress_bar
from clradar.cli.provenance import provenance
from clradar.errors import MeasurementError, ModelError, OutputError

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
        One folder, with a recording or with nothing but captures (.h5); or captures and frames,
        one for each frame to write.
    wanted : Wanted
    """
    _check_new(wanted.output, force=wanted.force)
    folders = [path for path in sources if path.is_dir()]
    if folders and len(sources) > 1:
        raise wrong_usage("SOURCE", "expected one folder, or several captures; got both")
    captures = _captures_in(folders[0]) if folders else sources
    if folders and not captures:
        radar, text = _of_folder(folders[0], wanted)
    else:
        if wanted.frame is not None:
            raise wrong_usage("--frame", "chooses a frame of a folder, which SOURCE is not")
        radar, text = _of_files(captures, wanted)
    print_line(f"{radar}: {text}")


def _captures_in(folder: Path) -> list[Path]:
    """Return the files of a folder with nothing but .h5 files, by name; none of any other."""
    from measurement_io.maroon.folders import entries

    there = entries(folder)
    return there if all(path.suffix == ".h5" and path.is_file() for path in there) else []


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
    from clradar.files.failures import fail
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
    first, filtered = _by_variant(sources, wanted)
    views = [view for view in (first, filtered) if view is not None]
    with progress_bar("converting") as progress:
        try:
            radar = save_recording(
                output,
                first,
                variant=first.variant,
                emptyfiltered=filtered,
                timestamps_us=wanted.timestamps_us,
                progress=_Counter(progress, len(sources)),
                force=wanted.force,
            )
        except ModelError as error:
            tried = [view.latest for view in views if view.latest is not None]
            raise ModelError(f"{(tried or sources)[-1]}: {error}") from error
    frames = "frame" if len(sources) == 1 else "frames"
    return radar, ", ".join(f"{len(view)} {view.variant}" for view in views) + f" {frames}"


def _by_variant(sources: Sequence[Path], wanted: Wanted) -> tuple[_Files, _Files | None]:
    """Return the files of the variant to write, and the emptyfiltered ones that go beside them."""
    from measurement_io.maroon.folders import VARIANTS

    if wanted.variant is not None:
        return _Files(sources, wanted.variant, wanted), None
    paths: dict[str, list[Path]] = {variant: [] for variant in VARIANTS}
    for path in sources:
        paths[_variant_of(path)].append(path)
    first, *others = (_Files(files, name, wanted) for name, files in paths.items() if files)
    return first, others[0] if others else None


def _variant_of(path: Path) -> str:
    """Return which variant a frame is by its name, or a capture by what it came with; else raw."""
    from measurement_io.maroon.folders import VARIANTS, frame_file
    from measurement_io.native.captures_volumes import read_header
    from measurement_io.opening import kind_of

    kind = kind_of(path)
    if kind == "frame":
        return frame_file(path).variant
    found = read_header(path).meta.get("variant") if kind == "native" else None
    return found if found in VARIANTS else "raw"


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
        frames = iter(self._recording)
        for _ in range(len(self._recording)):
            try:
                capture = next(frames)
            except MeasurementError as error:
                raise MeasurementError(
                    f"{error}; a recording is written whole or not at all, --all-frames converts "
                    "the frames that can be read"
                ) from error
            inputs = [*recording_files(self._source, capture.meta), *self._antennas]
            yield described(capture, self._options, inputs)


class _Files:
    """Captures and frames of one variant in files of their own, opened one after the other."""

    def __init__(self, paths: Sequence[Path], variant: str, wanted: Wanted) -> None:
        self._paths = paths
        self._wanted = wanted
        self.variant = variant
        self.latest: Path | None = None

    def __len__(self) -> int:
        return len(self._paths)

    def __iter__(self) -> Iterator[Capture]:
        options = {"variant": self._wanted.variant, "to": "maroon"}
        antennas = [path for path in self._wanted.antennas if path is not None]
        for path in self._paths:
            self.latest = path
            capture = self._open(path)
            yield described(capture, options | {"source": str(path)}, [path, *antennas])

    def _open(self, path: Path) -> Capture:
        from measurement_io import open_capture
        from measurement_io.opening import kind_of

        if kind_of(path) != "frame":
            return open_capture(path)
        rx_file, tx_file = self._wanted.antennas
        return open_capture(path, rx_file=rx_file, tx_file=tx_file)


def described(capture: Capture, options: Mapping[str, Any], inputs: Sequence[Path]) -> Capture:
    """Return a capture whose record, a JSON text, the file form can carry.

    A frame carries numbers and strings alone, so all of `meta` goes into one string: what the
    capture came with, and how it was converted.
    """
    record = {**capture.meta, **provenance("convert", options, inputs)}
    with suppress(KeyError, TypeError, ValueError):
        # An earlier conversion's is text; as text in text its escapes would double every time.
        record["provenance"] = json.loads(record["provenance"])
    return replace(capture, meta={**capture.meta, "provenance": json.dumps(record)})
