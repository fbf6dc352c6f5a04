"""Captures and volumes that commands read, their titles, images, figures and comparison."""

from __future__ import annotations

import csv
import io
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
import measurement_io
from clradar.cli import console, options as opt, outputs as out
from clradar.compare.metrics import METRIC_TABLE
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import warn
from clradar.files.atomic import write_file
from clradar.model.volume import capture_meta

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Content = cl.Volume | cl.Capture


def open_image(path: Path, frames: opt.FrameOptions | None = None) -> Content:
    """A volume, or a capture to be imaged; a frame can be chosen of a recording only."""
    from measurement_io.opening import kind_of

    frames = frames or opt.FrameOptions()
    if frames == opt.FrameOptions() and kind_of(path) == "volume":
        return measurement_io.open_volume(path)
    return opt.open_frame(path, frames)


def form_image(
    content: Content, grid: cl.VoxelGrid, imaging: opt.ImagingOptions, device: Any
) -> cl.Volume:
    """A volume as it is, or the image of a capture, with a progress bar on a terminal."""
    if isinstance(content, cl.Volume):
        return content
    form = cl.reconstruct if imaging.iterated else cl.backproject
    with console.bar("imaging") as progress:
        return form(content, grid, device=device, progress=progress, **imaging.arguments)


def radar_of(path: Path, content: Content, options: opt.RadarOptions) -> dict[str, Any]:
    """`array` and `waveform` of a capture; of a volume, which has none, of the options."""
    if isinstance(content, cl.Volume):
        return {"array": options.antennas(), "waveform": options.waveform()}
    if known := opt.given(options):
        text = f"{path} is a capture and has its antennas and frequencies"
        raise opt.wrong_usage(", ".join(known), text)
    return {"array": content.array, "waveform": content.waveform}


class ReadOnAccess(Sequence[Any]):
    """What is read of items, one at a time; of frames, by their numbers, with their time stamps."""

    def __init__(
        self, items: Sequence[Any], read: Callable[[Any], Any], times_us: Sequence[Any] = ()
    ) -> None:
        self.frame_numbers, self.read, self.time_us = items, read, times_us.__getitem__

    def __len__(self) -> int:
        return len(self.frame_numbers)

    def __getitem__(self, index: Any) -> Any:
        return self.read(self.frame_numbers[index])


def rms_db(capture: cl.Capture) -> float | None:
    """The level of the samples; None where all are zero."""
    power = float(np.mean(np.abs(capture.data) ** 2, dtype=np.float64))
    return 10 * math.log10(power) if power > 0 else None


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
    options: opt.GridOptions,
    device: cl.Device | str | None = None,
    *,
    everything: bool = False,
) -> cl.VoxelGrid:
    """The grid of the options; else that of `clradar.place_grid`, which is said, and logged."""
    from clradar.imaging.grid_words import lengths_words, place_words
    from clradar.imaging.placement import placement, placement_words

    if opt.given(options, opt.GridOptions):
        return options.grid()
    placed = placement(capture, cl.open_device(device), everything=everything)
    if placed.shown:
        logging.getLogger("clradar").info("%s", placement_words(capture, placed))
        counts = " x ".join(map(str, placed.grid.counts))
        console.line(f"grid: {counts} voxels of {lengths_words(placed.grid.spacing_m)}")
    if placed.left_out:
        more, at_m = len(placed.left_out), placed.left_out[0].position_m
        console.line(f"not in it: {more} more, the strongest at {place_words(at_m)}")
    return placed.grid


def imaged(
    contents: Sequence[Content], voxels: opt.GridOptions, imaging: opt.ImagingOptions, device: Any
) -> list[cl.Volume]:
    """Images on one grid: of the options, else of the first volume, else for the first capture."""
    volumes = [one for one in contents if isinstance(one, cl.Volume)]
    captures = [one for one in contents if isinstance(one, cl.Capture)]
    if volumes and not opt.given(voxels):
        grid = volumes[0].grid
    elif captures:
        grid = grid_for(captures[0], voxels, device)
    else:
        text = "there is no capture to image: all inputs are volumes"
        raise opt.wrong_usage("--x-mm, --y-mm, --z-mm", text)
    return [form_image(one, grid, imaging, device) for one in contents]


class Measurement:
    """A measured image, what it was formed of, and the radar that simulations of it have."""

    def __init__(
        self,
        path: Path,
        frames: opt.FrameOptions,
        radar: opt.RadarOptions,
        voxels: opt.GridOptions,
        imaging: opt.ImagingOptions,
        device: cl.Device,
    ) -> None:
        self.path, self.content = path, open_image(path, frames)
        self.radar = radar_of(path, self.content, radar)
        (self.volume,) = imaged([self.content], voxels, imaging, device)


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


SIMULATION_FILES = ("placed.ply", "capture.h5", "volume.h5", "comparison.png", "metrics.json")
"""What is written of a mesh or a hand that was fitted and simulated."""


def simulated_surface(meta: Mapping[str, Any]) -> str | None:
    """What was simulated: the one alpha, or the materials if physical; None if there is neither."""
    scene = capture_meta(meta).get("scene")
    if not isinstance(scene, Mapping):
        return None
    materials = scene.get("materials")  # of the physical estimator, which does not use alpha
    if isinstance(materials, Sequence):
        names = [m.get("name") for m in materials if isinstance(m, Mapping)]
        return " and ".join(str(name) for name in names) or None
    low, high = scene.get("alpha_min"), scene.get("alpha_max")
    if not isinstance(low, int | float) or low != high:
        return None
    return f"\N{GREEK SMALL LETTER ALPHA} = {low:.3g}"


def figure_labels(paths: Sequence[Path], metas: Sequence[Mapping[str, Any]]) -> list[str]:
    """A short label for each image: its surface if no other image has it, else its name."""
    surfaces = [simulated_surface(meta) for meta in metas]
    labels = []
    for path, surface, meta in zip(paths, surfaces, metas, strict=True):
        if surface is None or surfaces.count(surface) > 1:
            surface = title_of(path, meta) if path.is_dir() else path.stem or str(path)
        labels.append(surface)
    # Files of the same name in different folders: the whole path tells them apart.
    named = zip(paths, labels, strict=True)
    return [str(path) if labels.count(label) > 1 else label for path, label in named]


class Comparison:
    """The first image compared with each of the labelled ones after it."""

    def __init__(
        self, images: Sequence[cl.Volume], labels: Sequence[str], range_db: float = DYNAMIC_RANGE_DB
    ) -> None:
        self.labels, self.range_db = labels, range_db
        self.maps = [image.depth_map(range_db) for image in images]
        compared = partial(cl.compare, self.maps[0], dynamic_range_db=range_db)
        self.metrics = list(map(compared, self.maps[1:]))

    def print(self) -> None:
        """Print one row of metrics per simulated image, and what they do not show."""
        labelled = list(zip(self.labels, self.metrics, strict=True))
        names = [one.name for one in METRIC_TABLE]
        rows = [[label, *(one.text(found) for one in METRIC_TABLE)] for label, found in labelled]
        console.table(("simulated", *names), rows, right=names)
        for label, found in labelled:
            for remark in found.remarks:
                console.line(f"{label}: {remark}")

    def figure(self, **options: Any) -> Figure:
        """All images side by side; `options` as in `clradar.plot.comparison_figure`."""
        columns = list(zip(self.labels, self.maps[1:], strict=True))
        return cl.plot.comparison_figure(
            self.maps[0], columns, metrics=self.metrics, dynamic_range_db=self.range_db, **options
        )  # fmt: skip

    def records(self, paths: Sequence[Path]) -> list[dict[str, Any]]:
        """One JSON object for each simulated image, which is in the file of the same position."""
        return [
            {"file": str(path), "label": label, "metrics": found.to_dict()}
            for path, label, found in zip(paths, self.labels, self.metrics, strict=True)
        ]


def write_simulation(
    folder: Path,
    measured: Path,
    simulated: tuple[cl.Scene, cl.Capture, cl.Volume],
    compared: Comparison,
    metrics: Mapping[str, Any],
    **more: Any,
) -> None:
    """Write a placed mesh, its simulation, and both compared with the measurement."""
    contents = (
        *simulated, partial(compared.figure, differences=True),
        {"measured": str(measured), **metrics},
    )  # fmt: skip
    for name, content in zip(SIMULATION_FILES, contents, strict=True):
        out.write(folder / name, content, **more)
    compared.print()


def figure_of(
    path: Path, *, view: str | None = None, plane: tuple[str, float | None] | None = None
) -> Figure | None:
    """The image of a volume in a `view` or a `plane` (axis, m); echoes, or gains, of the others.

    None, and a warning, where there is nothing to see.
    """
    found = measurement_io.open(path)
    if isinstance(found, cl.Volume):
        if (reason := nothing_to_draw(found)) is not None:
            warn(f"{path}: not drawn, since the image is {reason}")
            return None
        return volume_figure(found, title_of(path, found.meta), plane, view=view)
    for name, value in {"--view": view, "--slice": plane}.items():
        if value is not None:
            raise opt.wrong_usage(name, f"expected with a volume, which {path} is not")
    if isinstance(found, measurement_io.Recording):
        title = title_of(path, {})
        with console.bar("reading") as progress:
            return cl.plot.recording_figure(found, found.frame_numbers, title, progress=progress)
    if isinstance(found, cl.ChannelCalibration):
        from calibration.channels.figure import channels_figure

        return channels_figure(found, title_of(path, found.meta))
    return cl.plot.capture_figure(found, title_of(path, found.meta))


def volume_figure(
    image: cl.Volume | cl.DepthMap,
    title: str,
    plane: tuple[str, float | None] | None,
    **shown: Any,
) -> Figure:
    """The figure of an image, or of one plane of a volume."""
    if plane is not None and isinstance(image, cl.Volume):
        image = cl.plot.plane_of(image, *plane)
    return cl.plot.image_figure(image, title, **shown)


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    write_file(path, text.getvalue().encode(), force=True)
