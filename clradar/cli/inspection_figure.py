"""The figure of what a file holds, drawn from what is in it: ``clradar inspect --png``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clradar.cli.console import progress_bar
from clradar.cli.options.values import wrong_usage
from clradar.cli.titles import title_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_of(
    path: Path, *, view: str | None = None, plane: tuple[str, float | None] | None = None
) -> Figure:
    """A volume's image; echoes and channels of a capture, or over the frames of a recording.

    `view` and `plane`, an axis and a place in metres, are of a volume.

    Raises
    ------
    MeasurementError
        Missing, unreadable, or none of these.
    CompareError
        Everything is zero, or the volume is a single voxel.
    """
    from clradar.plot import capture_figure, image_figure, plane_of, recording_figure
    from measurement_io import open_capture, open_channels, open_recording, open_volume
    from measurement_io.native.captures_volumes import read_header
    from measurement_io.opening import kind_of

    kind = kind_of(path)
    native = read_header(path).format if kind == "native" else None
    if native != "volume":
        for name, value in {"--view": view, "--slice": plane}.items():
            if value is not None:
                raise wrong_usage(name, f"expected with a volume, which {path} is not")
    if kind == "folder":
        recording = open_recording(path)
        title = title_of(path, {})
        with progress_bar("reading") as progress:
            return recording_figure(recording, recording.frame_numbers, title, progress=progress)
    if native == "volume":
        volume = open_volume(path)
        drawn = volume if plane is None else plane_of(volume, *plane)
        return image_figure(drawn, title_of(path, volume.meta), view=view)
    if native == "channels":
        from calibration.channels.figure import channels_figure

        channels = open_channels(path)
        return channels_figure(channels, title_of(path, channels.meta))
    capture = open_capture(path)
    return capture_figure(capture, title_of(path, capture.meta))
