"""Recorded captures and the native HDF5 file, as records of `clradar`; files for others."""

# A package of clradar: clradar/files/own_packages.py looks for this line.

from measurement_io.check import CheckReport, check_file
from measurement_io.describe import describe
from measurement_io.export.exporting import export_file
from measurement_io.layouts.capture_by_layout import open_with_layout
from measurement_io.layouts.draft import LayoutNeeded
from measurement_io.layouts.layout import Layout
from measurement_io.layouts.toml_reader import read_layout
from measurement_io.maroon.alignment import SensorAlignment, read_alignment
from measurement_io.maroon.metadata import MaskBox, RecordingMetadata, read_metadata
from measurement_io.maroon.product_writer import write_products
from measurement_io.maroon.recording import Recording, open_recording
from measurement_io.maroon.recording_writer import save_recording
from measurement_io.maroon.writer import save_maroon_frame
from measurement_io.native.captures_volumes import open_volume, save_capture, save_volume
from measurement_io.native.channels_file import open_channels, save_channels
from measurement_io.opening import open_capture
from measurement_io.record_facts import Description, Fact
from measurement_io.transform_file import read_transform

__all__ = [
    "CheckReport",
    "Description",
    "Fact",
    "Layout",
    "LayoutNeeded",
    "MaskBox",
    "Recording",
    "RecordingMetadata",
    "SensorAlignment",
    "check_file",
    "describe",
    "export_file",
    "open_capture",
    "open_channels",
    "open_recording",
    "open_volume",
    "open_with_layout",
    "read_alignment",
    "read_layout",
    "read_metadata",
    "read_transform",
    "save_capture",
    "save_channels",
    "save_maroon_frame",
    "save_recording",
    "save_volume",
    "write_products",
]


def __dir__() -> list[str]:
    return sorted(__all__)
