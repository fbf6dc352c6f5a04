"""Simulated captures: of clusters one by one, and of scenes that move; what they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli import options as opt
from clradar.cli.console import counted, print_line, progress_bar
from clradar.cli.outputs import (
    begun,
    check_folder,
    check_outputs,
    described,
    joints_record,
    provenance,
    save,
    whole_folder,
    write,
)
from clradar.errors import MeshError, warn
from clradar.jobs import KEY, Where
from clradar.model.progress import Progress, part_of

if TYPE_CHECKING:
    from clradar.motion.motion_record import Motion

# Names in the folder of clusters, and beside the frames of a recording.
CLUSTER_NAME = "cluster_{:03d}"  # capture or recording of a cluster, counted from 1
PATTERN = "cluster_*.h5"
TRUTH = "truth"  # what a recording was made of

Item = tuple[int, "cl.AntennaArray"]

_scenes: dict[str, cl.Scene] = {}
"""The scene that this process simulates, by its digest."""


def check_output(output: Path, moving: opt.MotionOptions, several: bool) -> None:
    """Raise unless the capture, the recording or the folder of clusters may be written."""
    if several and moving.motion is None:
        check_folder(output, cluster_files(output), resumed=True)
    elif several or moving.frames is not None:
        check_folder(output, recording_files(output))
    else:
        check_outputs([output])


def cluster_files(folder: Path) -> list[str]:
    """What --force replaces in a folder: also clusters of an earlier array of more of them."""
    return [KEY, *sorted(path.name for path in folder.glob(PATTERN))]


def recording_files(folder: Path) -> list[str]:
    """What a recording of this command replaces in a folder."""
    found = [*folder.glob("radar_*"), *folder.glob("cluster_*")]
    return [TRUTH, *(path.name for path in found)]


def keep_scene(scene: cl.Scene) -> str:
    """Have this process simulate a scene that it has read; return its digest."""
    _scenes.clear()
    digest = scene.digest()
    _scenes[digest] = scene
    return digest


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
        save(self.file_of(number), capture, self.origin)
        return summary(capture)

    def file_of(self, number: int) -> Path:
        """The capture of a cluster."""
        return self.folder / f"{CLUSTER_NAME.format(number)}.h5"


def simulate_clusters(
    steps: ClusterSteps, clusters: Sequence[cl.AntennaArray], where: Where
) -> str:
    """Make the captures of clusters that are not there yet; return how many there are."""
    job = begun(
        steps.folder, "simulation of clusters", cluster_files(steps.folder), PATTERN,
        settings=asdict(steps.settings),
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


def record_movement(
    output: Path,
    motion: Motion,
    scene: cl.MovingScene,
    clusters: Sequence[cl.AntennaArray],
    waveform: cl.Waveform,
    moving: opt.MotionOptions,
    **how: Any,
) -> str:
    """Write a capture of what moves, or a recording, or a folder of clusters; return what it is."""
    from measurement_io import save_recording

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
                write(folder / f"{name}.h5", next(captures(number)))
                continue
            own = folder / name if several else folder
            frames = (described(capture, provenance()) for capture in captures(number))
            save_recording(own, frames, timestamps_us=stamps_us, force=True)
            (own / TRUTH).mkdir()
            middle_s = 0.5 * (timing.begin_s + timing.end_s)
            truth = [
                {"frame": i, "timestamp_us": stamp, **_truth(motion, scene, start_s + middle_s)}
                for i, (start_s, stamp) in enumerate(zip(starts_s, stamps_us, strict=True))
            ]
            write(own / TRUTH / "truth.json", {"frames": truth})

    with progress_bar("simulating") as progress:
        if n_frames is None and not several:
            write(output, next(captures(0)))
        else:
            with whole_folder(output, recording_files(output)) as folder:
                made_into(folder)
    text = f"{n_frames} frames, sweeps" if n_frames is not None else "a sweep"
    text += f" of {1e3 * sweep_s:.3g} ms"
    if n_frames is None and not several:
        text += f", simulated at {counted(movements[0].get('instants', 1), 'instant')}"
    if errors_db := [one["sample_error_db"] for one in movements if one.get("sample_error_db")]:
        text += f", samples right to {max(errors_db):.0f} dB"
    return text + (f", {len(clusters)} clusters" if several else "")


def _truth(motion: Motion, scene: cl.MovingScene, middle_s: float) -> dict[str, Any]:
    """Where everything is in the middle of a sweep."""
    hands = [
        {
            "pose": body.pose(middle_s).name,
            "transform": body.transform(middle_s).tolist(),
            "joints_m": joints_record(body.joints_m(middle_s)),
        }
        for body in scene.bodies
        if isinstance(body, cl.MovingHand)
    ]
    bodies = {name: m.at(middle_s).tolist() for name, m in motion.bodies.items()}
    return {"middle_s": middle_s, "bodies": bodies, "hands": hands}
