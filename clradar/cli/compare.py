"""``clradar compare``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.image import check_figure_name
from clradar.cli.images import form_image, labels_of, open_image, recording_files
from clradar.cli.options import (
    DEFAULT_DYNAMIC_RANGE_DB,
    DeviceOption,
    DynamicRangeOption,
    ForceOption,
    FrameOption,
    Method,
    MethodOption,
    VariantOption,
    Window,
    WindowOption,
    XOption,
    YOption,
    ZOption,
    grid_text,
    voxel_grid,
    wrong_usage,
)
from clradar.cli.output import check_outputs, print_line, print_table, write_bytes, write_json
from clradar.cli.provenance import provenance
from clradar.errors import OutputError

if TYPE_CHECKING:
    from clradar import Metrics, Volume

REPORT_SUFFIXES = (".html", ".htm")

METRIC_COLUMNS = (
    "simulated",
    "overlap",
    "dB correlation",
    "SSIM",
    "mask IoU",
    "depth RMSE (mm)",
    "Chamfer sim. to meas. (mm)",
    "Chamfer meas. to sim. (mm)",
)


def command(
    measured: Annotated[Path, typer.Argument(metavar="MEASURED", help="Volume or capture.")],
    simulated: Annotated[
        list[Path], typer.Argument(metavar="SIMULATED", help="Volumes or captures.")
    ],
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", help="Figure to write: .png, .pdf or .svg."),
    ] = None,
    json: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--json", help="File for the metrics, in metres."),
    ] = None,
    report: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--report",
            help="Page to write: figure, 3-D view, metrics and settings in one .html file.",
        ),
    ] = None,
    x_mm: XOption = None,
    y_mm: YOption = None,
    z_mm: ZOption = None,
    method: MethodOption = Method.fast,
    window: WindowOption = Window.rect,
    dynamic_range_db: DynamicRangeOption = DEFAULT_DYNAMIC_RANGE_DB,
    frame: FrameOption = None,
    variant: VariantOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Captures are imaged first: on the grid of the options, or without them on that of the first
    volume that is given, or without volumes on the paper's. --frame and --variant are those of
    MEASURED, where it is a recording. The metrics are defined in docs/metrics.md.
    """
    from clradar import Volume, compare, open_device
    from clradar.model import checks
    from clradar.plot import comparison_figure, save_figure
    from clradar.report import ReportImage, html_report

    checks.positive("--dynamic-range-db", dynamic_range_db)
    grid = voxel_grid(x_mm, y_mm, z_mm)
    paths = [measured, *simulated]
    if output is not None:
        check_figure_name(output)
    if report is not None:
        check_report_name(report)
    check_outputs([output, json, report], force=force, inputs=paths)
    chosen = None if variant is None else variant.value
    recorded = open_image(measured, frame=frame, variant=chosen)
    loaded = [recorded, *(open_image(path) for path in simulated)]
    if all(isinstance(item, Volume) for item in loaded) and any((x_mm, y_mm, z_mm)):
        raise wrong_usage(
            "--x-mm, --y-mm, --z-mm", "there is no capture to image: all inputs are volumes"
        )
    given = next((item.grid for item in loaded if isinstance(item, Volume)), None)
    if given is not None and x_mm is None and y_mm is None and z_mm is None:
        grid = given
    volumes: list[Volume] = []
    for path, item in zip(paths, loaded, strict=True):
        if not isinstance(item, Volume):
            opened = open_device(device)
            item = form_image(
                item, grid, method.value, window.value, opened, f"imaging {path.name}"
            )
        volumes.append(item)
    labels = labels_of(simulated, [volume.meta for volume in volumes[1:]])
    maps = [volume.depth_map(dynamic_range_db) for volume in volumes]
    metrics = [compare(maps[0], m, dynamic_range_db=dynamic_range_db) for m in maps[1:]]
    print_metrics(labels, metrics)
    if output is not None:
        figure = comparison_figure(
            maps[0],
            list(zip(labels, maps[1:], strict=True)),
            metrics=metrics,
            dynamic_range_db=dynamic_range_db,
        )
        save_figure(figure, output, force=force)
        print_line(f"{output}: the measurement and {len(metrics)} simulated")
    if json is None and report is None:
        return
    files = [f for p, i in zip(paths, loaded, strict=True) for f in recording_files(p, i.meta)]
    options = {
        "method": method.value,
        "window": window.value,
        "grid": grid_text(grid),
        "frame": frame,
        "variant": chosen,
    }
    origin = provenance("compare", options, files)
    if json is not None:
        record = {
            "measured": str(measured),
            "simulated": metrics_records(simulated, labels, metrics),
            **origin,
        }
        write_json(json, record, force=force)
        print_line(f"{json}: the metrics, in metres")
    if report is not None:
        named = zip(("Measurement", *labels), volumes, paths, strict=True)
        images = [ReportImage(label, volume, str(path)) for label, volume, path in named]
        page = html_report(
            images[0],
            images[1:],
            metrics=metrics,
            settings=origin,
            dynamic_range_db=dynamic_range_db,
        )
        write_bytes(report, page.encode("utf-8"), force=force)
        print_line(f"{report}: the comparison as a page, to be opened in a browser")


def check_report_name(path: Path) -> None:
    """Raise unless the name says that it is a page: a browser goes by it."""
    if path.suffix.lower() not in REPORT_SUFFIXES:
        raise OutputError(
            f"{path}: expected a name that ends in {' or '.join(REPORT_SUFFIXES)}, "
            f"got '{path.suffix}'"
        )


def print_metrics(labels: Sequence[str], metrics: Sequence[Metrics]) -> None:
    """Print one row of metrics per simulated image."""
    rows = []
    for label, m in zip(labels, metrics, strict=True):
        lengths_m = (
            m.depth_rmse_m,
            m.chamfer_simulated_to_measured_m,
            m.chamfer_measured_to_simulated_m,
        )
        shares = (m.overlap, m.db_correlation, m.ssim, m.mask_iou)
        rows.append(
            [label]
            + [_number(value, 3) for value in shares]
            + [_number(1e3 * value, 2) for value in lengths_m]
        )
    print_table(METRIC_COLUMNS, rows, right=METRIC_COLUMNS[1:])


def _number(value: float, digits: int) -> str:
    return "n/a" if math.isnan(value) else f"{value:.{digits}f}"


def metrics_records(
    paths: Sequence[Path], labels: Sequence[str], metrics: Sequence[Metrics]
) -> list[dict[str, Any]]:
    """Return what the JSON file says about each simulated image."""
    return [
        {"file": str(path), "label": label, "metrics": m.to_dict()}
        for path, label, m in zip(paths, labels, metrics, strict=True)
    ]
