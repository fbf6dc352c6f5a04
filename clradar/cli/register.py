"""``clradar register``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.compare import metrics_records, print_metrics
from clradar.cli.images import formed, open_image, recording_files, save_image
from clradar.cli.options import (
    DeviceOption,
    ForceOption,
    FrameOption,
    SearchOption,
    Unit,
    VariantOption,
    XOption,
    YOption,
    ZOption,
    grid_text,
    voxel_grid,
    wrong_usage,
)
from clradar.cli.output import (
    print_line,
    print_text,
    print_warning,
    progress_bar,
    write_bytes,
    write_json,
)
from clradar.cli.provenance import provenance
from clradar.cli.simulate import save_with_provenance
from clradar.errors import OutputError

if TYPE_CHECKING:
    from calibration import Registration, Round
    from clradar import Volume

PLACED, TRANSFORM, CAPTURE = "placed.ply", "transform.json", "capture.h5"
VOLUME, FIGURE, METRICS = "volume.h5", "comparison.png", "metrics.json"

FILES = (PLACED, TRANSFORM, CAPTURE, VOLUME, FIGURE, METRICS)

FIT = "fit"


def command(
    measured: Annotated[
        Path, typer.Argument(metavar="MEASURED", help="Volume, capture or recording.")
    ],
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="Mesh file, placed anywhere.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="New folder.")],
    unit: Annotated[Unit, typer.Option("--unit", help="Unit of the mesh file.")] = Unit.m,
    alpha: Annotated[
        str,
        typer.Option(
            "--alpha",
            metavar="ALPHA|fit",
            help="0 specular to 1 diffuse, or fit: found from how the brightness falls with the "
            "angle.",
        ),
    ] = FIT,
    samples_per_mm2: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--samples-per-mm2", metavar="N", help="As in `clradar simulate`."),
    ] = None,
    rays_per_sample: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--rays-per-sample", metavar="N", help="As in `clradar simulate`."),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Of the first round; counts up from there.")
    ] = 0,
    search_deg: SearchOption = 45.0,
    max_rounds: Annotated[
        int, typer.Option("--max-rounds", metavar="N", help="Simulations at most.")
    ] = 10,
    x_mm: XOption = None,
    y_mm: YOption = None,
    z_mm: ZOption = None,
    frame: FrameOption = None,
    variant: VariantOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """Writes into DIR the placed mesh, the transform (for `clradar simulate --transform`), the
    simulated capture and its volume, a figure and the metrics: all or nothing. Captures are imaged
    first, on the grid of the options. Done when a round moves the mesh by less than 0.1 mm.
    """
    from dataclasses import replace

    from calibration import register
    from clradar import Capture, Scene, open_device
    from clradar.files.atomic import new_folder, swap_folder

    fixed = read_alpha(alpha)
    check_folder(output, force=force)
    scene = Scene.from_mesh(mesh, alpha=0.5 if fixed is None else fixed, unit=unit.value)
    chosen = None if variant is None else variant.value
    grid = voxel_grid(x_mm, y_mm, z_mm)
    recorded = open_image(measured, frame=frame, variant=chosen)
    opened = open_device(device)
    volume = formed(measured, recorded, grid, "fast", "rect", opened)
    radar: dict[str, Any] = {}
    if isinstance(recorded, Capture):
        radar = {"array": recorded.array, "waveform": recorded.waveform}
    with progress_bar("registering") as progress:
        done: list[Round] = []

        def show(turn: Round) -> None:
            done.append(turn)
            if progress is not None:
                progress(len(done), max_rounds)
            else:
                print_line(round_text(len(done), turn))

        result = register(
            volume,
            scene,
            fit_alpha=fixed is None,
            samples_per_mm2=samples_per_mm2,
            rays_per_sample=rays_per_sample,
            seed=seed,
            search_deg=search_deg,
            max_rounds=max_rounds,
            device=opened,
            callback=show,
            **radar,
        )
    inputs = [*recording_files(measured, recorded.meta), mesh]
    options = {
        "measured": str(measured),
        "mesh": str(mesh),
        "unit": unit.value,
        "alpha": alpha,
        "samples_per_mm2": samples_per_mm2,
        "rays_per_sample": rays_per_sample,
        "seed": seed,
        "search_deg": search_deg,
        "max_rounds": max_rounds,
        "grid": grid_text(volume.grid),
        "frame": frame,
        "variant": chosen,
    }
    with new_folder(output) as temporary:
        made = temporary / "made"
        made.mkdir()
        write_all(made, volume, result, options, inputs)
        check_folder(output, force=force)  # somebody else may have made it meanwhile
        swap_folder(made, output, temporary / "replaced")
    print_text(result.alignment.report())
    if not result.converged:
        print_warning(f"still moving after {len(result.rounds)} rounds; see {TRANSFORM}")
    for remark in replace(result.alignment, converged=True).remarks():
        print_warning(remark)
    print_line(f"{output}: {PLACED}, {TRANSFORM}, {CAPTURE}, {VOLUME}, {FIGURE}, {METRICS}")


def read_alpha(text: str) -> float | None:
    """Return the number, or None for `fit`."""
    if text == FIT:
        return None
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise wrong_usage("--alpha", f"expected a number in [0, 1] or '{FIT}', got '{text}'")
    return value


def check_folder(folder: Path, *, force: bool) -> None:
    """Raise unless `folder` may be made: it is not there, or is empty, or holds an older result."""
    try:
        if not os.path.lexists(folder):
            return
        if not folder.is_dir():
            raise OutputError(f"{folder}: expected a folder's name, got a file")
        held = {path.name for path in folder.iterdir()}
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{folder}: cannot be written: {error}") from error
    if held and not force:
        raise OutputError(f"{folder}: holds files already; --force replaces an earlier result")
    others = sorted(held - set(FILES))
    if others:
        raise OutputError(
            f"{folder}: holds '{others[0]}', which --force would delete; choose another folder"
        )


def round_text(number: int, turn: Round) -> str:
    """Return one round in words."""
    alpha = "" if turn.alpha is None else f"alpha {turn.alpha:.2f}, "
    return f"round {number}: {alpha}moved by {1e3 * turn.moved_m:.2f} mm"


def write_all(
    folder: Path,
    measured: Volume,
    result: Registration,
    options: dict[str, Any],
    inputs: list[Path],
) -> None:
    """Write what a registration found into `folder`."""
    import trimesh

    from clradar import compare
    from clradar.plot import comparison_figure, save_figure

    scene = result.scene
    placed = trimesh.Trimesh(scene.vertices_m, scene.faces, process=False)
    write_bytes(folder / PLACED, placed.export(file_type="ply"), force=False)
    rounds = [
        {"transform": r.transform.tolist(), "alpha": r.alpha, "moved_m": r.moved_m}
        for r in result.rounds
    ]
    origin = provenance("register", options, inputs)
    record = {**result.alignment.to_dict(), "rounds": rounds, **origin}
    write_json(folder / TRANSFORM, record, force=False)
    save_with_provenance(folder / CAPTURE, result.capture, "register", options, inputs, force=False)
    save_image(folder / VOLUME, result.volume, "register", options, inputs, force=False)
    maps = [volume.depth_map() for volume in (measured, result.volume)]
    metrics = compare(*maps)
    alpha = result.rounds[-1].alpha
    name = (
        "Simulated" if alpha is None else f"Simulated, \N{GREEK SMALL LETTER ALPHA} = {alpha:.2f}"
    )
    figure = comparison_figure(maps[0], [(name, maps[1])], metrics=[metrics])
    save_figure(figure, folder / FIGURE)
    records = metrics_records([Path(VOLUME)], [name], [metrics])
    write_json(
        folder / METRICS,
        {"measured": options["measured"], "alpha": alpha, "simulated": records, **origin},
        force=False,
    )
    print_metrics([name], [metrics])
