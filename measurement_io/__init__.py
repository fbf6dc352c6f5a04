"""Recorded captures and the native HDF5 file, as records of `clradar`."""

from measurement_io.check import CheckReport, check_file
from measurement_io.describe import Description, describe
from measurement_io.maroon.product_writer import write_products
from measurement_io.maroon.recording_writer import save_recording
from measurement_io.maroon.writer import save_maroon_frame
from measurement_io.native import open_volume, save_capture, save_volume
from measurement_io.opening import open_capture

__all__ = [
    "CheckReport",
    "Description",
    "check_file",
    "describe",
    "open_capture",
    "open_volume",
    "save_capture",
    "save_maroon_frame",
    "save_recording",
    "save_volume",
    "write_products",
]
