"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import clradar as cl
from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.common import DEVICES, FORCE
from clradar.cli.options.groups import REQUIRED, given, output_option, wrong_usage
from clradar.cli.options.measured import RadarOptions
from clradar.cli.options.scene import (
    PHYSICAL,
    ClusterOptions,
    EstimatorOptions,
    MotionOptions,
    SceneOptions,
    SimulationOptions,
)
from clradar.cli.outputs import provenance, save
from clradar.cli.parse import chosen_frames
from clradar.cli.simulations import (
    ClusterSteps,
    MotionRecording,
    check_output,
    keep_scene,
    simulate_clusters,
    summary,
)
from clradar.errors import warn
from clradar.jobs import open_devices


def command(
    scenery: SceneOptions,
    moving: MotionOptions,
    output: Path = output_option(
        REQUIRED,
        "Capture to write (HDF5); with --frames the folder of a recording to make, of clusters "
        "that of their captures, which is resumed if begun.",
    ),
    *,
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
    from clradar.motion.motion_file import read_motion

    if not scenery.meshes and moving.motion is None:
        raise wrong_usage("MESH", "expected a mesh file, or --motion with a hand")
    inputs, clusters, waveform = [*scenery.files, *radar.files], radar.clusters(), radar.waveform()
    inputs += [] if moving.motion is None else [moving.motion]
    several, numbers = len(clusters) > 1, range(1, len(clusters) + 1)
    if several and moving.motion is None:
        chosen = chosen_frames(divided.clusters, numbers, "--clusters")
    else:
        for name in given(divided):
            words = "without --motion" if several else "an --array of clusters with it"
            raise wrong_usage(name, f"expected {words}")
    check_output(output, moving, several, inputs, force=force)
    motion = None
    if moving.motion is not None:
        motion = read_motion(moving.motion)
        inputs += motion.files[1:]
        check_output(output, moving, several, inputs, force=force)  # they are known only now
    kind = scenery.estimator(estimator.estimator)
    if kind == PHYSICAL and scenery.has_alpha:
        warn(f"--alpha: not used by --estimator {PHYSICAL}; --material has the roughness")
    settings = simulation.settings(seed=estimator.seed, estimator=kind)
    # Meshes that cannot be read are said before their content is part of the record.
    scene = scenery.load() if motion is None else None
    bodies = {} if motion is None else scenery.bodies_by_name()
    devices = open_devices(device)
    opened = devices.first
    if len(devices.infos) > 1 and not (several and motion is None):
        warn(f"--device: only clusters are divided; simulated on the first, {opened.info.label}")
    facts = {"array": clusters[0].name, "waveform_ghz": radar.band_ghz}
    origin = provenance("simulate", inputs, moving, **scenery.record(), **facts)
    start_s, label = perf_counter(), opened.info.label
    if motion is not None:
        moved = motion.scene(
            bodies, finish=scenery.finished, alpha=scenery.default_alpha, device=opened
        )
        recording = MotionRecording(motion, moved, clusters, waveform, settings, moving.rate_hz)
        with progress_bar("simulating") as progress:
            words = recording.write(output, moving.frames, origin, opened, progress, force=force)
    elif several and scene is not None:
        settings = settings.for_scene(scene, clusters[0], waveform)  # one for all: images add up
        steps = ClusterSteps(
            scene=scenery, digest=keep_scene(scene), waveform=waveform, settings=settings,
            folder=output, origin=origin,
        )  # fmt: skip
        items = [(i, clusters[i - 1]) for i in chosen]
        simulate_clusters(steps, items, divided.where(device, inputs), force=force)
        words, label = f"{len(chosen)} of {len(clusters)} clusters", devices.text
    elif scene is not None:
        with progress_bar("tracing") as progress:
            capture = cl.simulate(
                scene, clusters[0], waveform, settings=settings, device=opened, progress=progress
            )
        save(output, capture, origin, force=force)
        words = summary(capture)
    print_line(f"{output}: {words}, {perf_counter() - start_s:.1f} s on {label}")
