"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli import options as opt, simulations
from clradar.cli.console import print_line, progress_bar
from clradar.cli.outputs import provenance, write
from clradar.errors import warn


def command(
    scenery: opt.SceneOptions,
    moving: opt.MotionOptions,
    output: Path = opt.output_option(
        "Capture to write (HDF5); with --frames the folder of a recording; of clusters that of "
        "their captures, which is resumed.",
        folder=True,
    ),
    *,
    simulation: opt.SimulationOptions,
    estimator: opt.Estimator | None = opt.option(
        f"{opt.ESTIMATORS} [default: physical with --material, stochastic with rays or bounces, "
        "else expected]",
    ),
    seed: int = opt.option("Same seed, same device: same bits.", 0),
    radar: opt.RadarOptions,
    processes: opt.WorkerOptions,
    device: str | None = opt.DEVICE,
) -> None:
    """The radar is in the plane z = 0. Meshes are in its frame: x to the right of a person who
    faces the aperture, y up, z away. The parts that --alpha can name are the geometries of the
    files.

    An --array of clusters makes a folder with a capture of each, which workers and devices divide;
    `clradar image DIR/cluster_*.h5` makes one image of them (docs/bodies.md).
    """
    if not scenery.meshes and moving.motion is None:
        raise opt.wrong_usage("MESH", "expected a mesh file, or --motion with a hand")
    clusters = radar.clusters()
    several, still = len(clusters) > 1, moving.motion is None
    if opt.given(processes) and not (still and several):
        wanted = "without --motion" if several else "an --array of clusters with it"
        raise opt.wrong_usage(next(iter(opt.given(processes))), f"expected {wanted}")
    simulations.check_output(output, moving, several)
    motion = None if moving.motion is None else cl.read_motion(moving.motion)
    if motion is not None:
        opt.call.inputs["--motion"] = list(motion.files)
        opt.call.records_of(motion.files)
        simulations.check_output(output, moving, several)  # they are known only now
    kind = scenery.estimator(estimator)
    meshes = scenery.meshes or []
    has_alpha = scenery.alpha or any(alpha is not None for _, alpha in meshes)
    if kind == opt.PHYSICAL and has_alpha:
        warn(f"--alpha: not used by --estimator {kind}; --material has the roughness")
    settings = simulation.settings(seed=seed, estimator=kind)
    scene, waveform = scenery.load() if motion is None else None, radar.waveform()
    names = [path.name for path, _ in meshes]
    if motion is not None and len(set(names)) < len(names):
        raise opt.wrong_usage("MESH", "expected different names of files with --motion")
    where = processes.where(device)
    opened, label = where.first, where.first.info.label
    if len(where.infos) > 1 and not (several and still):
        warn(f"--device: only clusters are divided; simulated on the first, {label}")
    start_s = perf_counter()
    if motion is not None:
        alpha = scenery.default_alpha
        bodies = dict(zip(names, scenery.bodies(), strict=True))
        scenes = motion.scene(bodies, finish=scenery.finished, alpha=alpha, device=opened)
        text = simulations.record_movement(
            output, motion, scenes, clusters, waveform, moving, settings=settings, device=opened
        )
    elif scene is not None and several:
        settings = settings.for_scene(scene, clusters[0], waveform)  # one for all: images add up
        steps = simulations.ClusterSteps(
            scene=scenery, digest=simulations.keep_scene(scene), waveform=waveform,
            settings=settings, folder=output, origin=provenance(),
        )  # fmt: skip
        text, label = simulations.simulate_clusters(steps, clusters, where), where.text
    elif scene is not None:
        with progress_bar("tracing") as progress:
            capture = cl.simulate(
                scene, clusters[0], waveform, settings=settings, device=opened, progress=progress
            )
        text = simulations.summary(write(output, capture))
    print_line(f"{output}: {text}, {perf_counter() - start_s:.1f} s on {label}")
