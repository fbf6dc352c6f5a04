"""Recorded captures and the native HDF5 file, as records of `clradar`; files for others."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from measurement_io.export import export_file
from measurement_io.maroon.recording import Recording, open_recording
from measurement_io.maroon.writer import save_recording
from measurement_io.native.records import (
    open_channels,
    open_volume,
    save_capture,
    save_channels,
    save_volume,
)
from measurement_io.opening import open, open_capture
from measurement_io.record_facts import Description, Fact

if TYPE_CHECKING:
    from measurement_io.check import CheckReport, check_file
    from measurement_io.description import describe
    from measurement_io.layouts.apply import open_with_layout
    from measurement_io.layouts.layout import Layout, read_layout
    from measurement_io.maroon.alignment import SensorAlignment, read_alignment, read_transform
    from measurement_io.maroon.depth_map import read_depth_map
    from measurement_io.maroon.metadata import MaskBox, RecordingMetadata, read_metadata

_ON_FIRST_USE = {
    "check": ("CheckReport", "check_file"),
    "description": ("describe",),
    "layouts.apply": ("open_with_layout",),
    "layouts.layout": ("Layout", "read_layout"),
    "maroon.alignment": ("SensorAlignment", "read_alignment", "read_transform"),
    "maroon.depth_map": ("read_depth_map",),
    "maroon.metadata": ("MaskBox", "RecordingMetadata", "read_metadata"),
}
"""Modules that import pydantic, which takes longer than the rest, and their public names."""

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
    "save_recording",
    "save_volume",
]


def __getattr__(name: str) -> Any:
    for module, names in _ON_FIRST_USE.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
