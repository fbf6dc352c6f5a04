"""``clradar compare --frames``: recordings compared frame by frame, with a time line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.comparison import figure_labels, print_metrics
from clradar.cli.console import print_line, progress_bar
from clradar.cli.frame_sources import Frames
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.options.imaging import GridOptions, ImagingOptions
from clradar.cli.options.sequence import chosen_frames
from clradar.cli.options.values import wrong_usage

if TYPE_CHECKING:
    from clradar import Device, Volume, VoxelGrid
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


def compare_frames(
    sources: Sequence[Frames],
    numbers: Sequence[int],
    voxels: GridOptions,
    imaging: ImagingOptions,
    dynamic_range_db: float,
    device: Device,
) -> tuple[FrameSeries, VoxelGrid]:
    """Image and compare frame by frame, all on one grid: that of the options, or of the first."""
    from clradar import Capture, backproject
    from clradar.report import FrameSeries

    first = [ImageInput(source.path, source.read(numbers[0])) for source in sources]
    grid = common_grid(voxels, *first, device=device)
    # A recording has its name, and not that of a frame.
    metas = [
        {} if source.numbers else one.content.meta
        for source, one in zip(sources[1:], first[1:], strict=True)
    ]
    labels = ["Measurement", *figure_labels([source.path for source in sources[1:]], metas)]
    series = FrameSeries(labels, dynamic_range_db)
    kept: dict[Path, Volume] = {}  # of what is the same at every frame

    def image(source: Frames, number: int) -> Volume:
        if source.path in kept:
            return kept[source.path]
        found = source.read(number)
        if isinstance(found, Capture):
            found = backproject(found, grid, device=device, **imaging.arguments)
        if source.numbers is None:
            kept[source.path] = found
        return found

    with progress_bar("comparing frames") as progress:
        for done, number in enumerate(numbers, start=1):
            series.add(f"frame {number}", [image(source, number) for source in sources])
            if progress is not None:
                progress(done, len(numbers))
    return series, grid


def print_series(series: FrameSeries) -> None:
    """Print the mean of every metric over the frames, one row for each simulation."""
    count = len(series.labels) - 1
    print_metrics(series.labels[1:], [series.mean_metrics(i) for i in range(count)])
    gaps = sum(None in found for found in series.metrics)
    without = f"; {gaps} without an image" if gaps else ""
    print_line(f"mean of {len(series.names)} frames{without}")


def frame_records(
    series: FrameSeries, numbers: Sequence[int], simulated: Sequence[Path]
) -> list[dict[str, Any]]:
    """One JSON object for each simulation: its metrics at every frame, and their means."""
    return [
        {
            "file": str(path),
            "label": label,
            "mean": series.mean_metrics(i).to_dict(),
            "frames": [
                {"frame": number, "metrics": None if found is None else found.to_dict()}
                for number, found in zip(numbers, (m[i] for m in series.metrics), strict=True)
            ],
        }
        for i, (path, label) in enumerate(zip(simulated, series.labels[1:], strict=True))
    ]
