"""``clradar register``: find the pose of a measured mesh, and simulate it there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli import comparison, options as opt, parse
from clradar.cli.console import counted, print_line, print_text, progress_bar
from clradar.cli.inputs import Measurement, measurement
from clradar.cli.outputs import check_folder, whole_folder, write
from clradar.jobs import open_devices

if TYPE_CHECKING:
    from calibration import Registration

TRANSFORM = "transform.json"
FILES = (TRANSFORM, *comparison.SIMULATION_FILES)


def command(
    *,
    measured: Path = opt.MEASURED,
    mesh: Path = opt.argument("Mesh file, placed anywhere."),
    output: Path = opt.output_option("New folder.", metavar="DIR", folder=True),
    registration: opt.RegistrationOptions,
    made_of: opt.MaterialOptions,
    voxels: opt.GridOptions,
    frames: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """DIR gets the placed mesh, its transform, its simulation (capture and volume), a figure and
    the metrics: all or nothing. Done when a round moves the mesh by less than 0.1 mm.
    """
    from calibration import register

    check_folder(output, FILES)
    how = opt.arguments_of(registration)
    alpha, unit = how.pop("alpha"), how.pop("unit")
    how["estimator"] = made_of.estimator(registration.estimator)
    physical, fitted = how["estimator"] == opt.PHYSICAL, alpha == parse.FIT
    if physical and not fitted:
        raise opt.wrong_usage("--alpha", f"--estimator {opt.PHYSICAL} knows --material, no alpha")
    how["fit_alpha"] = fitted and not physical
    scene = made_of.on(cl.Scene.from_mesh(mesh, alpha=0.5 if fitted else alpha, unit=unit))
    opened = open_devices(device).first
    found = measurement(measured, frames, radar, voxels, opt.ImagingOptions(), opened)
    with progress_bar("registering") as progress:
        how |= {"device": opened, "progress": progress, **found.radar}
        result = register(found.volume, scene, **how)
    with whole_folder(output, FILES) as made:
        write_registration(made, found, result)
    print_text(result.alignment.report())
    moved_mm = 1e3 * result.rounds[-1].moved_m
    print_line(f"{counted(len(result.rounds), 'round')}, the last moved it by {moved_mm:.2f} mm")
    print_line(f"{output}: {', '.join(FILES)}")


def write_registration(folder: Path, measured: Measurement, result: Registration) -> None:
    """Write all files of a registration into `folder`."""
    more: dict[str, Any] = {"grid": opt.grid_text(measured.volume.grid)}
    rounds = [
        {"transform": r.transform.tolist(), "alpha": r.alpha, "moved_m": r.moved_m}
        for r in result.rounds
    ]
    write(folder / TRANSFORM, {**result.alignment.to_dict(), "rounds": rounds}, **more)
    alpha, label = result.rounds[-1].alpha, "Simulated"
    if alpha is not None:
        label += f", \N{GREEK SMALL LETTER ALPHA} = {alpha:.2f}"
    elif result.capture.meta["settings"]["estimator"] == opt.PHYSICAL:
        label += f", {comparison.simulated_surface(result.capture.meta)}"
    compared = comparison.Comparison.of([measured.volume, result.volume], [label])
    metrics = {"alpha": alpha, "simulated": compared.records([Path(comparison.VOLUME)])}
    simulated = (result.scene, result.capture, result.volume)
    comparison.write_simulation(folder, measured.path, simulated, compared, metrics, **more)
