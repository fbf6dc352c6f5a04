"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.common import CaptureOutput, DeviceOption, ForceOption
from clradar.cli.options.groups import REQUIRED, argument, option, recorded
from clradar.cli.options.materials import PHYSICAL, MaterialOptions
from clradar.cli.options.simulation import (
    ESTIMATORS,
    Estimator,
    PlacementOptions,
    SimulationOptions,
    WaveformOptions,
)
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_outputs, save
from clradar.cli.provenance import provenance
from clradar.errors import ModelError, warn

if TYPE_CHECKING:
    from clradar import Capture, Scene

DEFAULT_ALPHA = 0.5


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PlacementOptions):
    """Meshes, their position and their alpha."""

    meshes: list[str] = argument(
        REQUIRED,
        "Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1",
        metavar="MESH[:ALPHA]",
    )
    alpha: list[str] | None = option(
        None,
        "0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
        f"[default: {DEFAULT_ALPHA:g}]",
        metavar="ALPHA|PART=ALPHA",
    )


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions:
    """Estimator of the received field, and its random numbers."""

    estimator: Estimator | None = option(
        None,
        f"{ESTIMATORS} [default: physical with --material, stochastic with samples, rays or "
        "bounces, else expected]",
    )
    seed: int = option(0, "Same seed, same device: same bits.", metavar="N")


def command(
    scenery: SceneOptions,
    output: CaptureOutput,
    made_of: MaterialOptions,
    simulation: SimulationOptions,
    estimator: EstimatorOptions,
    frequencies: WaveformOptions,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """The radar is the 94 x 94 imager with a 14 cm aperture in the plane z = 0. Meshes are in its
    antenna frame: x to the right of a person who faces the aperture, y up, z away from it.

    The parts that --alpha and --material-of can name are the geometries of the files; a wrong name
    lists them.
    """
    import clradar

    named = [split_alpha(text) for text in scenery.meshes]
    default, by_part = read_part_alphas(scenery.alpha or [])
    inputs = [*(path for path, _ in named), *scenery.files, *made_of.files]
    check_outputs([output], force=force, inputs=inputs)
    matrix = scenery.matrix()
    chosen = made_of.estimator(estimator.estimator)
    if chosen == PHYSICAL and (scenery.alpha or any(a is not None for _, a in named)):
        warn(f"--alpha: not used by --estimator {PHYSICAL}; --material has the roughness")
    settings = simulation.settings(seed=estimator.seed, estimator=chosen)
    scene = made_of.on(load_scene(named, default, by_part, scenery.unit, matrix))
    waveform = frequencies.waveform()
    opened = clradar.open_device(device)
    start_s = perf_counter()
    with progress_bar("tracing") as progress:
        capture = clradar.simulate(
            scene, clradar.arrays.qar50(), waveform,
            settings=settings, device=opened, progress=progress,
        )  # fmt: skip
    options = recorded(
        made_of,
        meshes=[{"file": p.name, "alpha": default if a is None else a} for p, a in named],
        alpha_of_parts=by_part,
        unit=scenery.unit,
        transform=None if matrix is None else matrix.tolist(),
        waveform_ghz=frequencies.band_ghz,
    )
    save(output, capture, provenance("simulate", options, inputs), force=force)
    took_s = perf_counter() - start_s
    print_line(f"{output}: {summary(capture)}, {took_s:.1f} s on {opened.info.label}")


def split_alpha(text: str) -> tuple[Path, float | None]:
    """File and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or Path(text).exists():
        return Path(text), None
    try:
        return Path(name), _alpha("MESH:ALPHA", number)
    except ValueError:
        return Path(text), None


def read_part_alphas(values: Sequence[str]) -> tuple[float, dict[str, float]]:
    """The alpha of the parts that are not named, and that of each named part."""
    default = None
    by_part: dict[str, float] = {}
    for text in values:
        name, equals, number = text.rpartition("=")
        try:
            value = _alpha("--alpha", number)
        except ValueError:
            raise wrong_usage(
                "--alpha", f"expected a number or PART=number, got '{text}'"
            ) from None
        if equals:
            if name in by_part:
                raise wrong_usage("--alpha", f"part '{name}' is given twice")
            by_part[name] = value
        elif default is not None:
            raise wrong_usage("--alpha", "expected one value without a part's name, got two")
        else:
            default = value
    return DEFAULT_ALPHA if default is None else default, by_part


def _alpha(option: str, text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and 0.0 <= value <= 1.0):
        raise wrong_usage(option, f"expected an alpha in [0, 1], got '{text}'")
    return value


def load_scene(
    meshes: Sequence[tuple[Path, float | None]],
    default: float,
    by_part: dict[str, float],
    unit: str,
    transform: Any,
) -> Scene:
    """All meshes as one scene."""
    import numpy as np

    from clradar import Scene

    scene = Scene.combine(
        Scene.from_mesh(path, alpha=default if a is None else a, unit=unit, transform=transform)
        for path, a in meshes
    )
    unknown = sorted(set(by_part) - set(scene.part_names))
    if unknown:
        raise ModelError(
            f"--alpha: expected parts of the meshes ({', '.join(scene.part_names)}), got "
            f"{', '.join(unknown)}"
        )
    values = np.array(scene.alpha)
    for name, value in by_part.items():
        values[np.asarray(scene.part) == scene.part_names.index(name)] = value
    return scene.with_alpha(values)


def summary(capture: Capture) -> str:
    """A simulated capture in words."""
    rays = capture.meta["rays"]
    shape = " x ".join(str(n) for n in capture.data.shape)
    estimator = capture.meta["settings"]["estimator"]
    if estimator == "physical":
        materials = ", ".join(own["name"] for own in capture.meta["scene"]["materials"])
        lit = capture.meta["kirchhoff"]["lit"]
        points = f"{rays['samples']} points of which {lit} are seen"
        return f"{shape} S-parameters of {materials}, {points}"
    if estimator == "expected":
        return f"{shape}, {rays['samples']} samples, {rays['paths']} expected receptions"
    return (
        f"{shape}, {rays['samples']} samples, {rays['outgoing']} rays of which {rays['paths']} "
        f"reached an Rx, {100 * rays['absorbed_share']:.1f} % absorbed"
    )
