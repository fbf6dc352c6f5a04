"""``clradar compare``: compare simulated images with a measured one, in numbers and in a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clradar.cli.comparison import Comparison, figure_labels
from clradar.cli.console import print_line, progress_bar
from clradar.cli.inputs import ImageInput, common_grid, recording_title
from clradar.cli.options.common import DEVICE, FORCE
from clradar.cli.options.groups import REQUIRED, argument, option, output_option, wrong_usage
from clradar.cli.options.measured import (
    DepthMapOptions,
    FrameOptions,
    GridOptions,
    ImagingOptions,
    grid_text,
)
from clradar.cli.outputs import PAGES, check_figure, check_outputs, check_suffix, provenance
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json


@dataclass(frozen=True, kw_only=True)
class ComparisonFiles:
    """Files of a comparison, none of which has to be written."""

    output: Path | None = output_option("Figure to write: .png, .pdf or .svg.", None, "--figure")
    json: Path | None = option("File for the metrics, in metres.")
    report: Path | None = option(
        "Page to write: figure, 3-D view, metrics and settings in one .html file."
    )

    def check(self, *, force: bool, inputs: Sequence[Path]) -> None:
        """Raise unless all of them may be written."""
        check_figure(self.output)
        check_suffix(self.report, PAGES)
        check_outputs([self.output, self.json, self.report], force=force, inputs=inputs)


def command(
    *,
    measured: Path = argument("Volume or capture.", REQUIRED, metavar="MEASURED"),
    simulated: list[Path] = argument("Volumes or captures.", REQUIRED, metavar="SIMULATED"),
    files: ComparisonFiles,
    voxels: GridOptions,
    imaging: ImagingOptions,
    depth: DepthMapOptions,
    frames: FrameOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
) -> None:
    """Captures are imaged first: on the grid of the options, else that of the first volume, else
    around the echoes of MEASURED, whose --frame and --variant are. Metrics: docs/metrics.md.
    """
    from clradar.jobs import open_devices
    from clradar.report import ReportImage, html_report

    voxels.grid()  # wrong usage is reported before a file is read
    files.check(force=force, inputs=[measured, *simulated])
    images = [ImageInput.open(measured, frames), *map(ImageInput.open, simulated)]
    if all(image.grid is not None for image in images) and voxels.given:
        raise wrong_usage(
            "--x-mm, --y-mm, --z-mm", "there is no capture to image: all inputs are volumes"
        )
    opened = None if all(image.grid is not None for image in images) else open_devices(device).first
    grid = common_grid(voxels, *images, device=opened)
    volumes = [image.volume(grid, imaging, opened) for image in images]
    labels = figure_labels(simulated, [volume.meta for volume in volumes[1:]])
    if measured.is_dir() and frames.frame is None and any(path.is_dir() for path in simulated):
        print_line("the first frames are compared; `clradar process` compares every one")
    compared = Comparison.of(volumes, labels, depth.dynamic_range_db)
    compared.print()
    recording = recording_title(volumes[0].meta)
    measured_label = f"Measurement: {recording}" if recording else "Measurement"
    if files.output is not None:
        compared.save_figure(
            files.output, force=force, differences=True, measured_label=measured_label
        )
        print_line(f"{files.output}: the measurement and {len(simulated)} simulated")
    if files.json is None and files.report is None:
        return
    inputs = [file for image in images for file in image.files]
    origin = provenance("compare", inputs, imaging, frames, grid=grid_text(grid))
    if files.json is not None:
        record = {"measured": str(measured), "simulated": compared.records(simulated), **origin}
        write_json(files.json, record, force=force)
        print_line(f"{files.json}: the metrics, in metres")
    if files.report is not None:
        named = zip((measured_label, *labels), volumes, (measured, *simulated), strict=True)
        shown = [ReportImage(label, volume, str(path)) for label, volume, path in named]
        with progress_bar("writing the page"):
            page = html_report(
                shown[0], shown[1:], metrics=compared.metrics, settings=origin,
                dynamic_range_db=depth.dynamic_range_db,
            )  # fmt: skip
        write_file(files.report, page.encode("utf-8"), force=force)
        print_line(f"{files.report}: the comparison as a page, to be opened in a browser")
