"""``clradar align``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from clradar.cli.images import formed, open_image, recording_files
from clradar.cli.options import (
    DeviceOption,
    ForceOption,
    FrameOption,
    Method,
    MethodOption,
    SearchOption,
    Unit,
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
from clradar.cli.output import (
    check_outputs,
    print_line,
    print_text,
    print_warning,
    progress_bar,
    write_json,
)
from clradar.cli.provenance import provenance


def command(
    measured: Annotated[
        Path, typer.Argument(metavar="MEASURED", help="Volume, capture or recording.")
    ],
    simulated: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Argument(metavar="[SIMULATED]", help="Volume or capture; not with --mesh."),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", help="JSON file for transform and report.  [required]"),
    ] = None,
    mesh: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--mesh", metavar="MESH", help="Align this mesh instead of an image."),
    ] = None,
    unit: Annotated[Unit, typer.Option("--unit", help="Unit of the mesh file.")] = Unit.m,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Without the simulations that correct the bias of a mesh: up to some millimetres "
            "off where it is specular.",
        ),
    ] = False,
    search_deg: SearchOption = 45.0,
    dynamic_range_db: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--dynamic-range-db",
            metavar="DB",
            help="Depth points are this far below the maximum at most. [default: 15; mesh: 20]",
        ),
    ] = None,
    x_mm: XOption = None,
    y_mm: YOption = None,
    z_mm: ZOption = None,
    method: MethodOption = Method.fast,
    window: WindowOption = Window.rect,
    frame: FrameOption = None,
    variant: VariantOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """The 4 x 4 matrix in the JSON file, "transform", moves the simulated object, or the mesh, onto
    the measured one: `clradar simulate --transform` takes the file. Captures are imaged first, on
    the grid of the options. --frame and --variant are those of MEASURED. Mesh against measurement
    is the more exact of the two: see docs/calibration.md.
    """
    from calibration import align, align_mesh
    from clradar import Capture, Scene, Volume, open_device
    from clradar.model import checks

    if output is None:
        raise wrong_usage("-o", "expected a JSON file to write")
    if (simulated is None) == (mesh is None):
        raise wrong_usage("SIMULATED, --mesh", "expected one of the two")
    checks.positive("--search-deg", search_deg)
    settings: dict[str, Any] = {"search_deg": search_deg}
    if dynamic_range_db is not None:
        settings["dynamic_range_db"] = checks.positive("--dynamic-range-db", dynamic_range_db)
    other = mesh if simulated is None else simulated
    assert other is not None
    if quick and mesh is None:
        raise wrong_usage("--quick", "expected --mesh with it")
    check_outputs([output], force=force, inputs=[measured, other])
    chosen = None if variant is None else variant.value
    grid = voxel_grid(x_mm, y_mm, z_mm)
    # A mesh that cannot be read should not cost an image first.
    scene = None if mesh is None else Scene.from_mesh(mesh, unit=unit.value)
    opened = open_device(device)
    recorded = open_image(measured, frame=frame, variant=chosen)
    image = None if simulated is None else open_image(simulated)
    if x_mm is None and y_mm is None and z_mm is None:
        grid = next((i.grid for i in (recorded, image) if isinstance(i, Volume)), grid)
    volume = formed(measured, recorded, grid, method.value, window.value, opened)
    files = recording_files(measured, recorded.meta)
    if scene is not None:
        if isinstance(recorded, Capture):
            settings["array"] = recorded.array
            settings["waveform"] = recorded.waveform
        with progress_bar("aligning") as progress:
            result = align_mesh(
                volume, scene, correct_bias=not quick, device=opened, progress=progress, **settings
            )
    else:
        assert simulated is not None
        assert image is not None
        moving = formed(simulated, image, grid, method.value, window.value, opened)
        result = align(volume, moving, **settings)
    options = {
        "measured": str(measured),
        "simulated": None if simulated is None else str(simulated),
        "mesh": None if mesh is None else str(mesh),
        "unit": unit.value,
        "quick": quick,
        "search_deg": search_deg,
        "dynamic_range_db": dynamic_range_db,
        "method": method.value,
        "window": window.value,
        "grid": grid_text(volume.grid),
        "frame": frame,
        "variant": chosen,
    }
    record = {**result.to_dict(), **provenance("align", options, [*files, other])}
    write_json(output, record, force=force)
    print_text(result.report())
    for remark in result.remarks():
        print_warning(remark)
    print_line(f"{output}: the transform, its covariance and this report")
