"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

from clradar.cli.console import print_line
from clradar.cli.options.common import DEVICE, FORCE, WorkerOptions
from clradar.cli.options.groups import REQUIRED, given, output_option, wrong_usage
from clradar.cli.options.measured import RadarOptions
from clradar.cli.options.scene import (
    PHYSICAL,
    EstimatorOptions,
    MotionOptions,
    SceneOptions,
    SimulationOptions,
)
from clradar.cli.outputs import provenance
from clradar.cli.simulations import (
    ClusterSteps,
    MotionRecording,
    check_output,
    keep_scene,
    simulate_clusters,
    simulate_one,
)
from clradar.errors import warn
from clradar.jobs import open_devices


def command(
    scenery: SceneOptions,
    moving: MotionOptions,
    output: Path = output_option(
        "Capture to write (HDF5); with --frames the folder of a recording to make, of clusters "
        "that of their captures, which is resumed if begun.",
        REQUIRED,
    ),
    *,
    simulation: SimulationOptions,
    estimator: EstimatorOptions,
    radar: RadarOptions,
    processes: WorkerOptions,
    device: str | None = DEVICE,
    force: bool = FORCE,
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
        raise wrong_usage("MESH", "expected a mesh file, or --motion with a hand")
    inputs, clusters, waveform = [*scenery.files, *radar.files], radar.clusters(), radar.waveform()
    several = len(clusters) > 1
    if given(processes) and (moving.motion is not None or not several):
        wanted = "without --motion" if several else "an --array of clusters with it"
        raise wrong_usage(next(iter(given(processes))), f"expected {wanted}")
    inputs += [] if moving.motion is None else [moving.motion]
    check_output(output, moving, several, inputs, force=force)
    if (motion := moving.read()) is not None:
        inputs += motion.files[1:]
        check_output(output, moving, several, inputs, force=force)  # they are known only now
    kind = scenery.estimator(estimator.estimator)
    if kind == PHYSICAL and scenery.has_alpha:
        warn(f"--alpha: not used by --estimator {PHYSICAL}; --material has the roughness")
    settings = simulation.settings(seed=estimator.seed, estimator=kind)
    scene = scenery.load() if motion is None else None
    bodies = {} if motion is None else scenery.bodies_by_name()
    devices = open_devices(device)
    opened, label = devices.first, devices.first.info.label
    if len(devices.infos) > 1 and not (several and motion is None):
        warn(f"--device: only clusters are divided; simulated on the first, {label}")
    facts = {"array": clusters[0].name, "waveform_ghz": radar.band_ghz, **scenery.record()}
    origin = provenance("simulate", inputs, moving, **facts)
    start_s = perf_counter()
    if motion is not None:
        scenes = motion.scene(
            bodies, finish=scenery.finished, alpha=scenery.default_alpha, device=opened
        )
        recording = MotionRecording(motion, scenes, clusters, waveform, settings, moving.rate_hz)
        text = recording.write(output, moving.frames, origin, opened, force=force)
    elif scene is not None and several:
        settings = settings.for_scene(scene, clusters[0], waveform)  # one for all: images add up
        steps = ClusterSteps(
            scene=scenery, digest=keep_scene(scene), waveform=waveform, settings=settings,
            folder=output, origin=origin,
        )  # fmt: skip
        simulate_clusters(steps, clusters, processes.where(device, inputs), force=force)
        text, label = f"{len(clusters)} clusters", devices.text
    elif scene is not None:
        radar_of = (clusters[0], waveform)
        text = simulate_one(output, scene, radar_of, settings, opened, origin, force=force)
    print_line(f"{output}: {text}, {perf_counter() - start_s:.1f} s on {label}")
