"""Open a capture or a recording of any supported format, by its content."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.files.failures import fail, reading, regular_file_size
from clradar.files.meshes.reading import FORMATS
from clradar.model import Capture, ChannelCalibration, Volume, checks
from measurement_io.layouts.lab_file import form_of, layout_needed
from measurement_io.maroon import frame as frame_reader
from measurement_io.maroon.folders import (
    VARIANTS,
    antennas_file,
    find_frame,
    find_radar_folder,
)
from measurement_io.maroon.recording import Recording, open_recording
from measurement_io.native import records as native

if TYPE_CHECKING:
    from measurement_io.layouts.layout import Layout

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
        A native HDF5 file, a recorded `.npy` frame, the folder of a recording, or with `layout` the
        file of another program.
    frame : int, optional
        Of a folder, or of a file whose layout has a frame axis; 0 if not given.
    variant, rx_file, tx_file
        Of a recording, as for `open_recording`.
    layout : path-like or Layout, optional
        Keys, axes and units of an HDF5, MATLAB (v5 or v7.3), `.npz` or plain `.npy` file
        (docs/layouts.md).

    Returns
    -------
    Capture
        `meta` of a recorded frame has `source`, `format` ("maroon"), `frame`, `variant`,
        `timestamp_us`, and the numbers and strings that the file adds; of a layout, the layout.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("lab.toml").write_text('''
    ... data = {key = "s", axes = ["tx", "rx", "freq"]}
    ... tx.key = "tx_mm"
    ... rx.key = "rx_mm"
    ... antennas.unit = "mm"
    ... frequency = {key = "f", unit = "GHz"}
    ... ''')
    >>> lab = {"tx_mm": np.eye(3), "rx_mm": np.eye(3)[:2], "f": np.linspace(72, 82, 5)}
    >>> np.savez("lab.npz", s=np.ones((3, 2, 5), np.complex64), **lab)
    >>> read = measurement_io.open_capture("lab.npz", layout="lab.toml")
    >>> read.data.shape, read.array.tx_m[0].tolist(), read.waveform.n_freq
    ((3, 2, 5), [0.001, 0.0, 0.0], 5)
    """
    source = Path(path)
    if frame is not None:
        frame = checks.whole("open_capture: frame", frame, 0)
    if variant is not None:
        variant = checks.one_of("open_capture: variant", variant, VARIANTS)
    antennas = rx_file is not None or tx_file is not None
    if layout is not None:
        if variant is not None or antennas:
            fail(source, "a layout alone, which has the positions", "other settings with it")
        from measurement_io.layouts.apply import open_with_layout

        return open_with_layout(source, layout, frame)
    with reading(source, SUPPORTED):
        file = source
        if source.is_dir():
            file = find_frame(find_radar_folder(source), frame or 0, variant or "raw")
        elif frame is not None or variant is not None:
            fail(source, "a folder of frames, for frame= and variant= to choose from", "one file")
        elif form_of(source) == "hdf5":
            # Kind and content in one go: each process costs as much as reading a small file.
            found = native.read_if_native(source, "capture")
            if found is None:
                raise layout_needed(source)
            if antennas:
                fail(source, "a recorded frame, for antenna files to apply to", "a native file")
            return found[1]
        elif kind_of(source) == "container":
            raise layout_needed(source)
        array = frame_reader.antenna_array(rx_file, tx_file, antennas_file(file))
        return frame_reader.read_frame_file(file, array)


def kind_of(path: Path) -> str:
    """Return what a path is by its content: "folder", "frame", "container", or a native format."""
    with reading(path, SUPPORTED):
        if path.is_dir():
            return "folder"
    form = form_of(path)
    if form == "npy":
        return "container" if frame_reader.is_plain_array(path) else "frame"
    if form == "hdf5":
        return native.format_of(path) or "container"
    if path.suffix.lower() in FORMATS:
        fail(path, "a capture", "a mesh by its name: simulate it first (clradar simulate)")
    if form is not None:
        return "container"
    size = regular_file_size(path, SUPPORTED)
    fail(path, SUPPORTED, "something else" if size else "an empty file")


def open(path: str | os.PathLike[str]) -> Capture | Volume | ChannelCalibration | Recording:
    """Return what a path holds: a capture, a volume, channels, or the recording of a folder.

    Examples
    --------
    >>> measurement_io.save_capture("capture.h5", capture)
    >>> measurement_io.open("capture.h5").data.shape
    (2, 1, 3)
    """
    source = Path(path)
    with reading(source, SUPPORTED):
        if source.is_dir():
            return open_recording(source)
    found = native.read_if_native(source) if form_of(source) == "hdf5" else None
    return open_capture(source) if found is None else found[1]
