"""``clradar register``: find the pose of a measured mesh, and simulate it there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.comparison import Comparison, simulated_surface
from clradar.cli.console import print_line, print_text, progress_bar
from clradar.cli.inputs import ImageInput, common_grid
from clradar.cli.opening import open_written
from clradar.cli.options.common import (
    DeviceOption,
    ForceOption,
    MeasuredArgument,
    OpenOption,
    SearchOptions,
    UnitOptions,
)
from clradar.cli.options.groups import REQUIRED, argument, option, output_option, recorded
from clradar.cli.options.imaging import GridOptions, ImagingOptions, grid_text
from clradar.cli.options.materials import PHYSICAL, MaterialOptions
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.recording import FrameOptions
from clradar.cli.options.simulation import ESTIMATORS, Estimator, SamplingOptions
from clradar.cli.options.values import FIT, alpha_or_fit, wrong_usage
from clradar.cli.outputs import check_folder, save, whole_folder
from clradar.cli.provenance import provenance
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import Registration, Round
    from clradar import Device, Scene, Volume

PLACED, TRANSFORM, CAPTURE = "placed.ply", "transform.json", "capture.h5"
VOLUME, FIGURE, METRICS = "volume.h5", "comparison.png", "metrics.json"

FILES = (PLACED, TRANSFORM, CAPTURE, VOLUME, FIGURE, METRICS)


@dataclass(frozen=True, kw_only=True)
class RegistrationOptions(UnitOptions, SamplingOptions, SearchOptions):
    """Search and simulations of a registration."""

    estimator: Estimator | None = option(
        None, f"{ESTIMATORS} [default: stochastic, or physical with --material]"
    )
    alpha: str = option(
        FIT,
        "0 specular to 1 diffuse, or fit: found from how the brightness falls with the angle.",
        metavar="ALPHA|fit",
    )
    seed: int = option(0, "Of the first round; counts up from there.", metavar="N")
    max_rounds: int = option(
        10,
        "Simulations at most. With --alpha fit at least 7: the first 4 try fixed alphas, and "
        "fewer than 3 more do not find it. At least 2 otherwise.",
        metavar="N",
    )

    def alpha_value(self, physical: bool) -> float | None:
        """The number, or None for `fit` and where materials take its place."""
        if physical and self.alpha != FIT:
            raise wrong_usage("--alpha", f"--estimator {PHYSICAL} knows --material, no alpha")
        return alpha_or_fit(self.alpha)


def command(
    *,
    measured: MeasuredArgument,
    mesh: Path = argument(REQUIRED, "Mesh file, placed anywhere.", metavar="MESH"),
    output: Path = output_option(REQUIRED, "New folder.", metavar="DIR"),
    registration: RegistrationOptions,
    made_of: MaterialOptions,
    voxels: GridOptions,
    frames: FrameOptions,
    radar: RadarOptions,
    device: DeviceOption = None,
    force: ForceOption = False,
    show: OpenOption = False,
) -> None:
    """Writes into DIR the placed mesh, the transform (for `clradar simulate --transform`), the
    simulated capture and its volume, a figure and the metrics: all or nothing. Captures are imaged
    first, on the grid of the options. Done when a round moves the mesh by less than 0.1 mm.
    """
    from clradar import Scene, open_device

    registration = replace(registration, estimator=made_of.estimator(registration.estimator))
    alpha = registration.alpha_value(registration.estimator == PHYSICAL)
    read = [mesh, *made_of.files, *radar.files]
    check_folder(output, force=force, replaced=FILES, inputs=[measured, *read])
    scene = Scene.from_mesh(mesh, alpha=0.5 if alpha is None else alpha, unit=registration.unit)
    scene = made_of.on(scene)
    voxels.grid()  # wrong usage is reported before a file is read
    recorded_image = ImageInput.open(measured, frames)
    instrument = recorded_image.radar_or(radar)
    opened = open_device(device)
    grid = common_grid(voxels, recorded_image, device=opened)
    volume = recorded_image.volume(grid, ImagingOptions(), opened)
    result = registered(volume, scene, registration, instrument, opened)
    options = recorded(
        registration, made_of, frames, radar,
        measured=measured, mesh=mesh, grid=grid_text(volume.grid),
    )  # fmt: skip
    origin = provenance("register", options, [*recorded_image.files, *read])
    with whole_folder(output, force=force, replaced=FILES) as made:
        write_registration(made, volume, result, str(measured), origin)
    print_text(result.alignment.report())
    print_line(f"{output}: {', '.join(FILES)}")
    open_written(show, output / FIGURE)


def registered(
    volume: Volume,
    scene: Scene,
    registration: RegistrationOptions,
    radar: dict[str, Any],
    device: Device,
) -> Registration:
    """Register the mesh, and show each round as it is done."""
    from calibration import register

    settings = recorded(registration)
    del settings["unit"], settings["alpha"]
    fit_alpha = registration.alpha == FIT and registration.estimator != PHYSICAL
    done: list[Round] = []

    def show(step: Round) -> None:
        done.append(step)
        print_line(round_text(len(done), step))

    with progress_bar("registering") as progress:
        return register(
            volume, scene, fit_alpha=fit_alpha, device=device, progress=progress,
            callback=show if progress is None else None, **settings, **radar,
        )  # fmt: skip


def round_text(number: int, step: Round) -> str:
    """One round in words."""
    alpha = "" if step.alpha is None else f"alpha {step.alpha:.2f}, "
    return f"round {number}: {alpha}moved by {1e3 * step.moved_m:.2f} mm"


def write_registration(
    folder: Path, measured: Volume, result: Registration, source: str, origin: dict[str, Any]
) -> None:
    """Write all files of a registration into `folder`."""
    import numpy as np

    from clradar.files.meshes.ply_parts import ply_of_parts

    scene = result.scene
    placed = ply_of_parts(
        scene.vertices_m, scene.faces, np.asarray(scene.part), scene.part_names, scene.texture_m
    )
    write_file(folder / PLACED, placed, force=False)
    rounds = [
        {"transform": r.transform.tolist(), "alpha": r.alpha, "moved_m": r.moved_m}
        for r in result.rounds
    ]
    record = {**result.alignment.to_dict(), "rounds": rounds, **origin}
    write_json(folder / TRANSFORM, record, force=False)
    save(folder / CAPTURE, result.capture, origin, force=False)
    save(folder / VOLUME, result.volume, origin, force=False)
    alpha = result.rounds[-1].alpha
    label = "Simulated"
    if alpha is not None:
        label += f", \N{GREEK SMALL LETTER ALPHA} = {alpha:.2f}"
    elif result.capture.meta["settings"]["estimator"] == PHYSICAL:
        label += f", {simulated_surface(result.capture.meta)}"
    compared = Comparison.of([measured, result.volume], [label])
    compared.save_figure(folder / FIGURE, force=False, differences=True)
    simulated = compared.records([Path(VOLUME)])
    metrics = {"measured": source, "alpha": alpha, "simulated": simulated, **origin}
    write_json(folder / METRICS, metrics, force=False)
    compared.print()
