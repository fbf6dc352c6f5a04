"""What files hold, and how alike they are: ``inspect``, ``view``, ``compare``."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path

import typer

import clradar as cl
import measurement_io
from clradar.cli import console, images as img, options as opt, outputs as out
from clradar.errors import MeasurementError
from clradar.jobs import open_devices


def inspect_command(
    file: Path = opt.argument(
        "Capture, volume, recorded .npy frame, radar folder or the one that holds it, or data set.",
    ),
    *,
    check: bool = opt.option("Read and verify everything; exit status 1 if damaged.", False),
    as_json: bool = opt.JSON,
    png: Path | None = opt.figure(
        "Also draw it, of a capture echoes and the level of every pair, of a data set 64 samples",
        "--png",
        "-o",
        without="--check --json",
    ),
    picture: opt.PictureOptions,
) -> None:
    """Reads, and changes nothing. Nothing is imaged again for the picture."""
    from clradar.dataset.folder import check_dataset, describe_dataset, is_dataset

    dataset = is_dataset(file)
    if dataset and (given := opt.given(picture)):
        raise opt.wrong_usage(", ".join(given), f"expected with a volume, which {file} is not")
    if check:
        with console.bar("checking") as progress:
            verify = check_dataset if dataset else measurement_io.check_file
            report = verify(file, progress=progress)
        record = {**asdict(report), "ok": report.ok}
        console.text(json.dumps(record, indent=2) if as_json else str(report))
        if not report.ok:
            console.error(f"{file}: {console.counted(len(report.problems), 'problem')} found")
            raise typer.Exit(1)
        return
    try:
        found = describe_dataset(file) if dataset else measurement_io.describe(file)
    except MeasurementError as error:
        if dataset or not file.is_dir():
            raise
        raise MeasurementError(
            f"{error}; nor is it a data set, which has manifest.json and shards"
        ) from error
    console.text(json.dumps(found.to_dict(), indent=2, allow_nan=False) if as_json else str(found))
    if png is not None and dataset:
        from clradar.dataset.contact_sheet import contact_sheet

        out.write(png, partial(contact_sheet, file), "up to 64 of its samples")
    elif png is not None:
        figure = img.figure_of(file, view=picture.view, plane=picture.slice)
        out.write(None if figure is None else png, figure, "the picture")


def view_command(
    path: Path = opt.argument(
        "Recording, data set, capture, recorded .npy frame, volume, or a folder of these files.",
    ),
    *,
    watch: bool = opt.option(
        "PATH is being written: it may be empty yet, and the newest comes first.",
        False,
        without="--html",
    ),
    variant: opt.Variant = opt.option("Variant of a recording's frames.", "raw"),
    html: Path | None = opt.page(
        "Write scene and time line of all frames into this .html file, and serve nothing."
    ),
    port: int = opt.option(
        "Port at 127.0.0.1, or the next free one; 0: any free one.", 8080, min=0, max=65535
    ),
    simulated: list[Path] | None = opt.option(
        "Capture, volume or recording to show in a second colour; may be repeated.",
        metavar="SIMULATED",
    ),
    mesh: Path | None = opt.option(
        "Draw this mesh, and without --simulated simulate it for the radar of PATH.",
        metavar="MESH",
    ),
    place: opt.PlacementOptions,
    depth: opt.DepthMapOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Serves a page at 127.0.0.1 until Ctrl-C, and prints its address. Needs viser: pip install
    viser. Captures are imaged as `clradar image` does, with larger voxels at first.
    """
    from clradar.view import beside
    from clradar.view.server import serve, write_page
    from clradar.view.session import View
    from clradar.view.sources import open_source
    from clradar.view.wish import Wish

    opened = open_devices(device).first
    scene = None
    if mesh is not None:  # one that cannot be read should not cost an image first
        scene = cl.Scene.from_mesh(mesh, unit=place.unit, transform=place.matrix())
    source = open_source(path, variant, watch=watch)
    second: beside.Beside | None = None
    if simulated:
        second = beside.recorded(source, [open_source(other) for other in simulated])
    elif scene is not None:
        second = beside.simulated(scene, opened)
    wish = Wish(dynamic_range_db=depth.dynamic_range_db)
    view = View(source=source, wish=wish, beside=second, mesh=scene, device=opened)
    if html is None:
        serve(view, port, console.line)
        return
    count = write_page(view, html, force=opt.call.force, warn=console.warning)
    console.line(f"{html}: {console.counted(count, 'frame')}, for any browser")


def compare_command(
    *,
    measured: Path = opt.argument("Volume or capture."),
    simulated: list[Path] = opt.argument("Volumes or captures."),
    output: Path | None = opt.figure("Figure", "-o", "--output"),
    json: Path | None = opt.written("File for the metrics, in metres."),
    report: Path | None = opt.page("Page (.html): figure, 3-D view, metrics and settings."),
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    depth: opt.DepthMapOptions,
    frames: opt.FrameOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Captures are imaged first: on the grid of the options, else that of the first volume, else
    around the echoes of MEASURED, whose --frame and --variant are. Metrics: docs/metrics.md.
    """
    images = [img.open_image(measured, frames), *map(img.open_image, simulated)]
    imaged = all(isinstance(image, cl.Volume) for image in images)
    opened = None if imaged else open_devices(device).first
    volumes = img.imaged(images, voxels, imaging, opened)
    labels = img.figure_labels(simulated, [volume.meta for volume in volumes[1:]])
    if measured.is_dir() and frames.frame is None and any(path.is_dir() for path in simulated):
        console.line("the first frames are compared; `clradar process` compares every one")
    compared = img.Comparison(volumes, labels, depth.dynamic_range_db)
    compared.print()
    recording = img.recording_title(volumes[0].meta)
    label = f"Measurement: {recording}" if recording else "Measurement"
    figure = partial(compared.figure, differences=True, measured_label=label)
    out.write(output, figure, f"the measurement and {len(simulated)} simulated")
    text = opt.grid_text(volumes[0].grid)
    record = {"measured": str(measured), "simulated": compared.records(simulated)}
    out.write(json, record, "the metrics, in metres", grid=text)

    def page() -> str:
        named = zip((label, *labels), volumes, (measured, *simulated), strict=True)
        shown = [cl.report.ReportImage(name, volume, str(path)) for name, volume, path in named]
        return cl.report.html_report(
            shown[0], shown[1:], metrics=compared.metrics, settings=out.provenance(grid=text),
            dynamic_range_db=depth.dynamic_range_db,
        )  # fmt: skip

    out.write(report, page, "the comparison as a page, to be opened in a browser")
