"""``clradar simulate``: simulate what the radar would record of one or several meshes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli import options as opt
from clradar.cli import parse
from clradar.cli.console import counted, print_line, progress_bar
from clradar.cli.outputs import (
    check_folder,
    check_outputs,
    check_place_of_folder,
    described,
    joints_record,
    provenance,
    save,
    settings_of,
    whole_folder,
)
from clradar.errors import MeshError, warn
from clradar.files.json_file import write_json
from clradar.jobs import Job, Where
from clradar.jobs.job import KEY
from clradar.model.progress import Progress, part_of

if TYPE_CHECKING:
    from clradar.motion.motion_record import Motion


CLUSTER_NAME = "cluster_{:03d}"
"""Capture or recording of one cluster, counted from 1, in the folder of all."""

PATTERN = "cluster_*.h5"

TRUTH = "truth"
"""Folder beside the frames with what a recording was made of."""

Item = tuple[int, "cl.AntennaArray"]

_scenes: dict[str, cl.Scene] = {}
"""The scene that this process simulates, by its digest."""


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
        movement = Movement(motion, scenes, clusters, waveform, settings, moving.rate_hz, opened)
        text = movement.write(output, moving.frames, origin, force=force)
    elif scene is not None and several:
        settings = settings.for_scene(scene, clusters[0], waveform)  # one for all: images add up
        steps = ClusterSteps(
            scene=scenery, digest=keep_scene(scene), waveform=waveform, settings=settings,
            folder=output, origin=origin,
        )  # fmt: skip
        text, label = simulate_clusters(steps, clusters, where, force=force), where.text
    elif scene is not None:
        with progress_bar("tracing") as progress:
            capture = cl.simulate(
                scene, clusters[0], waveform, settings=settings, device=opened, progress=progress
            )
        text = summary(save(output, capture, origin, force=force))
    print_line(f"{output}: {text}, {perf_counter() - start_s:.1f} s on {label}")


def check_output(
    output: Path, moving: MotionOptions, several: bool, inputs: Sequence[Path], *, force: bool
) -> None:
    """Raise unless the capture, the recording or the folder of clusters may be written."""
    if several and moving.motion is None:
        check_place_of_folder(output, cluster_files(output), inputs)
    elif several or moving.frames is not None:
        check_folder(output, force=force, replaced=recording_files(output), inputs=inputs)
    else:
        check_outputs([output], force=force, inputs=inputs)


def keep_scene(scene: cl.Scene) -> str:
    """Have this process simulate a scene that it has read; return its digest."""
    _scenes.clear()
    digest = scene.digest()
    _scenes[digest] = scene
    return digest


def cluster_files(folder: Path) -> list[str]:
    """What --force replaces in a folder: also clusters of an earlier array of more of them."""
    return [KEY, *sorted(path.name for path in folder.glob(PATTERN))]


def recording_files(folder: Path) -> list[str]:
    """What a recording of this command replaces in a folder."""
    found = [*folder.glob("radar_*"), *folder.glob("cluster_*")]
    return [TRUTH, *(path.name for path in found)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterSteps:
    """What is done with a cluster, as plain values that a worker process gets."""

    scene: opt.SceneOptions
    digest: str
    waveform: cl.Waveform
    settings: cl.SimulationSettings
    folder: Path
    origin: Mapping[str, Any]
    device: cl.Device | str | None = None

    def run(self, item: Item, progress: Progress | None = None) -> str:
        """Simulate a cluster, write its capture, and return what it is."""
        number, array = item
        if self.digest not in _scenes and keep_scene(self.scene.load()) != self.digest:
            names = ", ".join(str(path) for path, _ in self.scene.meshes or [])
            raise MeshError(f"{names}: changed while clusters were simulated")
        capture = cl.simulate(
            _scenes[self.digest], array, self.waveform, settings=self.settings, device=self.device,
            progress=progress,
        )  # fmt: skip
        save(self.file_of(number), capture, self.origin, force=True)
        return summary(capture)

    def file_of(self, number: int) -> Path:
        """The capture of a cluster."""
        return self.folder / f"{CLUSTER_NAME.format(number)}.h5"


def simulate_clusters(
    steps: ClusterSteps, clusters: Sequence[cl.AntennaArray], where: Where, *, force: bool
) -> str:
    """Make the captures of clusters that are not there yet; return how many there are."""
    folder, origin = steps.folder, steps.origin
    inputs = {f"{i} {one['file']}": one["sha256"] for i, one in enumerate(origin["inputs"])}
    key = settings_of(origin, settings=asdict(steps.settings), inputs=inputs)
    job = Job(
        folder=folder, work="simulation of clusters", key=key, own=cluster_files(folder),
        force=force, resumable=lambda folder: any(folder.glob(PATTERN)),
    )  # fmt: skip
    with job.held(), progress_bar("tracing") as progress:
        for (number, _), text in job.each(
            steps, list(enumerate(clusters, start=1)), where,
            done=lambda one: steps.file_of(one[0]).is_file(),
            name=lambda one: f"cluster {one[0]}: ", progress=progress, say=print_line,
            noun="cluster",
        ):  # fmt: skip
            print_line(f"{steps.file_of(number)}: {text}")
    return f"{len(clusters)} clusters"


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


def _error(errors_db: list[float]) -> str:
    return f", samples right to {max(errors_db):.0f} dB" if errors_db else ""


@dataclass(frozen=True, slots=True)
class Movement:
    """What moves, and what records it; of several clusters each has its own recording."""

    motion: Motion
    moving: cl.MovingScene
    clusters: Sequence[cl.AntennaArray]
    waveform: cl.Waveform
    settings: cl.SimulationSettings
    rate_hz: float
    device: cl.Device

    def write(
        self, output: Path, n_frames: int | None, origin: Mapping[str, Any], *, force: bool
    ) -> str:
        """Write a capture, or `n_frames` as a recording, whole or not at all; return what it is.

        Of several clusters a folder of them. One frame is in memory at a time.
        """
        from measurement_io import save_recording

        timings = self.motion.timings(self.clusters, self.waveform)
        sweep_s = max(t.end_s for t in timings) - min(t.begin_s for t in timings)
        if n_frames is not None and n_frames > 1 and sweep_s * self.rate_hz > 1.0:
            warn(
                f"a sweep takes {1e3 * sweep_s:.3g} ms, longer than the "
                f"{1e3 / self.rate_hz:.3g} ms between frames; lower --rate-hz, or give shorter "
                "times in the motion file"
            )
        several = len(self.clusters) > 1
        errors_db: list[float] = []
        stamps_us = [round(1e6 * (i / self.rate_hz)) for i in range(n_frames or 1)]
        with progress_bar("simulating") as progress:
            if n_frames is None and not several:
                (capture,) = self._captures(0, stamps_us, timings[0], progress, errors_db)
                save(output, capture, origin, force=force)
                instants = counted(capture.meta["movement"].get("instants", 1), "instant")
                return f"a sweep of {1e3 * sweep_s:.3g} ms, simulated at {instants}" + _error(
                    errors_db
                )
            with whole_folder(output, force=force, replaced=recording_files(output)) as made:
                for number, timing in enumerate(timings):
                    captures = self._captures(number, stamps_us, timing, progress, errors_db)
                    name = CLUSTER_NAME.format(number + 1)
                    if n_frames is None:
                        save(made / f"{name}.h5", next(captures), origin, force=False)
                        continue
                    folder = made / name if several else made
                    frames = (described(capture, origin) for capture in captures)
                    save_recording(folder, frames, timestamps_us=stamps_us, force=True)
                    (folder / TRUTH).mkdir()
                    known = [self._truth(i, stamp, timing) for i, stamp in enumerate(stamps_us)]
                    truth = {"frames": known, **origin}
                    write_json(folder / TRUTH / "truth.json", truth, force=False)
        text = f"{n_frames} frames, sweeps" if n_frames is not None else "a sweep"
        text += f" of {1e3 * sweep_s:.3g} ms" + _error(errors_db)
        return text + (f", {len(self.clusters)} clusters" if several else "")

    def _captures(
        self,
        number: int,
        stamps_us: list[int],
        timing: cl.SweepTiming,
        progress: Progress | None,
        errors_db: list[float],
    ) -> Iterator[cl.Capture]:
        """The frames of one cluster; how exact they are is added to `errors_db`."""
        total = len(stamps_us) * len(self.clusters)
        for i, stamp_us in enumerate(stamps_us):
            before = number * len(stamps_us) + i
            capture = cl.simulate_moving(
                self.moving, self.clusters[number], self.waveform, timing=timing,
                start_s=i / self.rate_hz, settings=self.settings, device=self.device,
                progress=part_of(progress, before / total, (before + 1) / total),
            )  # fmt: skip
            errors_db += filter(None, [capture.meta["movement"].get("sample_error_db")])
            yield replace(capture, meta={**capture.meta, "frame": i, "timestamp_us": stamp_us})

    def _truth(self, frame: int, stamp_us: int, timing: cl.SweepTiming) -> dict[str, Any]:
        """Where everything is in the middle of a sweep."""
        middle_s = frame / self.rate_hz + 0.5 * (timing.begin_s + timing.end_s)
        hands = [
            {
                "pose": body.pose(middle_s).name,
                "transform": body.transform(middle_s).tolist(),
                "joints_m": joints_record(body.joints_m(middle_s)),
            }
            for body in self.moving.bodies
            if isinstance(body, cl.MovingHand)
        ]
        bodies = {name: m.at(middle_s).tolist() for name, m in self.motion.bodies.items()}
        times = {"frame": frame, "timestamp_us": stamp_us, "middle_s": middle_s}
        return {**times, "bodies": bodies, "hands": hands}
