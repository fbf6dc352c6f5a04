from .description import (
    CheckReport as CheckReport,
    check_file as check_file,
    describe as describe,
)
from .export import export_file as export_file
from .layouts.layout import Layout as Layout, read_layout as read_layout
from .maroon.alignment import (
    SensorAlignment as SensorAlignment,
    read_alignment as read_alignment,
    read_transform as read_transform,
)
from .maroon.depth_map import read_depth_map as read_depth_map
from .maroon.recording import Recording as Recording, open_recording as open_recording
from .maroon.writer import save_recording as save_recording
from .native.records import (
    open_channels as open_channels,
    open_volume as open_volume,
    save_capture as save_capture,
    save_channels as save_channels,
    save_volume as save_volume,
)
from .opening import open as open, open_capture as open_capture
from .record_facts import Description as Description, Fact as Fact
