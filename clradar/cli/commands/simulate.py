"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.alphas import (
    AlphaOptions,
    read_alpha,
    read_part_alphas,
    with_part_alphas,
)
from clradar.cli.options.common import DeviceOption, ForceOption
from clradar.cli.options.groups import REQUIRED, argument, option, output_option, recorded
from clradar.cli.options.materials import PHYSICAL, MaterialOptions
from clradar.cli.options.motion import MotionOptions
from clradar.cli.options.radar import RadarOptions
from clradar.cli.options.simulation import (
    ESTIMATORS,
    Estimator,
    PlacementOptions,
    SimulationOptions,
)
from clradar.cli.options.values import wrong_usage
from clradar.cli.outputs import check_folder, made_folder, save
from clradar.cli.provenance import provenance
from clradar.errors import warn

if TYPE_CHECKING:
    from clradar import Capture, Scene


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PlacementOptions, AlphaOptions):
    """Meshes, their position and their alpha."""

    meshes: list[str] | None = argument(
        None,
        "Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1. None "
        "where --motion has a hand.",
        metavar="MESH[:ALPHA]",
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
    moving: MotionOptions,
    output: Path = output_option(
        REQUIRED, "Capture to write (HDF5); with --frames the folder of a recording to make."
    ),
    *,
    made_of: MaterialOptions,
    simulation: SimulationOptions,
    estimator: EstimatorOptions,
    radar: RadarOptions,
    device: DeviceOption = None,
    force: ForceOption = False,
) -> None:
    """The radar is the 94 x 94 imager with a 14 cm aperture in the plane z = 0, or that of --array.
    Meshes are in its antenna frame: x to the right of a person who faces the aperture, y up, z away
    from it.

    The parts that --alpha and --material-of can name are the geometries of the files; a wrong name
    lists them.

    With --motion the scene moves while the imager records it (docs/movement.md), and --frames makes
    a recording that every command reads; of another radar than the imager, a folder of captures.

    An --array of clusters whose Tx are measured with their own Rx only makes a folder with a
    capture of each, of which `clradar image DIR/cluster_*.h5` makes one image.
    """
    import clradar
    from clradar import Scene
    from clradar.cli.motion_recording import MotionRecording

    named = [split_alpha(text) for text in scenery.meshes or []]
    if not named and moving.motion is None:
        raise wrong_usage("MESH", "expected a mesh file, or --motion with a hand")
    default, by_part = read_part_alphas(scenery.alpha or [])
    inputs = [*(path for path, _ in named), *scenery.files, *made_of.files, *radar.files]
    inputs += [] if moving.motion is None else [moving.motion]
    clusters = radar.clusters()
    names = [f"cluster_{i + 1:03d}.h5" for i in range(len(clusters))]
    if len(clusters) > 1:
        if moving.motion is not None:
            raise wrong_usage("--motion", "expected one array, not clusters with captures of each")
        check_folder(output, force=force, replaced=names, inputs=inputs)
    else:
        moving.check(output, force=force, inputs=inputs)
    motion = moving.read()
    if motion is not None and len(motion.files) > 1:
        inputs += motion.files[1:]
        moving.check(output, force=force, inputs=inputs)  # they are known only now
    matrix = scenery.matrix()
    chosen = made_of.estimator(estimator.estimator)
    if chosen == PHYSICAL and (scenery.alpha or any(a is not None for _, a in named)):
        warn(f"--alpha: not used by --estimator {PHYSICAL}; --material has the roughness")
    settings = simulation.settings(seed=estimator.seed, estimator=chosen)
    # Meshes that cannot be read are said before their content is part of the record.
    still = None
    if motion is None:
        still = made_of.on(load_scene(named, default, by_part, scenery.unit, matrix))
    antennas, waveform = clusters[0], radar.waveform()
    opened = clradar.open_device(device)
    options = recorded(
        made_of,
        moving,
        meshes=[{"file": p.name, "alpha": default if a is None else a} for p, a in named],
        alpha_of_parts=by_part,
        unit=scenery.unit,
        transform=None if matrix is None else matrix.tolist(),
        array=antennas.name,
        waveform_ghz=radar.band_ghz,
    )
    origin = provenance("simulate", options, inputs)
    start_s = perf_counter()
    if still is not None:
        files = [output] if len(clusters) == 1 else [output / name for name in names]
        with nullcontext() if len(clusters) == 1 else made_folder(output):
            for antennas, file in zip(clusters, files, strict=True):
                with progress_bar("tracing") as progress:
                    capture = clradar.simulate(
                        still, antennas, waveform,
                        settings=settings, device=opened, progress=progress,
                    )  # fmt: skip
                save(file, capture, origin, force=force)
        words = summary(capture)
        words = words if len(clusters) == 1 else f"{len(clusters)} captures, the last: {words}"
    elif motion is not None:
        bodies = {
            path.name: Scene.from_mesh(
                path, alpha=default if a is None else a, unit=scenery.unit, transform=matrix
            )
            for path, a in named
        }
        if len(bodies) < len(named):
            raise wrong_usage("MESH", "expected different names of files with --motion")
        finish = lambda scene: made_of.on(with_part_alphas(scene, by_part))  # noqa: E731
        recording = MotionRecording(
            motion, motion.scene(bodies, finish=finish, alpha=default, device=opened),
            antennas, waveform, settings, moving.rate_hz,
        )  # fmt: skip
        with progress_bar("simulating") as progress:
            words = recording.write(output, moving.frames, origin, opened, progress, force=force)
    took_s = perf_counter() - start_s
    print_line(f"{output}: {words}, {took_s:.1f} s on {opened.info.label}")


def split_alpha(text: str) -> tuple[Path, float | None]:
    """File and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or Path(text).exists():
        return Path(text), None
    try:
        return Path(name), read_alpha("MESH:ALPHA", number)
    except ValueError:
        return Path(text), None


def load_scene(
    meshes: Sequence[tuple[Path, float | None]],
    default: float,
    by_part: dict[str, float],
    unit: str,
    transform: Any,
) -> Scene:
    """All meshes as one scene."""
    from clradar import Scene

    scene = Scene.combine(
        Scene.from_mesh(path, alpha=default if a is None else a, unit=unit, transform=transform)
        for path, a in meshes
    )
    return with_part_alphas(scene, by_part)


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
