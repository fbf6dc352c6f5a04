"""Open a capture or a recording of any supported format, by its content."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal, get_args

from clradar.files.failures import fail, reading, regular_file_size
from clradar.files.meshes.reading import FORMATS
from clradar.model import Capture, checks
from measurement_io.confined import hdf5_process
from measurement_io.layouts.capture_by_layout import open_with_layout
from measurement_io.layouts.containers import is_plain_array, opener_of
from measurement_io.layouts.draft import layout_needed
from measurement_io.layouts.hdf5_container import opened_hdf5
from measurement_io.layouts.layout import Layout
from measurement_io.layouts.numpy_containers import opened_npy
from measurement_io.maroon import frame as frame_reader
from measurement_io.maroon.folders import VARIANTS
from measurement_io.native import captures_volumes as native
from measurement_io.native import contents as native_contents

Kind = Literal["native", "frame", "folder", "container"]
KINDS: tuple[Kind, ...] = get_args(Kind)
SUPPORTED = (
    "a native HDF5 file, a recorded frame (.npy with a pickled dictionary of xr and fvec), "
    "a folder radar_<low GHz>_<high GHz>_<points>, the <object>/<distance> folder that holds one, "
    "or, with a layout, any HDF5, MATLAB (v5 or v7.3), .npz or plain .npy file"
)


def open_capture(
    path: str | os.PathLike[str],
    *,
    frame: int | None = None,
    variant: str | None = None,
    rx_file: str | os.PathLike[str] | None = None,
    tx_file: str | os.PathLike[str] | None = None,
    layout: str | os.PathLike[str] | Layout | None = None,
) -> Capture:
    """Return the capture that a file or a folder holds; the content decides, not the name.

    Parameters
    ----------
    path : path-like
        A native HDF5 file, a recorded `.npy` frame, a `radar_<low>_<high>_<points>` folder, or the
        `<object>/<distance>` folder that holds one; with `layout`, the file of another program.
    frame : int, optional
        Which frame of a folder, or of a file whose layout has a frame axis; 0 if not given.
    variant : {"raw", "emptyfiltered"}, optional
        Which variant of a folder's frame; "raw" if not given.
    rx_file, tx_file : path-like, optional
        Antenna positions of a recorded frame; those of `clradar.arrays.qar50()` if not given.
    layout : path-like or Layout, optional
        A TOML file with the keys, axes and units of `path` (docs/layouts.md), see
        `open_with_layout`. Needed for what is neither a native file nor a recorded frame.

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
        what was found. No code of a file is ever run. Of a file that needs a layout and has none
        it is a `LayoutNeeded`, which lists the file's keys and carries the draft of a layout.
    ModelError
        An invalid argument.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.measurement_io import open_capture, save_capture
    >>> waveform = clradar.Waveform([76e9, 77e9, 78e9])
    >>> array = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]], "lab")
    >>> cycles = waveform.frequencies_hz * 0.6 / clradar.constants.SPEED_OF_LIGHT_M_PER_S
    >>> data = np.exp(-2j * np.pi * cycles) * np.ones((2, 1, 1))  # a path of 0.6 m
    >>> capture = clradar.Capture(data.astype(np.complex64), array, waveform, {"room": "B 12"})
    >>> save_capture("capture.h5", capture)
    >>> read = open_capture("capture.h5")
    >>> step_rad = np.angle(read.data[0, 0, 0] / read.data[0, 0, 1])  # 2 pi d / c * 1 GHz, wrapped
    >>> round(0.299792458 * (2 + float(step_rad) / (2 * np.pi)), 3)  # metres, two whole cycles
    0.6
    """
    source = Path(path)
    if frame is not None:
        frame = checks.whole("open_capture: frame", frame, 0)
    if variant is not None:
        variant = checks.one_of("open_capture: variant", variant, VARIANTS)
    if layout is not None:
        if variant is not None or rx_file is not None or tx_file is not None:
            fail(source, "a layout alone, which has the positions", "other settings with it")
        return open_with_layout(source, layout, frame=frame)
    with reading(source, SUPPORTED):
        settings = (frame, variant, rx_file, tx_file)
        if all(setting is None for setting in settings) and _is_hdf5(source):
            # Kind and content in one go: each process costs as much as reading a small file.
            found = native.read_capture_if_native(source)
            if found is None:
                raise layout_needed(source)
            return found[1]
        kind = kind_of(source)
        if kind == "container":
            raise layout_needed(source)
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


def _is_hdf5(path: Path) -> bool:
    return not path.is_dir() and opener_of(path) is opened_hdf5


def kind_of(path: Path) -> Kind:
    """Return which kind of source a path is, by its content.

    Raises
    ------
    MeasurementError
        Missing, unreadable, or of a kind that is not supported; the message lists those that are.
    """
    with reading(path, SUPPORTED):
        if path.is_dir():
            return "folder"
    opener = opener_of(path)
    if opener is opened_npy:
        return "container" if is_plain_array(path) else "frame"
    if opener is opened_hdf5:
        return "native" if hdf5_process.run(native_contents.is_native, path) else "container"
    if path.suffix.lower() in FORMATS:
        fail(path, "a capture", "a mesh by its name: simulate it first (clradar simulate)")
    if opener is not None:
        return "container"
    size = regular_file_size(path, SUPPORTED)
    fail(path, SUPPORTED, "something else" if size else "an empty file")
