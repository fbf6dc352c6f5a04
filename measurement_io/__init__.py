"""Recorded captures and the native HDF5 file, as records of `clradar`."""

from measurement_io.check import CheckReport, check_file
from measurement_io.describe import Description, describe
from measurement_io.layouts.apply import open_with_layout
from measurement_io.layouts.description import Layout
from measurement_io.layouts.skeleton import LayoutNeeded
from measurement_io.layouts.toml_reader import read_layout
from measurement_io.maroon.writer import save_maroon_frame
from measurement_io.native import open_volume, save_capture, save_volume
from measurement_io.opening import open_capture

__all__ = [
    "CheckReport",
    "Description",
    "Layout",
    "LayoutNeeded",
    "check_file",
    "describe",
    "open_capture",
    "open_volume",
    "open_with_layout",
    "read_layout",
    "save_capture",
    "save_maroon_frame",
    "save_volume",
]
