"""Write frames and recordings in the form in which those of the 94 x 94 imager are exchanged."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Iterable, Mapping, Sequence, Sized
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from clradar import arrays
from clradar.arrays.array_file import array_text
from clradar.errors import ModelError, OutputError
from clradar.files.atomic import (
    move_folder,
    new_folder,
    replacing,
    swap_folder,
    write_file,
    writing,
)
from clradar.files.failures import regular_file_size, shown
from clradar.files.json_file import to_json
from clradar.model import AntennaArray, Capture, Waveform, checks
from clradar.model.progress import Progress
from measurement_io.maroon.folders import (
    ALIGNMENT_FILE,
    ANTENNAS_FILE,
    CALIBRATION_FILE,
    FRAMES_FOLDER,
    MESH_FOLDER,
    METADATA_FILE,
    RadarFolderName,
)
from measurement_io.maroon.frame import CHANNELS, IMAGING
from measurement_io.maroon.frame_file import is_scalar

MAX_FRAMES = 1_000_000  # a frame's number has six digits
_OF_THE_FORM = frozenset(
    ("xr", "fvec", "number_of_measurements", "timestamp_us", "source", "format", "frame", "variant")
)
"""Keys of `Capture.meta` that the reader sets anew, or that mean something else in the form."""

_NAME = "save_recording"


def save_recording(
    path: str | os.PathLike[str],
    captures: Iterable[Capture],
    *,
    timestamps_us: Sequence[Any] | None = None,
    metadata: Mapping[str, Any] | None = None,
    alignment: Mapping[str, Any] | None = None,
    meshes: Iterable[str | os.PathLike[str]] = (),
    progress: Progress | None = None,
    force: bool = False,
) -> Path:
    """Write captures as a recording, `path/radar_<low>_<high>_<points>` and the files beside it.

    One frame at a time is in memory, and `path` never holds half a recording.

    Parameters
    ----------
    path : path-like
        The `<object>/<distance>` folder; made where it is missing.
    captures : iterable of Capture
        All of one array and waveform, numbered from 0; what has no length needs time stamps.
    timestamps_us : sequence, optional
        A number, or a sequence of them, per frame. Default: `meta["timestamp_us"]`, else 0.
    metadata, alignment : mapping, optional
        Content of `metadata.json` and `alignment.json`.
    meshes : iterable of path-like
        Files to be copied to `photogrammetry/`.
    force : bool
        Replace the radar folder of this waveform, and files of the same name beside it.

    Returns
    -------
    Path
        The radar folder.

    Examples
    --------
    >>> stamps_us = [0, 125_000, 250_000]
    >>> measurement_io.save_recording("plate/30", frames, timestamps_us=stamps_us).name
    'radar_72.0_82.0_3'
    >>> measurement_io.open_recording("plate/30").timestamps_us
    (0, 125000, 250000)
    """
    target = Path(path)
    if RadarFolderName.parse(target.absolute().name) is not None:
        raise OutputError(
            f"{shown(target)}: expected the folder that is to hold the radar folder, got a name of "
            "the latter, which is made by itself"
        )
    _refuse_existing(target, force=force)
    counted: Any = captures if timestamps_us is None else timestamps_us
    if not isinstance(counted, Sized):
        checks.fail(f"{_NAME}: captures", "a list, or time stamps, to count them by", "neither")
    total = min(len(counted), MAX_FRAMES)
    iterator = iter(captures)
    first = next(iterator, None)
    if first is None:
        raise ModelError(f"{_NAME}: expected at least one capture, got none")
    checks.instance(f"{_NAME}: captures", first, Capture)
    name = "_".join(map(str, ("radar", *_frequency_entries(first.waveform).values())))

    with new_folder(target) as temporary:
        radar = temporary / name
        (radar / FRAMES_FOLDER).mkdir(parents=True)
        array = first.array  # as in the form, those of the imager are not written
        other = array.has_patterns or array.has_gains
        if other or not array.same_positions(arrays.qar50()):
            write_file(radar / ANTENNAS_FILE, array_text(array).encode("utf-8"))
        written = 0
        for capture in chain([first], iterator):
            if written >= total:
                checks.fail(f"{_NAME}: captures", f"at most {total} (frames, time stamps)", "more")
            _check_alike(f"{_NAME}: captures[{written}]", capture, first)
            given = None if timestamps_us is None else timestamps_us[written]
            stamp = _time_stamp(f"{_NAME}: timestamps_us[{written}]", capture, given)
            _write_frame(radar / FRAMES_FOLDER / f"{written:06d}.npy", capture, total, stamp)
            written += 1
            if progress is not None:
                progress(written, total)
        if written < total:
            expected = f"{total}, one for each of the time stamps"
            checks.fail(f"{_NAME}: captures", expected, f"{written}")
        entries = {f"{n:06d}": {"volume": _GRID} for n in range(total)}
        calibration = json.dumps({**_frequency_entries(first.waveform), **entries}, indent=2)
        write_file(radar / CALIBRATION_FILE, f"{calibration}\n".encode("ascii"))
        for beside, content in ((METADATA_FILE, metadata), (ALIGNMENT_FILE, alignment)):
            if content is not None:
                text = json.dumps(json.loads(to_json(f"{_NAME}: {beside}", content)), indent=2)
                (temporary / beside).write_bytes(f"{text}\n".encode("ascii"))
        for mesh in meshes:
            regular_file_size(Path(mesh), "a file to copy")
            (temporary / MESH_FOLDER).mkdir(exist_ok=True)
            shutil.copyfile(mesh, temporary / MESH_FOLDER / Path(mesh).name)
        _put_in_place(temporary, target, name, force=force)
    return target / name


def _check_alike(name: str, capture: Capture, first: Capture) -> None:
    checks.instance(name, capture, Capture)
    if not capture.array.same_antennas(first.array):
        checks.fail(name, f"the antennas of the first ({_text(first.array)})",
                    f"{_text(capture.array)}, or with other gains or patterns")  # fmt: skip
    if not capture.waveform.same_frequencies(first.waveform):
        checks.fail(
            name,
            f"the frequencies of the first ({_frequencies(first.waveform)})",
            f"{_frequencies(capture.waveform)}, or other steps between them",
        )


def _text(array: AntennaArray) -> str:
    return f"'{array.name}' with {array.n_tx} Tx and {array.n_rx} Rx"


def _frequencies(waveform: Waveform) -> str:
    low, high = waveform.frequencies_hz[[0, -1]] / 1e9
    return f"{waveform.n_freq} from {low:.9g} to {high:.9g} GHz"


# ---- files and names of the form


def _frequency_entries(waveform: Waveform) -> dict[str, float | int]:
    low_ghz, high_ghz = (float(f) / 1e9 for f in waveform.frequencies_hz[[0, -1]])
    return {
        "frequency_low_ghz": low_ghz,
        "frequency_high_ghz": high_ghz,
        "frequency_points": waveform.n_freq,
    }


def _time_stamp(field: str, capture: Capture, given: Any) -> np.ndarray:
    """Return the time stamps of a frame as the form has them: an array, shape (n,)."""
    value = capture.meta.get("timestamp_us") if given is None else given
    try:
        stamps = np.atleast_1d(np.asarray(0 if value is None else value))
    except ValueError:  # nested lists of different lengths
        stamps = np.empty(0, dtype=object)
    plain = stamps.ndim == 1 and stamps.size and stamps.dtype.kind in "iuf"
    if not plain or not np.isfinite(stamps).all():
        checks.fail(field, "a finite number of microseconds, or several", repr(value)[:60])
    return stamps


def _write_frame(target: Path, capture: Capture, total: int, stamp: np.ndarray) -> None:
    """Write one `.npy` file; the arguments are taken as checked."""
    xr = capture.data.transpose(1, 0, 2)
    if xr.shape[:2] == (CHANNELS - 2, CHANNELS - 2):
        whole = np.zeros((CHANNELS, CHANNELS, capture.waveform.n_freq), np.complex64)
        whole[IMAGING, IMAGING, :] = xr
        xr = whole
    holder = np.empty((), dtype=object)
    holder[()] = {
        "xr": np.ascontiguousarray(xr),
        "fvec": np.array(capture.waveform.frequencies_hz),
        "number_of_measurements": total,
        "timestamp_us": stamp,
        **{k: v for k, v in capture.meta.items() if k not in _OF_THE_FORM and is_scalar(v)},
    }
    with replacing(target) as temporary, open(temporary, "xb") as file:
        header = {"descr": "|O", "fortran_order": False, "shape": ()}
        np.lib.format.write_array_header_1_0(file, header)
        _PortablePickler(file, protocol=3).dump(holder)


_Pickler: Any = pickle._Pickler
"""The one in Python, whose names can be replaced."""


class _PortablePickler(_Pickler):
    """Writes what every numpy reads: numpy 2 knows the names of numpy 1, but not the reverse."""

    def save_global(self, obj: Any, name: str | None = None) -> None:
        module = getattr(obj, "__module__", None) or ""
        if not module.startswith("numpy._core."):
            super().save_global(obj, name)
            return
        old = module.replace("numpy._core.", "numpy.core.", 1)
        self.write(f"c{old}\n{obj.__name__}\n".encode("ascii"))
        self.memoize(obj)


_GRID = {
    "bb_min": [-0.1, -0.1, 0.2],
    "bb_max": [0.1, 0.1, 0.6000000000000001],
    "grid_size": [201, 201, 201],
}
"""Of a frame without an image, in radar space: where objects of the dataset are."""


# ---- the folder as a whole


def _refuse_existing(target: Path, *, force: bool) -> None:
    with writing(target):
        if os.path.lexists(target) and not target.is_dir():
            raise OutputError(f"{shown(target)}: expected a folder, got a file of that name")
        if target.is_dir() and any(target.iterdir()) and not force:
            raise OutputError(f"{shown(target)}: exists already; not written into without force")


def _put_in_place(temporary: Path, target: Path, radar: str, *, force: bool) -> None:
    _refuse_existing(target, force=force)  # it may have appeared meanwhile
    if not force or not target.exists() or not any(target.iterdir()):
        move_folder(temporary, target.absolute())
        return
    swap_folder(temporary / radar, target / radar, aside=temporary / f"{radar}.replaced")
    for path in sorted(p for p in temporary.rglob("*") if p.is_file()):
        inside = path.relative_to(temporary)
        if inside.parts[0].startswith("radar_"):
            continue  # what was replaced; it goes with the temporary folder
        (target / inside).parent.mkdir(exist_ok=True)
        os.replace(path, target / inside)
