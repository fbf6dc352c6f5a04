"""The folder of ``clradar register``, its options, and what it prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.comparison import Comparison, simulated_surface
from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.common import SearchOptions, UnitOptions
from clradar.cli.options.groups import option, recorded, wrong_usage
from clradar.cli.options.scene import ESTIMATORS, PHYSICAL, Estimator, SamplingOptions
from clradar.cli.outputs import save
from clradar.cli.parse import FIT, alpha_or_fit
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import Registration, Round


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


def registered(
    volume: cl.Volume,
    scene: cl.Scene,
    registration: RegistrationOptions,
    radar: dict[str, Any],
    device: cl.Device,
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
    folder: Path,
    measured: cl.Volume,
    result: Registration,
    source: str,
    origin: dict[str, Any],
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
