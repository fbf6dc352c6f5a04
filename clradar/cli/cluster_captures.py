"""The folder of ``clradar simulate`` of clusters: a capture of each, made once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.console import counted, print_line, print_warning, progress_bar
from clradar.cli.mesh_scene import MeshScene
from clradar.cli.on_workers import each_on_workers, outcome_of
from clradar.cli.outputs import check_place_of_folder, save
from clradar.cli.resumable import SETTINGS, begin_work, cleared_on_failure
from clradar.errors import ClradarError, MeshError
from clradar.files import work_folder
from clradar.opencl import open_devices

if TYPE_CHECKING:
    from clradar import AntennaArray, Capture, Device, Scene, SimulationSettings, Waveform
    from clradar.model.progress import Progress

PATTERN = "cluster_*.h5"

Item = tuple[int, "AntennaArray"]

_scenes: dict[str, Scene] = {}
"""The scene that this process simulates, by its digest."""


def keep_scene(scene: Scene) -> str:
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
    """What is done with a cluster, as plain values that a worker process gets.

    Attributes
    ----------
    scene : MeshScene
    digest : str
        Of the scene: files that change meanwhile are refused.
    waveform : Waveform
    settings : SimulationSettings
    folder : Path
    origin : mapping
        From `clradar.cli.provenance.provenance`.
    device : Device, str or None
    """

    scene: MeshScene
    digest: str
    waveform: Waveform
    settings: SimulationSettings
    folder: Path
    origin: Mapping[str, Any]
    device: Device | str | None = None

    def run(self, item: Item, progress: Progress | None = None) -> str:
        """Simulate a cluster, write its capture, and return it in words."""
        from clradar import simulate

        number, array = item
        capture = simulate(
            self._scene(), array, self.waveform,
            settings=self.settings, device=self.device, progress=progress,
        )  # fmt: skip
        save(self.folder / capture_name(number), capture, self.origin, force=True)
        return summary(capture)

    def _scene(self) -> Scene:
        if self.digest not in _scenes:
            scene = self.scene.load()
            if keep_scene(scene) != self.digest:
                names = ", ".join(str(path) for path, _ in self.scene.meshes)
                raise MeshError(f"{names}: changed while clusters were simulated")
        return _scenes[self.digest]


@dataclass(frozen=True, slots=True)
class _Cluster:
    """The steps of a cluster on a device: work of `clradar.opencl.Devices`."""

    steps: ClusterSteps

    def __call__(self, item: Item, device: Device, progress: Progress) -> Iterator[Any]:
        steps = replace(self.steps, device=device)
        yield outcome_of(lambda one: steps.run(one, progress), item)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterWork:
    """Clusters, and the folder with a capture of each.

    Attributes
    ----------
    steps : ClusterSteps
    clusters : sequence of (int, AntennaArray)
        Those to be made, with their numbers.
    workers : int or None
        Worker processes; None: in this one, or in one for each of several devices.
    device : str or None
        As of `clradar.opencl.open_devices`.
    force : bool
        Begin anew in a folder that was begun with other settings.
    """

    steps: ClusterSteps
    clusters: Sequence[Item]
    workers: int | None
    device: str | None
    force: bool

    def run(self) -> None:
        """Make the captures that are not there yet.

        Raises
        ------
        OutputError
            The folder was begun with other settings, or another process writes into it.
        """
        folder, origin = self.steps.folder, self.steps.origin
        inputs = {f"{i} {one['file']}": one["sha256"] for i, one in enumerate(origin["inputs"])}
        settings = {
            **origin["options"], "settings": asdict(self.steps.settings),
            "inputs": inputs, "clradar": origin["clradar"],
        }  # fmt: skip
        with work_folder.held(folder, "simulate"):
            own = own_names(folder)
            begin_work(folder, settings, own=own, work="captures of clusters", force=self.force)
            with cleared_on_failure(folder, own, unless=PATTERN):
                self._simulate()

    def _simulate(self) -> None:
        folder = self.steps.folder
        left = [item for item in self.clusters if not (folder / capture_name(item[0])).is_file()]
        if len(left) < len(self.clusters):
            there = counted(len(self.clusters) - len(left), "cluster")
            print_line(f"{folder}: resumes with {there} done before")
        said: set[str] = set()
        with progress_bar("tracing") as progress:
            for done, ((number, _), (outcome, warned)) in enumerate(
                self._outcomes(left, progress), start=1
            ):
                for text in warned:
                    if text not in said:
                        print_warning(f"cluster {number}: {text}")
                    said.add(text)
                if isinstance(outcome, ClradarError):
                    raise outcome
                print_line(f"{folder / capture_name(number)}: {outcome}")
                if progress is not None and self.workers is not None:
                    progress(done, len(left))

    def _outcomes(self, left: Sequence[Item], progress: Progress | None) -> Iterator[Any]:
        if not left:
            return iter(())
        if self.workers is not None:
            return each_on_workers(self.steps.run, left, self.workers, self.device)
        devices = open_devices(self.device)
        devices.check_alike("the captures of a folder")
        made = devices.made(_Cluster(self.steps), left, progress)
        return ((left[i], outcome) for i, outcome in made)


def own_names(folder: Path) -> list[str]:
    """What --force replaces in a folder: also clusters of an earlier array of more of them."""
    return [SETTINGS, *sorted(path.name for path in folder.glob(PATTERN))]


def check_clusters_folder(folder: Path, inputs: Sequence[Path]) -> None:
    """Raise unless there is or may be such a folder, with no input where it is written."""
    check_place_of_folder(folder, own_names(folder), inputs)


def summary(capture: Capture) -> str:
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
