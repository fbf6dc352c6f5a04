"""``clradar compare``: compare simulated images with a measured one, in numbers and in a figure."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from clradar.cli import options as opt, parse
from clradar.cli.comparison import Comparison, figure_labels
from clradar.cli.console import print_line
from clradar.cli.inputs import ImageInput, common_grid, recording_title
from clradar.cli.outputs import provenance, write
from clradar.jobs import open_devices


def command(
    *,
    measured: Path = opt.argument("Volume or capture."),
    simulated: list[Path] = opt.argument("Volumes or captures."),
    output: Path | None = opt.output_option(
        "Figure to write: .png, .pdf or .svg.", None, "--figure", check=parse.figure
    ),
    json: Path | None = opt.written("File for the metrics, in metres."),
    report: Path | None = opt.written(
        "Page to write: figure, 3-D view, metrics and settings in one .html file.",
        check=parse.page,
    ),
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Captures are imaged first: on the grid of the options, else that of the first volume, else
    around the echoes of MEASURED, whose --frame and --variant are. Metrics: docs/metrics.md.
    """
    images = [ImageInput.open(measured, frames), *map(ImageInput.open, simulated)]
    imaged = all(image.grid is not None for image in images)
    opened = None if imaged else open_devices(device).first
    grid = common_grid(voxels, *images, device=opened)
    volumes = [image.volume(grid, imaging, opened) for image in images]
    labels = figure_labels(simulated, [volume.meta for volume in volumes[1:]])
    if measured.is_dir() and frames.frame is None and any(path.is_dir() for path in simulated):
        print_line("the first frames are compared; `clradar process` compares every one")
    compared = Comparison.of(volumes, labels, depth.dynamic_range_db)
    compared.print()
    recording = recording_title(volumes[0].meta)
    label = f"Measurement: {recording}" if recording else "Measurement"
    figure = partial(compared.figure, differences=True, measured_label=label)
    write(output, figure, f"the measurement and {len(simulated)} simulated")
    text = opt.grid_text(grid)
    record = {"measured": str(measured), "simulated": compared.records(simulated)}
    write(json, record, "the metrics, in metres", grid=text)

    def page() -> str:
        from clradar.report import ReportImage, html_report

        named = zip((label, *labels), volumes, (measured, *simulated), strict=True)
        shown = [ReportImage(name, volume, str(path)) for name, volume, path in named]
        return html_report(
            shown[0], shown[1:], metrics=compared.metrics, settings=provenance(grid=text),
            dynamic_range_db=depth.dynamic_range_db,
        )  # fmt: skip

    write(report, page, "the comparison as a page, to be opened in a browser")
