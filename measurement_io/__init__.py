"""Recorded captures and the native HDF5 file, as records of `clradar`; files for others."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from measurement_io.check import CheckReport, check_file
from measurement_io.describe import describe
from measurement_io.export.exporting import export_file
from measurement_io.maroon.alignment import SensorAlignment, read_alignment
from measurement_io.maroon.metadata import MaskBox, RecordingMetadata, read_metadata
from measurement_io.maroon.recording import Recording, open_recording
from measurement_io.maroon.recording_writer import save_recording
from measurement_io.maroon.writer import save_maroon_frame
from measurement_io.native.records import (
    open_channels,
    open_volume,
    save_capture,
    save_channels,
    save_volume,
)
from measurement_io.opening import open, open_capture
from measurement_io.record_facts import Description, Fact
from measurement_io.transform_file import read_transform

if TYPE_CHECKING:
    from measurement_io.layouts.apply import open_with_layout
    from measurement_io.layouts.layout import Layout, read_layout
    from measurement_io.maroon.depth_map import read_depth_map

_ON_FIRST_USE = {
    "Layout": "layouts.layout",
    "open_with_layout": "layouts.apply",
    "read_depth_map": "maroon.depth_map",
    "read_layout": "layouts.layout",
}
"""Names whose modules import pydantic, which takes longer than the rest."""

__all__ = [
    "CheckReport",
    "Description",
    "Fact",
    "Layout",
    "MaskBox",
    "Recording",
    "RecordingMetadata",
    "SensorAlignment",
    "check_file",
    "describe",
    "export_file",
    "open",
    "open_capture",
    "open_channels",
    "open_recording",
    "open_volume",
    "open_with_layout",
    "read_alignment",
    "read_depth_map",
    "read_layout",
    "read_metadata",
    "read_transform",
    "save_capture",
    "save_channels",
    "save_maroon_frame",
    "save_recording",
    "save_volume",
]


def __getattr__(name: str) -> Any:
    if name not in _ON_FIRST_USE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_ON_FIRST_USE[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
