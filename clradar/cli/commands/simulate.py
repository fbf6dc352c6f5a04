"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli import simulations as made
from clradar.cli.console import print_line, progress_bar
from clradar.cli.outputs import (
    check_folder,
    check_outputs,
    check_place_of_folder,
    provenance,
    save,
)
from clradar.errors import warn


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Movement, and frames of it."""

    motion: Path | None = opt.option(
        "How meshes and hands move, and when each sample is recorded (docs/movement.md).",
        metavar="MOTION.toml",
    )
    frames: int | None = opt.option(
        "Make a recording of so many frames.", metavar="N", needs="--motion", min=1, max=10_000
    )
    rate_hz: float = opt.option(
        "Frames per second, from time 0 on.", 8.0, needs="--motion", check=parse.positive
    )


def command(
    scenery: opt.SceneOptions,
    moving: MotionOptions,
    output: Path = opt.output_option(
        "Capture to write (HDF5); with --frames the folder of a recording to make, of clusters "
        "that of their captures, which is resumed if begun.",
        opt.REQUIRED,
        folder=True,
    ),
    *,
    simulation: opt.SimulationOptions,
    estimator: opt.EstimatorOptions,
    radar: opt.RadarOptions,
    processes: opt.WorkerOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.FORCE,
) -> None:
    """The radar is the 94 x 94 imager with a 14 cm aperture in the plane z = 0, or that of --array.
    Meshes are in its frame: x to the right of a person who faces the aperture, y up, z away.

    The parts that --alpha can name are the geometries of the files. With --motion the scene moves
    while the imager records it (docs/movement.md).

    An --array of clusters whose Tx are measured with their own Rx only makes a folder with a
    capture of each, of which `clradar image DIR/cluster_*.h5` makes one image (docs/bodies.md);
    workers and devices divide them. With --motion clusters record one after the other.
    """
    if not scenery.meshes and moving.motion is None:
        raise opt.wrong_usage("MESH", "expected a mesh file, or --motion with a hand")
    inputs, clusters = opt.files_of(scenery, radar, moving), radar.clusters()
    several, still = len(clusters) > 1, moving.motion is None
    if opt.given(processes) and not (still and several):
        wanted = "without --motion" if several else "an --array of clusters with it"
        raise opt.wrong_usage(next(iter(opt.given(processes))), f"expected {wanted}")
    check_output(output, moving, several, inputs, force=force)
    motion = None if moving.motion is None else cl.read_motion(moving.motion)
    if motion is not None:
        inputs += motion.files[1:]
        check_output(output, moving, several, inputs, force=force)  # they are known only now
    kind = scenery.estimator(estimator.estimator)
    if kind == opt.PHYSICAL and scenery.has_alpha:
        warn(f"--alpha: not used by --estimator {kind}; --material has the roughness")
    settings = simulation.settings(seed=estimator.seed, estimator=kind)
    scene, waveform = scenery.load() if motion is None else None, radar.waveform()
    bodies = {} if motion is None else scenery.bodies_by_name()
    where = processes.where(device, inputs)
    opened, label = where.first, where.first.info.label
    if len(where.infos) > 1 and not (several and still):
        warn(f"--device: only clusters are divided; simulated on the first, {label}")
    origin, start_s = provenance(inputs), perf_counter()
    if motion is not None:
        alpha = scenery.default_alpha
        scenes = motion.scene(bodies, finish=scenery.finished, alpha=alpha, device=opened)
        movement = made.Movement(
            motion, scenes, clusters, waveform, settings, moving.rate_hz, opened
        )
        text = movement.write(output, moving.frames, origin, force=force)
    elif scene is not None and several:
        settings = settings.for_scene(scene, clusters[0], waveform)  # one for all: images add up
        steps = made.ClusterSteps(
            scene=scenery, digest=made.keep_scene(scene), waveform=waveform, settings=settings,
            folder=output, origin=origin,
        )  # fmt: skip
        text, label = made.simulate_clusters(steps, clusters, where, force=force), where.text
    elif scene is not None:
        with progress_bar("tracing") as progress:
            capture = cl.simulate(
                scene, clusters[0], waveform, settings=settings, device=opened, progress=progress
            )
        text = made.summary(save(output, capture, origin, force=force))
    print_line(f"{output}: {text}, {perf_counter() - start_s:.1f} s on {label}")


def check_output(
    output: Path, moving: MotionOptions, several: bool, inputs: Sequence[Path], *, force: bool
) -> None:
    """Raise unless the capture, the recording or the folder of clusters may be written."""
    if several and moving.motion is None:
        check_place_of_folder(output, made.cluster_files(output), inputs)
    elif several or moving.frames is not None:
        check_folder(output, force=force, replaced=made.recording_files(output), inputs=inputs)
    else:
        check_outputs([output], force=force, inputs=inputs)
