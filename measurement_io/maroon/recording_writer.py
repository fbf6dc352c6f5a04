"""Write a whole recording as an `<object>/<distance>` folder, frame by frame."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from pathlib import Path
from typing import Any

from clradar.errors import ModelError, OutputError
from clradar.files.atomic import move_folder, new_folder, swap_folder
from clradar.files.confined.process import Companion
from clradar.files.failures import clean, regular_file_size, shown
from clradar.files.json_file import read_json_object
from clradar.files.json_text import to_json
from clradar.model import Capture, VoxelGrid, Waveform, checks
from measurement_io.maroon.folders import (
    ALIGNMENT_FILE,
    CALIBRATION_FILE,
    FRAMES_FOLDER,
    MESH_FOLDER,
    METADATA_FILE,
    PRODUCTS,
    VARIANTS,
    entries,
    find_radar_folder,
    product_files,
    ranges,
)
from measurement_io.maroon.frame import read_frame_file
from measurement_io.maroon.writer import (
    check_target_folder,
    frame_name,
    grid_entry,
    radar_folder_name,
    time_stamp,
    write_antennas,
    write_calibration,
    write_frame_file,
)

SIDE_FILES = (METADATA_FILE, ALIGNMENT_FILE)
MAX_FRAMES = 1_000_000
"""A frame's number has six digits."""

_NAME = "save_recording"
Progress = Callable[[int, int], object]


def save_recording(
    path: str | os.PathLike[str],
    captures: Iterable[Capture],
    *,
    variant: str = "raw",
    emptyfiltered: Iterable[Capture] | None = None,
    timestamps_us: Sequence[Any] | None = None,
    metadata: Mapping[str, Any] | None = None,
    alignment: Mapping[str, Any] | None = None,
    meshes: Iterable[str | os.PathLike[str]] = (),
    grid: VoxelGrid | None = None,
    copy_from: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> Path:
    """Write captures as a recording, `path/radar_<low>_<high>_<points>` and the files beside it.

    One frame at a time is in memory. All of it is written under a hidden name beside `path` and
    renamed at the end, so that `path` never holds half a recording.

    Parameters
    ----------
    path : path-like
        The `<object>/<distance>` folder. The folders above it are made where missing.
    captures : iterable of Capture
        All of one array and waveform. Of antennas other than those of `clradar.arrays.qar50()`
        the radar folder gets an `antennas.toml`, which the readers take. They get the numbers 0,
        1, 2 ... in this order. Every frame names how many there are: where the iterable has no
        length, each is written twice.
    variant : {"raw", "emptyfiltered"}
        What `captures` are.
    emptyfiltered : iterable of Capture, optional
        The same frames with the empty room removed, to go beside raw ones. Where each of
        `captures` has a number of its own in `meta["frame"]`, as those of a recording have, one
        that has such a number, too, goes beside the raw one of that number, and raw ones may be
        left without. Otherwise they are taken in order, as many as raw ones.
    timestamps_us : sequence, microseconds, optional
        A number, or a sequence of them, per frame. If not given, `meta["timestamp_us"]` of each
        capture, else 0.
    metadata, alignment : mapping, optional
        Content of `metadata.json` and `alignment.json`, in types that JSON knows.
    meshes : iterable of path-like
        Files to be copied to `photogrammetry/`.
    grid : VoxelGrid, optional
        What `calibration.json` names as the grid of the frames; 20 x 20 x 40 cm if not given.
    copy_from : path-like, optional
        A recording whose `metadata.json`, `alignment.json`, meshes, products and entries of
        `calibration.json` are copied byte by byte, as far as they are not given otherwise. Which
        of its frames a capture is, is in `meta["frame"]`.
    progress : callable, optional
        Called with (frames written, frames in all) after each frame; in all is 0 if not known.
    force : bool
        Replace the radar folder of this waveform, and files of the same name beside it, in a
        folder that exists. Everything else in it stays.

    Returns
    -------
    Path
        The radar folder.

    Raises
    ------
    ModelError
        No capture, captures of different arrays or waveforms, another number of time stamps, or
        an invalid argument.
    MeasurementError
        A file of `copy_from` or of `meshes` cannot be read.
    OutputError
        The folder exists, is not empty and `force` is not set; or the system refuses to write.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from measurement_io import open_recording, save_recording
    >>> array, waveform = clradar.arrays.qar50(), clradar.Waveform([72e9, 77e9, 82e9])
    >>> data = np.full((94, 94, 3), 1 - 1j, np.complex64)
    >>> captures = [clradar.Capture((i + 1) * data, array, waveform) for i in range(3)]
    >>> radar = save_recording("plate/30", captures, timestamps_us=[0, 125_000, 250_000])
    >>> radar.as_posix()
    'plate/30/radar_72.0_82.0_3'
    >>> recording = open_recording("plate/30")
    >>> recording.timestamps_us
    (0, 125000, 250000)
    """
    variant = checks.one_of(f"{_NAME}: variant", variant, VARIANTS)
    if emptyfiltered is not None and variant != "raw":
        checks.fail(f"{_NAME}: emptyfiltered", "captures beside raw ones", f"variant '{variant}'")
    source = None if copy_from is None else find_radar_folder(Path(copy_from))
    target = check_target_folder(Path(path))
    _refuse_existing(target, force=force)
    frames = iter(captures)
    first = next(frames, None)
    if first is None:
        raise ModelError(f"{_NAME}: expected at least one capture, got none")
    checks.instance(f"{_NAME}: captures", first, Capture)
    name = radar_folder_name(first.waveform)

    with new_folder(target) as temporary:
        radar = temporary / name
        (radar / FRAMES_FOLDER).mkdir(parents=True)
        write_antennas(radar, first.array)
        work = _FrameWriter(radar, first, timestamps_us, progress)
        numbers = work.write(_joined(first, frames), _length(captures), variant)
        if emptyfiltered is not None:
            work.write_beside(emptyfiltered, _length(emptyfiltered), numbers)
        sources = [i if number is None else number for i, number in enumerate(numbers)]
        _write_calibration(radar, first.waveform, sources, source, grid)
        if source is not None:
            _copy_products(source, radar, sources)
            _copy_beside(source.absolute().parent, temporary)
        for beside, content in zip(SIDE_FILES, (metadata, alignment), strict=True):
            if content is not None:
                text = json.dumps(json.loads(to_json(f"{_NAME}: {beside}", content)), indent=2)
                (temporary / beside).write_bytes(f"{text}\n".encode("ascii"))
        for mesh in meshes:
            _copy(Path(mesh), temporary / MESH_FOLDER / Path(mesh).name)
        _put_in_place(temporary, target, name, force=force)
    return target / name


class _FrameWriter:
    """Writes the frames of one recording, whose captures have to be of one kind."""

    def __init__(
        self,
        radar: Path,
        first: Capture,
        timestamps_us: Sequence[Any] | None,
        progress: Progress | None,
    ) -> None:
        self._radar = radar
        self._array, self._waveform = first.array, first.waveform
        self._timestamps_us = timestamps_us
        self._progress = progress
        self._companion = Companion()

    def write(
        self, captures: Iterable[Capture], length: int | None, variant: str
    ) -> list[int | None]:
        """Write all frames of a variant; return the numbers that they had, None: no such number."""
        numbers: list[int | None] = []
        for i, capture in enumerate(captures):
            self._write(capture, i, i, length or 1, variant)
            numbers.append(_number(capture))
            if self._progress is not None:
                self._progress(i + 1, length or 0)
        stamps = None if self._timestamps_us is None else len(self._timestamps_us)
        if stamps is not None and len(numbers) != stamps:
            expected = f"{stamps}, one for each of the time stamps"
            checks.fail(f"{_NAME}: {variant} captures", expected, f"{len(numbers)}")
        if length != len(numbers):
            self._write_again(len(numbers), variant)
        return numbers

    def write_beside(
        self, captures: Iterable[Capture], length: int | None, raw: Sequence[int | None]
    ) -> None:
        """Write the emptyfiltered frames, each beside the raw one of its number or its place."""
        known = numbered = None not in raw and len(set(raw)) == len(raw)
        places, written = {number: i for i, number in enumerate(raw)}, set[int]()
        every = f"{_NAME}: emptyfiltered captures"
        one_for_each = (
            f"{len(raw)}, one for each of the raw frames, or numbers in meta['frame'] of both that "
            "say which belong together"
        )
        for done, capture in enumerate(captures):
            number = _number(capture) if known else None
            if number is not None and number not in places:
                wanted = f"one of the raw frames {ranges(n for n in raw if n is not None)}"
                checks.fail(f"{every}[{done}]", wanted, f"frame {number}")
            place = done if number is None else places[number]
            if place >= len(raw):
                checks.fail(every, one_for_each, "more")
            if place in written:
                checks.fail(
                    f"{every}[{done}]", "one for each raw frame", f"another one for frame {place}"
                )
            self._write(capture, done, place, len(raw), "emptyfiltered")
            written.add(place)
            numbered = numbered and number is not None
            if self._progress is not None:
                self._progress(done + 1, length or 0)
        if not written or (len(written) != len(raw) and not numbered):
            checks.fail(every, one_for_each, f"{len(written)}")

    def _write(self, capture: Capture, i: int, place: int, total: int, variant: str) -> None:
        self._check(capture, i)
        given = None if self._timestamps_us is None else self._timestamps_us[place]
        stamp = time_stamp(f"{_NAME}: timestamps_us[{place}]", capture, given)
        write_frame_file(self._file(place, variant), capture, total, stamp)

    def _write_again(self, total: int, variant: str) -> None:
        """Give every frame the number of frames, which only is known at the end."""
        for i in range(total):
            path = self._file(i, variant)
            capture = read_frame_file(path, companion=self._companion)
            stamp = time_stamp(_NAME, capture, None)
            write_frame_file(path, capture, total, stamp, force=True)

    def _check(self, capture: Capture, i: int) -> None:
        checks.instance(f"{_NAME}: captures[{i}]", capture, Capture)
        if i >= MAX_FRAMES or (self._timestamps_us is not None and i >= len(self._timestamps_us)):
            most = MAX_FRAMES if self._timestamps_us is None else len(self._timestamps_us)
            checks.fail(f"{_NAME}: captures", f"at most {most} (frames, time stamps)", "more")
        if not capture.array.same_antennas(self._array):
            first = self._array
            checks.fail(
                f"{_NAME}: captures[{i}]",
                f"the antennas of the first ('{first.name}', {first.n_tx} Tx and {first.n_rx} Rx)",
                f"'{capture.array.name}', {capture.array.n_tx} Tx and {capture.array.n_rx} Rx, or "
                "with other gains or patterns",
            )
        if not capture.waveform.same_frequencies(self._waveform):
            checks.fail(
                f"{_NAME}: captures[{i}]",
                f"the frequencies of the first ({_frequencies(self._waveform)})",
                f"{_frequencies(capture.waveform)}, or other steps between them",
            )

    def _file(self, number: int, variant: str) -> Path:
        return self._radar / FRAMES_FOLDER / frame_name(number, variant)


def _number(capture: Any) -> int | None:
    """Return the number that a frame had where it comes from."""
    number = capture.meta.get("frame") if isinstance(capture, Capture) else None
    return number if isinstance(number, int) and not isinstance(number, bool) else None


def _joined(first: Capture, others: Iterator[Capture]) -> Iterator[Capture]:
    yield first
    del first  # the caller's loop holds one frame, not the first one, too
    yield from others


def _frequencies(waveform: Waveform) -> str:
    low, high = waveform.frequencies_hz[[0, -1]] / 1e9
    return f"{waveform.n_freq} from {low:.9g} to {high:.9g} GHz"


def _length(captures: Iterable[Capture]) -> int | None:
    return len(captures) if isinstance(captures, Sized) else None


def _write_calibration(
    radar: Path,
    waveform: Waveform,
    numbers: Sequence[int],
    source: Path | None,
    grid: VoxelGrid | None,
) -> None:
    there: dict[str, Any] = {}
    if source is not None and (source / CALIBRATION_FILE).exists():
        there = read_json_object(source / CALIBRATION_FILE)
    new = grid_entry(grid)
    frames = {i: there.get(f"{number:06d}", new) for i, number in enumerate(numbers)}
    write_calibration(radar / CALIBRATION_FILE, waveform, frames)


def _copy_products(source: Path, radar: Path, numbers: Sequence[int]) -> None:
    for product, kind in PRODUCTS.items():
        there = product_files(source, product)
        for i, number in enumerate(numbers):
            if number in there:
                _copy(there[number], radar / product / f"{i:06d}.{kind}")


def _copy_beside(source: Path, target: Path) -> None:
    """Copy `metadata.json`, `alignment.json` and the meshes of a recording."""
    for name in SIDE_FILES:
        if (source / name).is_file():
            _copy(source / name, target / name)
    if (source / MESH_FOLDER).is_dir():
        for path in entries(source / MESH_FOLDER):
            if path.name.startswith("mesh") and path.is_file():
                _copy(path, target / MESH_FOLDER / path.name)


def _copy(source: Path, target: Path) -> None:
    regular_file_size(source, "a file to copy")
    target.parent.mkdir(exist_ok=True)
    shutil.copyfile(source, target)


def _refuse_existing(target: Path, *, force: bool) -> None:
    try:
        if not os.path.lexists(target):
            return
        if not target.is_dir():
            raise OutputError(f"{shown(target)}: expected a folder, got a file of that name")
        if any(target.iterdir()) and not force:
            raise OutputError(f"{shown(target)}: exists already; not written into without force")
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{shown(target)}: cannot be written: {clean(error)}") from error


def _put_in_place(temporary: Path, target: Path, radar: str, *, force: bool) -> None:
    _refuse_existing(target, force=force)  # it may have appeared meanwhile
    if not target.exists() or not any(target.iterdir()):
        move_folder(temporary, target.absolute())
        return
    swap_folder(temporary / radar, target / radar, aside=temporary / f"{radar}.replaced")
    for path in sorted(p for p in temporary.rglob("*") if p.is_file()):
        inside = path.relative_to(temporary)
        if inside.parts[0].startswith("radar_"):
            continue  # what was replaced; it goes with the temporary folder
        (target / inside).parent.mkdir(exist_ok=True)
        os.replace(path, target / inside)
