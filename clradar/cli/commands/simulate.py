"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.common import DEVICES, FORCE
from clradar.cli.options.groups import REQUIRED, given, output_option, recorded, wrong_usage
from clradar.cli.options.measured import RadarOptions
from clradar.cli.options.scene import (
    PHYSICAL,
    ClusterOptions,
    EstimatorOptions,
    MaterialOptions,
    MotionOptions,
    SceneOptions,
    SimulationOptions,
    read_part_alphas,
    split_alpha,
    with_part_alphas,
)
from clradar.cli.outputs import provenance, save
from clradar.cli.parse import chosen_frames
from clradar.cli.simulations import MeshScene
from clradar.errors import warn


def command(
    scenery: SceneOptions,
    moving: MotionOptions,
    output: Path = output_option(
        REQUIRED,
        "Capture to write (HDF5); with --frames the folder of a recording to make, of clusters "
        "that of their captures, which is resumed if begun.",
    ),
    *,
    made_of: MaterialOptions,
    simulation: SimulationOptions,
    estimator: EstimatorOptions,
    radar: RadarOptions,
    divided: ClusterOptions,
    device: str | None = DEVICES,
    force: bool = FORCE,
) -> None:
    """The radar is the 94 x 94 imager with a 14 cm aperture in the plane z = 0, or that of --array.
    Meshes are in its antenna frame: x to the right of a person who faces the aperture, y up, z away
    from it.

    The parts that --alpha and --material-of can name are the geometries of the files; a wrong name
    lists them.

    With --motion the scene moves while the imager records it (docs/movement.md), and --frames makes
    a recording that every command reads.

    An --array of clusters whose Tx are measured with their own Rx only makes a folder with a
    capture of each, of which `clradar image DIR/cluster_*.h5` makes one image (docs/bodies.md).
    What is done is not done again; workers and devices divide the clusters and change no bit. With
    --motion clusters record one after the other, and --frames makes a recording of each.
    """
    from clradar.cli.simulations import (
        ClusterSteps,
        MotionRecording,
        check_clusters_folder,
        keep_scene,
        simulate_clusters,
        summary,
    )
    from clradar.jobs import open_devices

    named = [split_alpha(text) for text in scenery.meshes or []]
    if not named and moving.motion is None:
        raise wrong_usage("MESH", "expected a mesh file, or --motion with a hand")
    default, by_part = read_part_alphas(scenery.alpha or [])
    inputs = [*(path for path, _ in named), *scenery.files, *made_of.files, *radar.files]
    inputs += [] if moving.motion is None else [moving.motion]
    clusters = radar.clusters()
    several = len(clusters) > 1
    if several and moving.motion is None:
        numbers = chosen_frames(divided.clusters, range(1, len(clusters) + 1), "--clusters")
        check_clusters_folder(output, inputs)
    else:
        for name in given(divided):
            words = "without --motion" if several else "an --array of clusters with it"
            raise wrong_usage(name, f"expected {words}")
        moving.check(output, several=several, force=force, inputs=inputs)
    motion = moving.read()
    if motion is not None and len(motion.files) > 1:
        inputs += motion.files[1:]
        moving.check(output, several=several, force=force, inputs=inputs)  # they are known only now
    matrix = scenery.matrix()
    chosen = made_of.estimator(estimator.estimator)
    if chosen == PHYSICAL and (scenery.alpha or any(a is not None for _, a in named)):
        warn(f"--alpha: not used by --estimator {PHYSICAL}; --material has the roughness")
    settings = simulation.settings(seed=estimator.seed, estimator=chosen)
    # Meshes that cannot be read are said before their content is part of the record.
    meshes = MeshScene(
        meshes=named, alpha=default, alpha_of_parts=by_part, unit=scenery.unit, transform=matrix,
        materials=made_of,
    )  # fmt: skip
    bodies: dict[str, cl.Scene] = {}
    still = meshes.load() if motion is None else None
    if motion is not None:
        bodies = {
            path.name: cl.Scene.from_mesh(
                path, alpha=default if a is None else a, unit=scenery.unit, transform=matrix
            )
            for path, a in named
        }
        if len(bodies) < len(named):
            raise wrong_usage("MESH", "expected different names of files with --motion")
    antennas, waveform = clusters[0], radar.waveform()
    devices = open_devices(device)
    opened = devices.first
    if (still is None or not several) and len(devices.infos) > 1:
        warn(f"--device: only clusters are divided; simulated on the first, {opened.info.label}")
    recording = None
    if motion is not None:
        finish = lambda scene: made_of.on(with_part_alphas(scene, by_part))  # noqa: E731
        recording = MotionRecording(
            motion, motion.scene(bodies, finish=finish, alpha=default, device=opened),
            clusters, waveform, settings, moving.rate_hz,
        )  # fmt: skip
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
    if still is not None and several:
        settings = settings.for_scene(still, antennas, waveform)  # one for all, whose images add up
        steps = ClusterSteps(
            scene=meshes, digest=keep_scene(still), waveform=waveform, settings=settings,
            folder=output, origin=origin,
        )  # fmt: skip
        simulate_clusters(
            steps, [(i, clusters[i - 1]) for i in numbers], divided.where(device, inputs),
            force=force,
        )  # fmt: skip
        words = f"{len(numbers)} of {len(clusters)} clusters"
    elif still is not None:
        with progress_bar("tracing") as progress:
            capture = cl.simulate(
                still, antennas, waveform, settings=settings, device=opened, progress=progress
            )
        save(output, capture, origin, force=force)
        words = summary(capture)
    elif recording is not None:
        with progress_bar("simulating") as progress:
            words = recording.write(output, moving.frames, origin, opened, progress, force=force)
    took_s = perf_counter() - start_s
    text = devices.text if several and still is not None else opened.info.label
    print_line(f"{output}: {words}, {took_s:.1f} s on {text}")
