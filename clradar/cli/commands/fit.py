"""The pose of what was measured: ``align``, ``register``, ``fit-hand``."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import calibration
import clradar as cl
from clradar.cli import console, images as img, options as opt, outputs as out, parse
from clradar.errors import ClradarWarning
from clradar.jobs import open_devices
from clradar.model import checks

DOUBTS = "\nDoubtful: "  # where they begin in a report; of each there is a warning


def align_command(
    *,
    measured: Path = opt.MEASURED,
    output: Path = opt.output_option("JSON file for transform and report."),
    simulated: Path | None = opt.argument("Volume or capture; not with --mesh.", without="--mesh"),
    mesh: Path | None = opt.option("Align this mesh instead of an image.", metavar="MESH"),
    unit: opt.UnitOptions,
    search: opt.SearchOptions,
    quick: bool = opt.option(
        "Without the simulations that correct the bias of a mesh: up to some millimetres "
        "off where it is specular.",
        False,
        needs="--mesh",
    ),
    dynamic_range_db: float | None = opt.option(
        "Depth points are this far below the maximum at most. [default: 15; mesh: 20]",
        check=checks.positive,
    ),
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    frames: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """The 4 x 4 matrix in the JSON file, "transform", moves image or mesh onto MEASURED, as
    `clradar simulate --transform` does. --frame and --variant are those of MEASURED. A mesh is more
    exact than an image: docs/calibration.md.
    """
    path = mesh or simulated
    if path is None:
        raise opt.wrong_usage("SIMULATED, --mesh", "expected one of the two")
    if opt.given(radar) and mesh is None:
        names = ", ".join(opt.given(radar))
        raise opt.wrong_usage(names, "expected --mesh with it, which is simulated")
    settings: dict[str, Any] = {"search_deg": search.search_deg}
    if dynamic_range_db is not None:
        settings["dynamic_range_db"] = dynamic_range_db
    scene = None if mesh is None else cl.Scene.from_mesh(mesh, unit=unit.unit)
    opened = open_devices(device).first
    images = [img.open_image(measured, frames)]
    instrument = {} if scene is None else img.radar_of(measured, images[0], radar)
    if scene is None:
        images.append(img.open_image(path))
    volumes = img.imaged(images, voxels, imaging, opened)
    with console.bar("aligning") as progress:
        if scene is None:
            result = calibration.align(*volumes, progress=progress, **settings)
        else:
            result = calibration.align_mesh(
                volumes[0], scene, correct_bias=not quick, device=opened, progress=progress,
                **settings, **instrument,
            )  # fmt: skip
    console.text(result.report().partition(DOUBTS)[0])
    text = "the transform, its covariance and this report"
    out.write(output, result.to_dict(), text, grid=opt.grid_text(volumes[0].grid))


TRANSFORM = "transform.json"
REGISTERED = (TRANSFORM, *img.SIMULATION_FILES)


@dataclass(frozen=True, kw_only=True)
class RegistrationOptions(opt.UnitOptions, opt.SamplingOptions, opt.SearchOptions):
    estimator: opt.Estimator | None = opt.option(
        f"{opt.ESTIMATORS} [default: stochastic, or physical with --material]"
    )
    alpha: float | str = opt.alpha_or_fit()
    seed: int = opt.option("Of the first round; counts up from there.", 0)
    max_rounds: int = opt.option(
        "Simulations at most: 7 or more with --alpha fit, 2 or more without.", 10
    )


def register_command(
    *,
    measured: Path = opt.MEASURED,
    mesh: Path = opt.argument("Mesh file, placed anywhere."),
    output: Path = opt.output_option("New folder.", metavar="DIR", folder=True),
    registration: RegistrationOptions,
    made_of: opt.MaterialOptions,
    voxels: opt.GridOptions,
    frames: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """DIR gets the placed mesh, its transform, its simulation (capture and volume), a figure and
    the metrics: all or nothing. Done when a round moves the mesh by less than 0.1 mm.
    """
    out.check_folder(output, REGISTERED)
    how = opt.arguments_of(registration)
    alpha, unit = how.pop("alpha"), how.pop("unit")
    how["estimator"] = made_of.estimator(registration.estimator)
    physical, fitted = how["estimator"] == opt.PHYSICAL, alpha == parse.FIT
    if physical and not fitted:
        raise opt.wrong_usage("--alpha", f"--estimator {opt.PHYSICAL} knows --material, no alpha")
    how["fit_alpha"] = fitted and not physical
    scene = made_of.on(cl.Scene.from_mesh(mesh, alpha=0.5 if fitted else alpha, unit=unit))
    opened = open_devices(device).first
    found = img.Measurement(measured, frames, radar, voxels, opt.ImagingOptions(), opened)
    with console.bar("registering") as progress:
        how |= {"device": opened, "progress": progress, **found.radar}
        result = calibration.register(found.volume, scene, **how)
    alpha, label = result.rounds[-1].alpha, "Simulated"
    if alpha is not None:
        label += f", \N{GREEK SMALL LETTER ALPHA} = {alpha:.2f}"
    elif result.capture.meta["settings"]["estimator"] == opt.PHYSICAL:
        label += f", {img.simulated_surface(result.capture.meta)}"
    compared = img.Comparison([found.volume, result.volume], [label])
    rounds = [
        {"transform": r.transform.tolist(), "alpha": r.alpha, "moved_m": r.moved_m}
        for r in result.rounds
    ]
    metrics = {"alpha": alpha, "simulated": compared.records([Path("volume.h5")])}
    simulated = (result.scene, result.capture, result.volume)
    more: dict[str, Any] = {"grid": opt.grid_text(found.volume.grid)}
    with out.whole_folder(output, REGISTERED) as made:
        out.write(made / TRANSFORM, {**result.alignment.to_dict(), "rounds": rounds}, **more)
        img.write_simulation(made, measured, simulated, compared, metrics, **more)
    console.text(result.alignment.report().partition(DOUBTS)[0])
    moved_mm = 1e3 * result.rounds[-1].moved_m
    console.line(
        f"{console.counted(len(result.rounds), 'round')}, the last moved it by {moved_mm:.2f} mm"
    )
    console.line(f"{output}: {', '.join(REGISTERED)}")


POSE, HAND_FIT, OVERLAY = "pose.toml", "fit.json", "overlay.png"
FITTED = (POSE, HAND_FIT, OVERLAY, *img.SIMULATION_FILES)


@dataclass(frozen=True, kw_only=True)
class HandFitOptions(opt.HandOptions):
    """Where the fit starts, what it fits, and how it searches."""

    pose: str = opt.option(
        "Where the fit starts: a name (`clradar hand --list`), a pose file, the folder of an "
        "earlier fit, several of them, or all: every letter.",
        "all",
        "--pose",
        "--start",
        metavar="POSE,...",
        files=opt.start_files,
    )
    alpha: float | str = opt.alpha_or_fit()
    quick: bool = opt.option(
        "Without the simulations that correct the bias and find alpha: less exact.", False
    )


def fit_hand_command(
    *,
    measured: Path = opt.MEASURED,
    output: Path = opt.output_option("New folder.", metavar="DIR", folder=True),
    fitting: HandFitOptions,
    voxels: opt.GridOptions,
    imaging: opt.ImagingOptions,
    frame: opt.FrameOptions,
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """Finds joint angles, place and alpha; no mesh is needed. DIR gets pose.toml (for `clradar
    hand` and data sets), placed.ply, fit.json with what the measurement tells and what not, the
    hand's simulation, two pictures and the metrics: all or nothing. See docs/hand-fit.md.
    """
    out.check_folder(output, FITTED)
    alpha = None if fitting.alpha == parse.FIT else fitting.alpha
    settings = {**fitting.settings(fitting.pose), "alpha": alpha, "closed_loop": not fitting.quick}
    opened = open_devices(device).first
    found = img.Measurement(measured, frame, radar, voxels, imaging, opened)
    with console.bar("fitting") as progress:
        settings |= {"device": opened, "progress": progress, **found.radar}
        fit = calibration.fit_hand(found.volume, **settings)
    with out.whole_folder(output, FITTED) as made:
        write_hand_fit(made, found, fit, fitting.seed, opened)
    console.text(fit.report().partition(DOUBTS)[0])
    console.line(f"{output}: {', '.join(FITTED)}")


def write_hand_fit(
    folder: Path, measured: img.Measurement, fit: calibration.HandFit, seed: int, device: cl.Device
) -> None:
    """Write all files of a fit into `folder`; the hand before and after is simulated for them."""
    from calibration.hand_fit.figure import hand_fit_figure
    from calibration.registration.radar import Radar

    used = Radar.of("fit_hand", measured.radar.get("array"), measured.radar.get("waveform"))

    def imaged(scene: cl.Scene) -> tuple[cl.Capture, cl.Volume]:
        with console.bar("simulating") as progress:
            capture = cl.simulate(
                scene, used.array, used.waveform, seed=seed, device=device, progress=progress
            )
        grid = measured.volume.grid
        return capture, cl.backproject(capture, grid, check_grid=False, device=device)

    before, (capture, after) = imaged(fit.started)[1], imaged(fit.scene)
    name, source = f"{fit.pose.name}, fitted to {measured.path.name}", str(measured.path)
    cl.hand.write_pose(folder / POSE, replace(fit.pose, name=name, description="", source=source))
    more: dict[str, Any] = {"grid": opt.grid_text(measured.volume.grid)}
    out.write(folder / HAND_FIT, fit.to_dict(), **more)
    out.write(folder / OVERLAY, partial(hand_fit_figure, measured.volume, fit))
    labels = [f"Before: '{fit.start}', moved", "After"]
    if (surface := img.simulated_surface(after.meta)) is not None:
        labels[1] += f", {surface}"
    with warnings.catch_warnings():
        # That the start is another pose is no news; the table has what differs.
        warnings.simplefilter("ignore", ClradarWarning)
        compared = img.Comparison([measured.volume, before, after], labels)
    metrics = dict(zip(("before", "after"), (m.to_dict() for m in compared.metrics), strict=True))
    simulated = (fit.scene, capture, after)
    img.write_simulation(folder, measured.path, simulated, compared, metrics, **more)
