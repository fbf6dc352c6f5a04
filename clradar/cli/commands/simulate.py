"""Captures of meshes, of clusters one by one, of what moves: ``simulate`` and ``demo``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import clradar as cl
import measurement_io
from clradar.cli import console, images as img, options as opt, outputs as out
from clradar.errors import warn
from clradar.jobs import KEY, open_devices
from clradar.jobs.lock import made_folder
from clradar.model import checks
from clradar.model.progress import Progress, part_of

if TYPE_CHECKING:
    from clradar.motion.motion_file import Motion


# Names in the folder of clusters, and beside the frames of a recording.
CLUSTER_NAME = "cluster_{:03d}"  # capture or recording of a cluster, counted from 1
PATTERN = "cluster_*.h5"
TRUTH = "truth"  # what a recording was made of

Item = tuple[int, "cl.AntennaArray"]


def cluster_files(folder: Path) -> list[str]:
    """What --force replaces in a folder: also clusters of an earlier array of more of them."""
    return [KEY, *sorted(path.name for path in folder.glob(PATTERN))]


def recording_files(folder: Path) -> list[str]:
    """What a recording of this command replaces in a folder."""
    found = [*folder.glob("radar_*"), *folder.glob("cluster_*")]
    return [TRUTH, *(path.name for path in found)]


def simulate_cluster(
    scene: cl.Scene,
    waveform: cl.Waveform,
    settings: cl.SimulationSettings,
    folder: Path,
    origin: Mapping[str, Any],
    item: Item,
    device: cl.Device,
    progress: Progress,
) -> str:
    """Simulate a cluster, write its capture, and return what it is."""
    number, array = item
    capture = cl.simulate(
        scene, array, waveform, settings=settings, device=device, progress=progress
    )
    out.save(cluster_file(folder, number), capture, origin)
    return summary(capture)


def cluster_file(folder: Path, number: int) -> Path:
    return folder / f"{CLUSTER_NAME.format(number)}.h5"


def summary(capture: cl.Capture) -> str:
    """What a simulated capture is."""
    rays, settings = capture.meta["rays"], capture.meta["settings"]
    shape = " x ".join(str(n) for n in capture.data.shape)
    if settings["estimator"] == opt.PHYSICAL:
        materials = ", ".join(own["name"] for own in capture.meta["scene"]["materials"])
        points = f"{rays['samples']} points of which {capture.meta['kirchhoff']['lit']} are seen"
        return f"{shape} S-parameters of {materials}, {points}"
    if settings["estimator"] == "expected":
        density = settings["samples_per_mm2"]
        each = "" if density is None else f" ({density:.3g} per mm^2)"
        return (
            f"{shape} by the expected estimator, without shot noise at any range: "
            f"{rays['samples']} samples{each}, {rays['paths']} expected receptions"
        )
    radius_mm = 1e3 * settings["reception_radius_m"]
    return (
        f"{shape} by random rays within {radius_mm:g} mm of an Rx: {rays['samples']} samples, "
        f"{rays['outgoing']} rays of which {rays['paths']} reached an Rx, "
        f"{100 * rays['absorbed_share']:.1f} % absorbed"
    )


def record_movement(
    output: Path,
    motion: Motion,
    scene: cl.MovingScene,
    clusters: Sequence[cl.AntennaArray],
    waveform: cl.Waveform,
    moving: MotionOptions,
    **how: Any,
) -> str:
    """Write a capture of what moves, or a recording, or a folder of clusters; return what it is."""
    several, n_frames = len(clusters) > 1, moving.frames
    timings = motion.timings(clusters, waveform)
    sweep_s = max(t.end_s for t in timings) - min(t.begin_s for t in timings)
    if n_frames is not None and n_frames > 1 and sweep_s * moving.rate_hz > 1.0:
        warn(
            f"a sweep takes {1e3 * sweep_s:.3g} ms, longer than the "
            f"{1e3 / moving.rate_hz:.3g} ms between frames; lower --rate-hz, or give shorter "
            "times in the motion file"
        )
    starts_s = [i / moving.rate_hz for i in range(n_frames or 1)]
    stamps_us = [round(1e6 * start_s) for start_s in starts_s]
    movements: list[Mapping[str, Any]] = []

    def captures(number: int) -> Iterator[cl.Capture]:
        """The frames of a cluster."""
        total = len(starts_s) * len(clusters)
        for i, (start_s, stamp_us) in enumerate(zip(starts_s, stamps_us, strict=True)):
            before = number * len(starts_s) + i
            capture = cl.simulate_moving(
                scene, clusters[number], waveform, timing=timings[number], start_s=start_s,
                progress=part_of(progress, before / total, (before + 1) / total), **how,
            )  # fmt: skip
            movements.append(capture.meta["movement"])
            yield replace(capture, meta={**capture.meta, "frame": i, "timestamp_us": stamp_us})

    def made_into(folder: Path) -> None:
        for number, timing in enumerate(timings):
            name = CLUSTER_NAME.format(number + 1)
            if n_frames is None:
                out.write(folder / f"{name}.h5", next(captures(number)))
                continue
            own = folder / name if several else folder
            frames = (out.described(capture, out.provenance()) for capture in captures(number))
            measurement_io.save_recording(own, frames, timestamps_us=stamps_us, force=True)
            (own / TRUTH).mkdir()
            middle_s = 0.5 * (timing.begin_s + timing.end_s)
            truth = [
                {"frame": i, "timestamp_us": stamp, **_truth(motion, scene, start_s + middle_s)}
                for i, (start_s, stamp) in enumerate(zip(starts_s, stamps_us, strict=True))
            ]
            out.write(own / TRUTH / "truth.json", {"frames": truth})

    with console.bar("simulating") as progress:
        if n_frames is None and not several:
            out.write(output, next(captures(0)))
        else:
            with out.whole_folder(output, recording_files(output)) as folder:
                made_into(folder)
    text = f"{n_frames} frames, sweeps" if n_frames is not None else "a sweep"
    text += f" of {1e3 * sweep_s:.3g} ms"
    if n_frames is None and not several:
        text += f", simulated at {console.counted(movements[0].get('instants', 1), 'instant')}"
    if errors_db := [one["sample_error_db"] for one in movements if one.get("sample_error_db")]:
        text += f", samples right to {max(errors_db):.0f} dB"
    return text + (f", {len(clusters)} clusters" if several else "")


def _truth(motion: Motion, scene: cl.MovingScene, middle_s: float) -> dict[str, Any]:
    """Where everything is in the middle of a sweep."""
    from calibration.hand_fit.result import by_joint

    hands = [
        {
            "pose": body.pose(middle_s).name,
            "transform": body.transform(middle_s).tolist(),
            "joints_m": by_joint(body.joints_m(middle_s)),
        }
        for body in scene.bodies
        if isinstance(body, cl.MovingHand)
    ]
    bodies = {name: m.at(middle_s).tolist() for name, m in motion.bodies.items()}
    return {"middle_s": middle_s, "bodies": bodies, "hands": hands}


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    motion: Path | None = opt.option(
        "How meshes and hands move, and when each sample is recorded (docs/movement.md).",
        metavar="MOTION.toml",
    )
    frames: int | None = opt.option(
        "Make a recording of so many frames.", needs="--motion", min=1, max=10_000
    )
    rate_hz: float = opt.option(
        "Frames per second, from time 0 on.", 8.0, needs="--motion", check=checks.positive
    )


def simulate_command(
    scenery: opt.SceneOptions,
    moving: MotionOptions,
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
    kept = cluster_files(output) if several and still else recording_files(output)
    check: Callable[[], None] = partial(out.check_folder, output, kept, resumed=several and still)
    if not several and moving.frames is None:
        check = partial(out.check_outputs, [output])
    check()
    motion = None if moving.motion is None else cl.read_motion(moving.motion)
    if motion is not None:
        opt.call.inputs["--motion"] = list(motion.files)
        opt.call.records_of(motion.files)
        check()  # they are known only now
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
        text = record_movement(
            output, motion, scenes, clusters, waveform, moving, settings=settings, device=opened
        )
    elif scene is not None and several:
        settings = settings.for_scene(scene, clusters[0], waveform)  # one for all: images add up
        work = partial(simulate_cluster, scene, waveform, settings, output, out.provenance())
        job = out.begun(
            output, "simulation of clusters", cluster_files(output), PATTERN,
            settings=asdict(settings),
        )  # fmt: skip
        with job.held(), console.bar("tracing") as progress:
            for (number, _), text in job.each(
                work, list(enumerate(clusters, start=1)), where,
                done=lambda one: cluster_file(output, one[0]).is_file(),
                name=lambda one: f"cluster {one[0]}: ", progress=progress, say=console.line,
                noun="cluster",
            ):  # fmt: skip
                console.line(f"{cluster_file(output, number)}: {text}")
        text, label = f"{len(clusters)} clusters", where.text
    elif scene is not None:
        with console.bar("tracing") as progress:
            capture = cl.simulate(
                scene, clusters[0], waveform, settings=settings, device=opened, progress=progress
            )
        text = summary(out.write(output, capture))
    console.line(f"{output}: {text}, {perf_counter() - start_s:.1f} s on {label}")


TURN_DEG = 25.0
"""At 0 the palm is a mirror, which outshines the fingers by about 15 dB at alpha 0; from
atan(7 / 30), 13 degrees, on it glints past the aperture's edge."""

MEASUREMENT, SNR_DB = "measurement", 20.0


def demo_command(
    *,
    output: Path = opt.output_option(
        "Folder to make, or an empty one.", Path("demo"), metavar="DIR", folder=True
    ),
    full: bool = opt.option("The paper's volume: 201 x 201 x 81 voxels of 1 mm.", False),
    radar: opt.RadarOptions,
    device: str | None = opt.DEVICE,
    force: bool = opt.option("Write into a folder that holds files already.", False),
) -> None:
    """The letter F at alpha 0, 0.5 and 1, and of the materials palm and skin, is compared with a
    synthetic measurement: those materials, another seed, noise at an SNR of 20 dB, written and read
    in the file format of the instrument. The hand is turned by 25 degrees, so that the palm does
    not outshine the fingers.
    """
    radar.antennas()  # wrong usage is reported before anything is made
    out.check_folder(output)
    opened = open_devices(device).first
    voxel_m = 1e-3 if full else 2e-3
    grid = cl.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), voxel_m)
    console.line(f"device: {opened.info.label}")
    console.line(f"grid: {opt.grid_text(grid)}; --full has 1 mm")
    with made_folder(output):
        run_demo(output, radar, grid, opened)


def run_demo(
    folder: Path, radar: opt.RadarOptions, grid: cl.VoxelGrid, device: cl.Device, **rays: Any
) -> None:
    """Write the files of the demonstration over those of an earlier one; `rays` over alpha."""
    from clradar.hand.mesh import DEFAULT_CENTER_M

    mesh, physical = folder / "hand_f.ply", {"estimator": opt.PHYSICAL}
    out.write(
        mesh,
        out.turned(cl.hand.hand_mesh("F", device=device), TURN_DEG, DEFAULT_CENTER_M),
        force=True,
    )
    scene = cl.Scene.from_mesh(mesh)  # as `clradar simulate` has it
    skin = scene.with_material({p: "palm" if p == "palm" else "skin" for p in cl.hand.PART_NAMES})
    opt.call.inputs["hand"] = [mesh]
    how: dict[str, Any] = {"force": True, "rays": rays, "grid": opt.grid_text(grid)}
    simulated: dict[str, Any] = {
        MEASUREMENT: (skin, physical, 1),
        **{f"alpha_{a:g}": (scene.with_alpha(a), rays, 0) for a in (0.0, 0.5, 1.0)},
        opt.PHYSICAL: (skin, physical, 0),
    }
    volumes = []
    for name, (surface, settings, seed) in simulated.items():
        start_s = perf_counter()
        with console.bar(f"simulating {name}") as progress:
            capture = cl.simulate(
                surface, radar.antennas(), radar.waveform(), seed=seed, device=device,
                progress=progress, **settings,
            )  # fmt: skip
        if name == MEASUREMENT:
            noisy = cl.impair(capture, seed=2, snr_db=SNR_DB)
            measurement_io.save_recording(folder / name, [noisy], force=True)
            capture = measurement_io.open_capture(folder / name)
        else:
            capture = out.write(folder / f"{name}.h5", capture, **how)
        with console.bar(f"imaging {name}") as progress:
            image = cl.backproject(capture, grid, device=device, progress=progress)
        volumes.append(out.write(folder / f"{name}_volume.h5", image, **how))
        console.line(f"{name}: simulated and imaged in {perf_counter() - start_s:.1f} s")
    first, *paths = (Path(f"{name}_volume.h5") for name in simulated)
    compared = img.Comparison(volumes, img.figure_labels(paths, [v.meta for v in volumes[1:]]))
    found = {"measured": str(first), "simulated": compared.records(paths)}
    out.write(folder / "metrics.json", {**found, "device": device.describe()}, **how)
    compared.print()
    figure = partial(compared.figure, measured_label="Synthetic measurement")
    text = "the synthetic measurement beside the simulated images"
    out.write(folder / "comparison.png", figure, text, force=True)
