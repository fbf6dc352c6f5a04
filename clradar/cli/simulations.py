"""Meshes of a command line, and the folders of their simulations: of clusters, of what moves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
from clradar.cli.console import print_line, progress_bar
from clradar.cli.options.scene import (
    CLUSTER_NAME,
    TRUTH,
    MaterialOptions,
    replaced_in,
    with_part_alphas,
)
from clradar.cli.outputs import check_place_of_folder, save, whole_folder
from clradar.cli.recording_conversion import described
from clradar.errors import MeshError, warn
from clradar.files.json_file import write_json
from clradar.jobs import Job, Where
from clradar.jobs.job import KEY

if TYPE_CHECKING:
    import numpy as np

    from clradar.model.progress import Progress
    from clradar.motion.motion_file import Motion


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeshScene:
    """Files that make up a scene, and how: plain values that a worker process gets."""

    meshes: Sequence[tuple[Path, float | None]]
    alpha: float
    alpha_of_parts: dict[str, float]
    unit: str
    transform: np.ndarray | None
    materials: MaterialOptions

    def load(self) -> cl.Scene:
        """Read the files."""
        scene = load_scene(self.meshes, self.alpha, self.alpha_of_parts, self.unit, self.transform)
        return self.materials.on(scene)


def load_scene(
    meshes: Sequence[tuple[Path, float | None]],
    default: float,
    by_part: dict[str, float],
    unit: str,
    transform: Any,
) -> cl.Scene:
    """All meshes as one scene."""

    scene = cl.Scene.combine(
        cl.Scene.from_mesh(path, alpha=default if a is None else a, unit=unit, transform=transform)
        for path, a in meshes
    )
    return with_part_alphas(scene, by_part)


PATTERN = "cluster_*.h5"

Item = tuple[int, "cl.AntennaArray"]

_scenes: dict[str, cl.Scene] = {}
"""The scene that this process simulates, by its digest."""


def keep_scene(scene: cl.Scene) -> str:
    """Have this process simulate a scene that it has read; return its digest."""
    _scenes.clear()
    digest = scene.digest()
    _scenes[digest] = scene
    return digest


def capture_name(number: int) -> str:
    """The file of a cluster, counted from 1."""
    return f"cluster_{number:03d}.h5"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterSteps:
    """What is done with a cluster, as plain values that a worker process gets."""

    scene: MeshScene
    digest: str
    waveform: cl.Waveform
    settings: cl.SimulationSettings
    folder: Path
    origin: Mapping[str, Any]
    device: cl.Device | str | None = None

    def run(self, item: Item, progress: Progress | None = None) -> str:
        """Simulate a cluster, write its capture, and return it in words."""

        number, array = item
        capture = cl.simulate(
            self._scene(), array, self.waveform,
            settings=self.settings, device=self.device, progress=progress,
        )  # fmt: skip
        save(self.folder / capture_name(number), capture, self.origin, force=True)
        return summary(capture)

    def _scene(self) -> cl.Scene:
        if self.digest not in _scenes:
            scene = self.scene.load()
            if keep_scene(scene) != self.digest:
                names = ", ".join(str(path) for path, _ in self.scene.meshes)
                raise MeshError(f"{names}: changed while clusters were simulated")
        return _scenes[self.digest]


def simulate_clusters(
    steps: ClusterSteps, clusters: Sequence[Item], where: Where, *, force: bool
) -> None:
    """Make the captures of clusters, given with their numbers, that are not there yet."""
    folder, origin = steps.folder, steps.origin
    inputs = {f"{i} {one['file']}": one["sha256"] for i, one in enumerate(origin["inputs"])}
    key = {
        **origin["options"], "settings": asdict(steps.settings), "inputs": inputs,
        "clradar": origin["clradar"],
    }  # fmt: skip
    job = Job(
        folder=folder, work="simulation of clusters", key=key, own=own_names(folder), force=force,
        resumable=lambda folder: any(folder.glob(PATTERN)),
    )  # fmt: skip
    with job.held(), progress_bar("tracing") as progress:
        for (number, _), words in job.each(
            steps, clusters, where, done=lambda one: (folder / capture_name(one[0])).is_file(),
            name=lambda one: f"cluster {one[0]}: ", progress=progress, say=print_line,
            noun="cluster",
        ):  # fmt: skip
            print_line(f"{folder / capture_name(number)}: {words}")


def own_names(folder: Path) -> list[str]:
    """What --force replaces in a folder: also clusters of an earlier array of more of them."""
    return [KEY, *sorted(path.name for path in folder.glob(PATTERN))]


def check_clusters_folder(folder: Path, inputs: Sequence[Path]) -> None:
    """Raise unless there is or may be such a folder, with no input where it is written."""
    check_place_of_folder(folder, own_names(folder), inputs)


def summary(capture: cl.Capture) -> str:
    """A simulated capture in words."""
    rays, settings = capture.meta["rays"], capture.meta["settings"]
    shape = " x ".join(str(n) for n in capture.data.shape)
    estimator = settings["estimator"]
    if estimator == "physical":
        materials = ", ".join(own["name"] for own in capture.meta["scene"]["materials"])
        lit = capture.meta["kirchhoff"]["lit"]
        points = f"{rays['samples']} points of which {lit} are seen"
        return f"{shape} S-parameters of {materials}, {points}"
    if estimator == "expected":
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


_STEPS = 1000
"""Of the progress of a frame."""


@dataclass(frozen=True, slots=True)
class MotionRecording:
    """What a recording is simulated from; of several clusters each has its own."""

    motion: Motion
    moving: cl.MovingScene
    clusters: Sequence[cl.AntennaArray]
    waveform: cl.Waveform
    settings: cl.SimulationSettings
    rate_hz: float

    def write(
        self,
        output: Path,
        n_frames: int | None,
        origin: Mapping[str, Any],
        device: cl.Device,
        progress: Progress | None,
        *,
        force: bool,
    ) -> str:
        """Write a capture, or `n_frames` as a recording, whole or not at all; return it in words.

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
        if n_frames is None and not several:
            (capture,) = self._captures(0, 1, timings[0], device, progress)
            save(output, capture, origin, force=force)
            instants = capture.meta["movement"].get("instants", 1)
            times = "1 instant" if instants == 1 else f"{instants} instants"
            return f"a sweep of {1e3 * sweep_s:.3g} ms, simulated at {times}"
        words = f"{n_frames} frames, sweeps" if n_frames is not None else "a sweep"
        words += f" of {1e3 * sweep_s:.3g} ms"
        if several:
            words += f", {len(self.clusters)} clusters"
        stamps_us = [round(1e6 * self._start_s(i)) for i in range(n_frames or 1)]
        with whole_folder(output, force=force, replaced=replaced_in(output)) as made:
            for number, timing in enumerate(timings):
                captures = self._captures(number, len(stamps_us), timing, device, progress)
                name = CLUSTER_NAME.format(number + 1)
                if n_frames is None:
                    save(made / f"{name}.h5", next(captures), origin, force=False)
                    continue
                folder = made / name if several else made
                described_frames = (described(capture, origin) for capture in captures)
                save_recording(folder, described_frames, timestamps_us=stamps_us, force=True)
                (folder / TRUTH).mkdir()
                truth = {"frames": self._truth(stamps_us, timing), **origin}
                write_json(folder / TRUTH / "truth.json", truth, force=False)
        return words

    def _start_s(self, frame: int) -> float:
        return frame / self.rate_hz

    def _captures(
        self,
        number: int,
        n_frames: int,
        timing: cl.SweepTiming,
        device: cl.Device,
        progress: Progress | None,
    ) -> Iterator[cl.Capture]:
        """The frames of one cluster."""

        total = n_frames * len(self.clusters)
        for i in range(n_frames):

            def show(done: int, of: int, i: int = i) -> None:
                if progress is not None:
                    before = number * n_frames + i
                    progress(before * _STEPS + _STEPS * done // of, total * _STEPS)

            capture = cl.simulate_moving(
                self.moving, self.clusters[number], self.waveform, timing=timing,
                start_s=self._start_s(i), settings=self.settings, device=device, progress=show,
            )  # fmt: skip
            stamp_us = round(1e6 * self._start_s(i))
            yield replace(capture, meta={**capture.meta, "frame": i, "timestamp_us": stamp_us})

    def _truth(self, stamps_us: list[int], timing: cl.SweepTiming) -> list[dict[str, Any]]:
        """Where everything is in the middle of each sweep."""
        from clradar.cli.sweeps import joints_record
        from clradar.motion.hands import MovingHand

        frames = []
        hands = [body for body in self.moving.bodies if isinstance(body, MovingHand)]
        for i, stamp_us in enumerate(stamps_us):
            middle_s = self._start_s(i) + 0.5 * (timing.begin_s + timing.end_s)
            bodies = {name: m.at(middle_s).tolist() for name, m in self.motion.bodies.items()}
            frames.append(
                {
                    "frame": i,
                    "timestamp_us": stamp_us,
                    "middle_s": middle_s,
                    "bodies": bodies,
                    "hands": [
                        {
                            "pose": hand.pose(middle_s).name,
                            "transform": hand.transform(middle_s).tolist(),
                            "joints_m": joints_record(hand.joints_m(middle_s)),
                        }
                        for hand in hands
                    ],
                }
            )
        return frames
