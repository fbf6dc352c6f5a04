"""Captures and volumes that commands read, their titles, and images."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import clradar as cl
import measurement_io
from clradar.cli.console import print_line, progress_bar
from clradar.cli.groups import given, wrong_usage
from clradar.cli.options.measured import (
    FrameOptions,
    GridOptions,
    ImagingOptions,
    RadarOptions,
    open_frame,
)
from clradar.model.volume import capture_meta

Content = cl.Volume | cl.Capture


def form_image(
    capture: cl.Capture,
    grid: cl.VoxelGrid,
    imaging: ImagingOptions,
    device: cl.Device | str | None,
    label: str = "imaging",
) -> cl.Volume:
    """The image of a capture, with a progress bar on a terminal."""
    fitted = imaging.method in ("least-squares", "sparse")
    form = cl.reconstruct if fitted else cl.backproject
    with progress_bar(label) as progress:
        return form(capture, grid, device=device, progress=progress, **imaging.arguments)


@dataclass(frozen=True)
class ImageInput:
    """A volume, or a capture that is still to be imaged, and where it comes from."""

    path: Path
    content: Content

    @classmethod
    def open(cls, path: Path, frames: FrameOptions | None = None) -> ImageInput:
        """Open a file or a folder; a frame can be chosen of a recording only."""
        from measurement_io.opening import kind_of

        frames = frames or FrameOptions()
        if frames == FrameOptions() and kind_of(path) == "volume":
            return cls(path, measurement_io.open_volume(path))
        return cls(path, open_frame(path, frames))

    @property
    def grid(self) -> cl.VoxelGrid | None:
        """The voxel grid of a volume; None for a capture."""
        return self.content.grid if isinstance(self.content, cl.Volume) else None

    def radar_or(self, options: RadarOptions) -> dict[str, Any]:
        """`array` and `waveform` of a capture; of a volume, which has none, of the options."""
        if isinstance(self.content, cl.Volume):
            return {"array": options.antennas(), "waveform": options.waveform()}
        if given(options):
            text = f"{self.path} is a capture and has its antennas and frequencies"
            raise wrong_usage(", ".join(given(options)), text)
        return {"array": self.content.array, "waveform": self.content.waveform}

    def volume(
        self, grid: cl.VoxelGrid, imaging: ImagingOptions, device: cl.Device | None
    ) -> cl.Volume:
        """The volume, or the image of the capture on `grid`."""
        if isinstance(self.content, cl.Volume):
            return self.content
        return form_image(self.content, grid, imaging, device, f"imaging {self.path.name}")


@dataclass(frozen=True, slots=True)
class ReadOnAccess(Sequence[Any]):
    """What is read of items, one at a time."""

    items: Sequence[Any]
    read: Callable[[Any], Any]

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: Any) -> Any:
        return self.read(self.items[index])


def nothing_to_draw(image: cl.Volume | cl.DepthMap) -> str | None:
    """What an image is that has nothing to see; None for any other."""
    values = np.asarray(image.data if hasattr(image, "data") else image.amplitude)
    if not values.any():
        return "zero everywhere"
    if values.size == 1:
        return f"one voxel, of amplitude {abs(values.item()):.4g}"
    return f"a line of {values.size} voxels" if max(values.shape) == values.size else None


def grid_for(
    capture: cl.Capture,
    options: GridOptions,
    device: cl.Device | str | None = None,
    *,
    everything: bool = False,
) -> cl.VoxelGrid:
    """The grid of the options; else that of `clradar.place_grid`, which is said, and logged."""
    from clradar.imaging.grid_words import lengths_words, place_words
    from clradar.imaging.placement import placement, placement_words

    if given(options, GridOptions):
        return options.grid()
    placed = placement(capture, cl.open_device(device), everything=everything)
    if placed.shown:
        logging.getLogger("clradar").info("%s", placement_words(capture, placed))
        counts = " x ".join(map(str, placed.grid.counts))
        print_line(f"grid: {counts} voxels of {lengths_words(placed.grid.spacing_m)}")
    if placed.left_out:
        more, at_m = len(placed.left_out), placed.left_out[0].position_m
        print_line(f"not in it: {more} more, the strongest at {place_words(at_m)}")
    return placed.grid


def common_grid(
    options: GridOptions, *images: ImageInput, device: cl.Device | None = None
) -> cl.VoxelGrid:
    """The grid of the options; without them that of the first volume, or for the first capture."""
    grids = [image.grid for image in images if image.grid is not None]
    if grids and not given(options):
        return grids[0]
    captures = [image.content for image in images if isinstance(image.content, cl.Capture)]
    if not captures:
        text = "there is no capture to image: all inputs are volumes"
        raise wrong_usage("--x-mm, --y-mm, --z-mm", text)
    return grid_for(captures[0], options, device)


@dataclass(frozen=True, slots=True)
class Measurement:
    """A measured image, what it was formed of, and the radar that simulations of it have."""

    path: Path
    content: Content
    volume: cl.Volume
    radar: dict[str, Any]


def measurement(
    path: Path,
    frames: FrameOptions,
    radar: RadarOptions,
    voxels: GridOptions,
    imaging: ImagingOptions,
    device: cl.Device,
) -> Measurement:
    """Open a measurement, and form its image on the grid of the options if it is a capture."""
    image = ImageInput.open(path, frames)
    known = image.radar_or(radar)
    volume = image.volume(common_grid(voxels, image, device=device), imaging, device)
    return Measurement(path, image.content, volume, known)


def title_of(path: Path, meta: Mapping[str, Any]) -> str:
    """Name what is in a file or folder: of a recording its object, distance, variant and frame."""
    capture = capture_meta(meta)
    name = path.name or path.absolute().name or str(path)
    text = recording_title(meta)
    if not text:
        frame = capture.get("frame")
        return f"{name}, frame {frame}" if isinstance(frame, int) else name
    # A folder or a frame is where the text comes from; another file has a name of its own.
    return text if path.is_dir() or path.suffix == ".npy" else f"{name}: {text}"


def recording_title(meta: Mapping[str, Any]) -> str:
    """Object, distance, variant and frame of a recorded capture; empty for any other."""
    from measurement_io.maroon.folders import DISTANCE_FOLDERS, frame_file

    capture = capture_meta(meta)
    if capture.get("format") != "maroon":
        return ""
    parts: list[str] = []
    if isinstance(source := capture.get("source"), str):
        path = Path(source)
        distance = path.absolute().parents[2] if frame_file(path).folder else path
        parts = [distance.name]
        if distance != path and distance.name in DISTANCE_FOLDERS:
            parts = [distance.parent.name, f"{distance.name} cm"]
    if variant := capture.get("variant"):
        parts.append(str(variant))
    if isinstance(frame := capture.get("frame"), int):
        parts.append(f"frame {frame}")
    return ", ".join(parts)
