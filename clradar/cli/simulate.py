"""``clradar simulate``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.options import DeviceOption, ForceOption, Unit, wrong_usage
from clradar.cli.output import check_outputs, print_line, print_warning, progress_bar
from clradar.cli.provenance import provenance
from clradar.cli.simulation_options import (
    RECEPTION_RADIUS_MM,
    START_GHZ,
    STEPS,
    STOP_GHZ,
    Amplitude,
    AmplitudeOption,
    CreaseOption,
    MaxBouncesOption,
    Normals,
    NormalsOption,
    PatternOption,
    RaysPerFaceOption,
    RaysPerSampleOption,
    ReceptionRadiusOption,
    SamplesOption,
    TransformOption,
)
from clradar.errors import ModelError
from clradar.geometry.normals import CREASE_DEG
from clradar.tracing.settings import EXPECTED_SAMPLES_PER_MM2

if TYPE_CHECKING:
    from clradar import Capture, Scene

ALPHA = 0.5


class Estimator(str, Enum):
    stochastic = "stochastic"
    expected = "expected"


def command(
    meshes: Annotated[
        list[str],
        typer.Argument(
            metavar="MESH[:ALPHA]",
            help="Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture to write (HDF5).")],
    alpha: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--alpha",
            metavar="ALPHA|PART=ALPHA",
            help="0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
            f"[default: {ALPHA:g}]",
        ),
    ] = None,
    unit: Annotated[Unit, typer.Option("--unit", help="Unit of the mesh files.")] = Unit.m,
    transform: TransformOption = None,
    samples_per_mm2: SamplesOption = None,
    rays_per_face: RaysPerFaceOption = None,
    rays_per_sample: RaysPerSampleOption = None,
    reception_radius_mm: ReceptionRadiusOption = RECEPTION_RADIUS_MM,
    max_bounces: MaxBouncesOption = 1,
    normals: NormalsOption = Normals.smooth,
    crease_deg: CreaseOption = CREASE_DEG,
    amplitude: AmplitudeOption = Amplitude.unit,
    pattern_exponent: PatternOption = 0.0,
    estimator: Annotated[
        Estimator,
        typer.Option(
            "--estimator",
            help="stochastic: random outgoing rays; expected: their mean, without shot noise, "
            f"from {EXPECTED_SAMPLES_PER_MM2:g} sample per square millimetre.",
        ),
    ] = Estimator.stochastic,
    start_ghz: Annotated[
        float, typer.Option("--start-ghz", metavar="GHZ", help="First frequency.")
    ] = START_GHZ,
    stop_ghz: Annotated[
        float, typer.Option("--stop-ghz", metavar="GHZ", help="Last frequency.")
    ] = STOP_GHZ,
    steps: Annotated[
        int, typer.Option("--steps", metavar="N", help="Number of frequencies.")
    ] = STEPS,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Same seed, same device: same bits.")
    ] = 0,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """The radar is the 94 x 94 imager with a 14 cm aperture in the plane z = 0. Meshes are in its
    antenna frame: x to the right of a person who faces the aperture, y up, z away from it.

    The parts that --alpha can name are the geometries of the files; a wrong name lists them.
    """
    import clradar
    from measurement_io import read_transform

    named = [split_alpha(text) for text in meshes]
    default, by_part = read_alphas(alpha or [])
    files = [path for path, _ in named]
    inputs = files if transform is None else [*files, transform]
    check_outputs([output], force=force, inputs=inputs)
    matrix = None if transform is None else read_transform(transform)
    scene = load_scene(named, default, by_part, unit.value, matrix)
    waveform = clradar.Waveform.sfcw(start_ghz * 1e9, stop_ghz * 1e9, steps)
    if scene.vertices_m[:, 2].min() <= 0.0:
        print_warning(
            "the scene reaches behind the aperture (z <= 0); is it in the antenna frame? Place it "
            "with --transform"
        )
    opened = clradar.open_device(device)
    start_s = perf_counter()
    with progress_bar("tracing") as progress:
        capture = clradar.simulate(
            scene,
            clradar.arrays.qar50(),
            waveform,
            samples_per_mm2=samples_per_mm2,
            rays_per_face=rays_per_face,
            rays_per_sample=rays_per_sample,
            reception_radius_m=reception_radius_mm / 1e3,
            max_bounces=max_bounces,
            normals=normals.value,
            crease_deg=crease_deg,
            amplitude=amplitude.value,
            pattern_exponent=pattern_exponent,
            seed=seed,
            estimator=estimator.value,
            device=opened,
            progress=progress,
        )
    if capture.meta["rays"]["paths"] == 0:
        print_warning("no ray reached a receiver: the capture is zero everywhere")
    options: dict[str, Any] = {
        "meshes": [{"file": p.name, "alpha": default if a is None else a} for p, a in named],
        "alpha_of_parts": by_part,
        "unit": unit.value,
        "transform": None if matrix is None else matrix.tolist(),
        "waveform_ghz": [start_ghz, stop_ghz, steps],
    }
    save_with_provenance(output, capture, "simulate", options, inputs, force=force)
    print_line(
        f"{output}: {summary(capture)}, {perf_counter() - start_s:.1f} s on {opened.info.label}"
    )


def split_alpha(text: str) -> tuple[Path, float | None]:
    """Return file and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or Path(text).exists():
        return Path(text), None
    try:
        return Path(name), _alpha("MESH:ALPHA", number)
    except ValueError:
        return Path(text), None


def read_alphas(values: Sequence[str]) -> tuple[float, dict[str, float]]:
    """Return the alpha of what is not named, and that of each named part."""
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
            raise wrong_usage("--alpha", "only one value may stand without a part's name")
        else:
            default = value
    return ALPHA if default is None else default, by_part


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
    """Return all meshes as one scene."""
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


def save_with_provenance(
    path: Path,
    capture: Capture,
    command: str,
    options: dict[str, Any],
    inputs: Sequence[Path],
    *,
    force: bool,
) -> Capture:
    """Write a capture with the record of how it came to be; return it as written."""
    from measurement_io import save_capture

    meta = {**capture.meta, **provenance(command, options, inputs)}
    written = replace(capture, meta=meta)
    save_capture(path, written, force=force)
    return written


def summary(capture: Capture) -> str:
    """Return a simulated capture in words."""
    rays = capture.meta["rays"]
    shape = " x ".join(str(n) for n in capture.data.shape)
    if capture.meta["settings"]["estimator"] == "expected":
        return f"{shape}, {rays['samples']} samples, {rays['paths']} expected receptions"
    return (
        f"{shape}, {rays['samples']} samples, {rays['outgoing']} rays of which {rays['paths']} "
        f"reached an Rx, {100 * rays['absorbed_share']:.1f} % absorbed"
    )
