"""``clradar compare --frames``: recordings compared frame by frame, with a time line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.comparison import figure_labels, print_metrics
from clradar.cli.console import print_line, progress_bar
from clradar.cli.frame_sources import Frames
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.options.sequence import chosen_frames
from clradar.cli.options.values import wrong_usage
from clradar.errors import CompareError

if TYPE_CHECKING:
    from clradar import DepthMap, Device, Volume, VoxelGrid
    from clradar.model.progress import Progress
    from clradar.opencl import Devices
    from clradar.report import FrameSeries


def open_frames(
    text: str, measured: Path, simulated: Sequence[Path], variant: str | None
) -> tuple[list[Frames], list[int]]:
    """The measurement and the simulations, and the frames that are compared."""
    from clradar.report.frames import check_count

    sources = [Frames.open(measured, variant), *map(Frames.open, simulated)]
    there = sources[0].numbers
    if there is None:
        raise wrong_usage("--frames", "expected a recording, or a folder of .h5 files, as MEASURED")
    numbers = chosen_frames(text, there)
    check_count(len(numbers))
    for source in sources[1:]:
        source.check_frames(numbers, measured)
    return sources, numbers


@dataclass(frozen=True, slots=True, eq=False)
class _FrameImages:
    """Makes the images of a frame on a device, and says on which."""

    sources: Sequence[Frames]
    grid: VoxelGrid
    arguments: Mapping[str, Any]
    dynamic_range_db: float
    kept: dict[Path, Volume | DepthMap] = field(default_factory=dict)
    """Of what is the same at every frame."""

    def __call__(
        self, number: int, device: Device, progress: Progress
    ) -> list[tuple[list[Volume | DepthMap], str]]:
        images = [self.image(source, number, device) for source in self.sources]
        return [(images, device.info.label)]

    def image(self, source: Frames, number: int, device: Device) -> Volume | DepthMap:
        """The depth map of a frame, or the image where it has none."""
        from clradar import Capture, backproject
        from clradar.compare import depth_map_of

        if source.path in self.kept:
            return self.kept[source.path]
        found = source.read(number)
        if isinstance(found, Capture):
            found = backproject(found, self.grid, device=device, **self.arguments)
        try:
            seen: Volume | DepthMap = depth_map_of(found, self.dynamic_range_db, "image")
        except CompareError:
            seen = found
        if source.numbers is None:
            self.kept[source.path] = seen
        return seen


def compare_frames(
    sources: Sequence[Frames],
    numbers: Sequence[int],
    voxels: GridOptions,
    imaging: ImagingOptions,
    dynamic_range_db: float,
    devices: Devices,
) -> tuple[FrameSeries, VoxelGrid, list[str]]:
    """Image and compare frame by frame, all on one grid: that of the options, or of the first.

    Also returns the device of each frame.
    """
    from clradar.report import FrameSeries

    first = [ImageInput(source.path, source.read(numbers[0])) for source in sources]
    grid = common_grid(voxels, *first, device=devices.first)
    # A recording has its name, and not that of a frame.
    metas = [
        {} if source.numbers else one.content.meta
        for source, one in zip(sources[1:], first[1:], strict=True)
    ]
    labels = ["Measurement", *figure_labels([source.path for source in sources[1:]], metas)]
    series = FrameSeries(labels, dynamic_range_db)
    work = _FrameImages(sources, grid, imaging.arguments, dynamic_range_db)
    made_on = []
    with progress_bar("comparing frames") as progress:
        found = devices.in_order(work, numbers, progress)
        for number, (images, label) in zip(numbers, found, strict=True):
            series.add(f"frame {number}", images)
            made_on.append(label)
    return series, grid, made_on


def print_series(series: FrameSeries) -> None:
    """Print the mean of every metric over the frames, one row for each simulation."""
    count = len(series.labels) - 1
    print_metrics(series.labels[1:], [series.mean_metrics(i) for i in range(count)])
    gaps = sum(None in found for found in series.metrics)
    without = f"; {gaps} without an image" if gaps else ""
    print_line(f"mean of {len(series.names)} frames{without}")


def frame_records(
    series: FrameSeries, numbers: Sequence[int], simulated: Sequence[Path], made_on: Sequence[str]
) -> list[dict[str, Any]]:
    """One JSON object for each simulation: metrics and device of every frame, and the means."""
    return [
        {
            "file": str(path),
            "label": label,
            "mean": series.mean_metrics(i).to_dict(),
            "frames": [
                {"frame": n, "metrics": None if found is None else found.to_dict(), "device": label}
                for n, found, label in zip(
                    numbers, (m[i] for m in series.metrics), made_on, strict=True
                )
            ],
        }
        for i, (path, label) in enumerate(zip(simulated, series.labels[1:], strict=True))
    ]
