"""Open any supported recording: what a path holds is decided by its content."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal, get_args

from clradar.model import Capture, checks
from measurement_io import hdf5_guard, native
from measurement_io.failures import fail, reading, regular_file_size
from measurement_io.maroon import frame as frame_reader
from measurement_io.maroon.folders import VARIANTS
from measurement_io.maroon.frame_file import NPY_MAGIC

Kind = Literal["native", "frame", "folder"]
KINDS: tuple[Kind, ...] = get_args(Kind)
SUPPORTED = (
    "a native HDF5 file, a recorded frame (.npy with a pickled dictionary of xr and fvec), "
    "a folder radar_<low GHz>_<high GHz>_<points>, or the <object>/<distance> folder that holds one"
)


def open_capture(
    path: str | os.PathLike[str],
    *,
    frame: int | None = None,
    variant: str | None = None,
    rx_file: str | os.PathLike[str] | None = None,
    tx_file: str | os.PathLike[str] | None = None,
) -> Capture:
    """Return the capture that a file or a folder holds; the content decides, not the name.

    Parameters
    ----------
    path : path-like
        A native HDF5 file, a recorded `.npy` frame, a `radar_<low>_<high>_<points>` folder, or the
        `<object>/<distance>` folder that holds one.
    frame : int, optional
        Which frame of a folder; 0 if not given.
    variant : {"raw", "emptyfiltered"}, optional
        Which variant of a folder's frame; "raw" if not given.
    rx_file, tx_file : path-like, optional
        Antenna positions of a recorded frame; those of `clradar.arrays.qar50()` if not given.

    Returns
    -------
    Capture
        data[tx, rx, freq], complex64. `meta` of a recorded frame has `source`, `format` ("maroon"),
        `frame`, `variant`, `timestamp_us`, and the numbers and strings that the file adds.

    Raises
    ------
    MeasurementError
        Missing, unreadable, damaged or hostile; of an unknown kind or a newer version; NaN or
        infinite values; parts that disagree. The message names the file, what was expected and
        what was found. No code of a file is ever run.
    ModelError
        An argument that cannot be meant.
    """
    source = Path(path)
    if frame is not None:
        frame = checks.whole("open_capture: frame", frame, 0)
    if variant is not None:
        variant = checks.one_of("open_capture: variant", variant, VARIANTS)
    with reading(source, SUPPORTED):
        kind = kind_of(source)
        if kind == "folder":
            return frame_reader.read_folder(
                source,
                frame=0 if frame is None else frame,
                variant="raw" if variant is None else variant,
                rx_file=rx_file,
                tx_file=tx_file,
            )
        if frame is not None or variant is not None:
            fail(source, "a folder of frames, for frame= and variant= to choose from", "one file")
        if kind == "frame":
            return frame_reader.read_frame_file(source, rx_file=rx_file, tx_file=tx_file)
        if rx_file is not None or tx_file is not None:
            fail(source, "a recorded frame, for antenna files to apply to", "a native file")
        return native.read_capture(source)[1]


def kind_of(path: Path) -> Kind:
    """Return which kind of source a path is, by its content.

    Raises
    ------
    MeasurementError
        Missing, unreadable, or of a kind that is not supported; the message says which are.
    """
    with reading(path, SUPPORTED):
        if path.is_dir():
            return "folder"
    size = regular_file_size(path, SUPPORTED)
    with reading(path, SUPPORTED), open(path, "rb") as file:
        start = file.read(8)
    if start == hdf5_guard.HDF5_MAGIC:
        return "native"
    if start.startswith(NPY_MAGIC):
        return "frame"
    fail(path, SUPPORTED, _guess(start, size))


def _guess(start: bytes, size: int) -> str:
    if size == 0:
        return "an empty file"
    if start.startswith(b"PK\x03\x04"):
        return "a zip archive (such as .npz), which is not read"
    if start.startswith(b"MATLAB"):
        return "a MATLAB file, which is not read"
    return "something else"
