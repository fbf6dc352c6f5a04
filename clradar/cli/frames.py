"""The frames of ``clradar process``: where they come from, and what is done with one of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clradar.cli.inputs import ImageInput
from clradar.cli.options.common import Unit
from clradar.cli.options.groups import given, option
from clradar.cli.options.hand import AnyHandOptions, HandFitOptions, RigFileOptions, ShapeOptions
from clradar.cli.options.measured import (
    ChannelOptions,
    DepthMapOptions,
    EmptyOptions,
    ImagingOptions,
    Variant,
)
from clradar.cli.parse import ALL, FRAMES_METAVAR, chosen_frames, wrong_usage
from clradar.errors import CompareError, warn
from clradar.files.failures import fail
from clradar.files.hashing import content_record
from clradar.files.json_file import read_json_object, write_json
from clradar.jobs.job import FolderStore
from clradar.model import checks

if TYPE_CHECKING:
    from clradar import Capture, DepthMap, Device, Scene, Volume, VoxelGrid
    from clradar.model.progress import Progress


@dataclass(frozen=True, slots=True)
class Frames:
    """What is compared at each frame."""

    path: Path
    numbers: tuple[int, ...] | None
    read: Callable[[int], Capture | Volume]
    files: Callable[[int], list[Path]]
    variant: str | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Frames.open, (self.path, self.variant)  # another process opens it for itself

    @classmethod
    def open(cls, path: Path, variant: str | None = None) -> Frames:
        """A recording, a folder of captures or volumes (.h5), or a single one."""
        if not path.is_dir():
            content = ImageInput.open(path).content
            return cls(path, None, lambda _: content, lambda _: [path])
        if not any(path.glob("*.h5")) or any(path.glob("radar_*")):
            return cls._of_recording(path, variant)
        by_number = _captures_by_number(path, variant)

        def read(number: int) -> Capture | Volume:
            return ImageInput.open(by_number[number]).content

        return cls(path, tuple(by_number), read, lambda number: [by_number[number]], variant)

    @classmethod
    def _of_recording(cls, path: Path, variant: str | None) -> Frames:
        from measurement_io import open_recording
        from measurement_io.maroon.folders import ANTENNAS_FILE, frames

        recording = open_recording(path, variant=variant or "raw")
        numbers, paths = recording.frame_numbers, frames(recording.path)[recording.variant]
        antennas = recording.path / ANTENNAS_FILE
        beside = [antennas] if antennas.is_file() else []
        return cls(
            path, numbers, lambda number: recording[numbers.index(number)],
            lambda number: [paths[number], *beside], variant,
        )  # fmt: skip

    def check_frames(self, numbers: Sequence[int], recording: Path) -> None:
        """Raise unless all these frames of a recording are there, or one is the same at each."""
        missing = [n for n in numbers if self.numbers is not None and n not in self.numbers]
        if missing:
            got = f"none of number {listed(missing)}"
            fail(self.path, f"the frames of '{recording}'", got)


_FRAME = re.compile(r"([0-9]+)(?:_(emptyfiltered))?\Z")


def _captures_by_number(folder: Path, variant: str | None) -> dict[int, Path]:
    """Files of captures as `convert --all-frames` names them; other names count from 0.

    Without a variant raw ones, if there are any.
    """
    files = sorted(folder.glob("*.h5"))
    found: dict[str, dict[int, Path]] = {"raw": {}, "emptyfiltered": {}}
    others = []
    for path in files:
        match = _FRAME.match(path.stem)
        if match is None:
            others.append(path.name)
        else:
            found[match[2] or "raw"][int(match[1])] = path
    if len(others) == len(files) and variant != "emptyfiltered":
        return dict(enumerate(files))
    chosen = found[variant or ("raw" if found["raw"] else "emptyfiltered")]
    if not chosen:
        there = listed(path.name for path in files)
        fail(folder, f"frames of the variant {variant} by their names", there)
    if others:
        warn(f"{folder}: left out, as they are not named like frames: {listed(others)}")
    return dict(sorted(chosen.items()))


def listed(items: Iterable[object]) -> str:
    """The first five of some, and that there are more."""
    texts = [str(item) for item in items]
    return ", ".join(texts[:5]) + (", ..." if len(texts) > 5 else "")


def files_of(numbers: Sequence[int], source: Frames, others: Sequence[Frames]) -> list[Path]:
    """The files that a group of frames is made from, which has the number of its first frame."""
    beside = [one.files(numbers[0]) for one in others if one.numbers is not None]
    return [path for files in (*map(source.files, numbers), *beside) for path in files]


def all_files(path: Path) -> list[Path]:
    """The files of all frames of a folder, or the one file that a path is."""
    if not path.is_dir():
        return [path]
    source = Frames.open(path)
    return [file for number in source.numbers or () for file in source.files(number)]


MAPS = "maps"
"""Folder of depth maps, one .npz for each frame; written before the record of the frame."""

GRID = "grid"
"""Under which the grid is kept among the maps."""

RECORDS = "frames"
"""Folder of records, one .json for each frame that is done."""

CAPTURES, VOLUMES = "captures", "volumes"


@dataclass(frozen=True, kw_only=True)
class FramesOptions:
    """Which frames, and how many become one."""

    frames: str = option(ALL, "The frames to process.", metavar=FRAMES_METAVAR)
    variant: Variant | None = option(None, "Variant of the frames. [default: raw]")
    average: int | None = option(
        None, "Take the coherent mean of every N frames, of those that agree.", metavar="N", min=2
    )
    align_phase: bool = option(False, "First rotate the frames of a mean to a common phase.")

    def __post_init__(self) -> None:
        if self.align_phase and self.average is None:
            raise wrong_usage("--align-phase", "expected --average with it")

    def groups(self, there: tuple[int, ...]) -> list[tuple[int, ...]]:
        """The frames that are chosen, in groups of which the mean is taken."""
        chosen = chosen_frames(self.frames, there)
        size = self.average or 1
        return [tuple(chosen[i : i + size]) for i in range(0, len(chosen), size)]


@dataclass(frozen=True, kw_only=True)
class CleaningOptions(EmptyOptions, ChannelOptions):
    """What is done with a frame before it is imaged."""

    empty_by: Literal["mean", "frame"] = option(
        "mean",
        "Subtract the mean of EMPTY's frames, of those that agree, or that of the same number.",
    )

    def __post_init__(self) -> None:
        EmptyOptions.__post_init__(self)
        ChannelOptions.__post_init__(self)
        if self.empty_by == "frame" and (self.empty is None or not self.empty.is_dir()):
            raise wrong_usage("--empty-by", "frame: expected a recording as --empty")

    def absolute(self) -> CleaningOptions:
        """The same for processes in other folders."""
        files = {name: getattr(self, name) for name in ("empty", "channels")}
        return replace(self, **{name: path and path.absolute() for name, path in files.items()})


@dataclass(frozen=True, kw_only=True)
class FrameAlignOptions:
    """A mesh that is aligned with every frame."""

    mesh: Path | None = option(
        None, "Align this mesh with every frame: its motion goes into the table.", metavar="MESH"
    )
    unit: Unit = option("m", "Unit of length of the mesh file.")
    bias: bool = option(
        False, "Correct the bias of each pose by simulations: about a minute a frame."
    )
    search_deg: float = option(45.0, "Rotations about boresight that are tried.", metavar="DEG")

    def check(self, hand: FrameHandOptions) -> None:
        """Raise unless the options go with a mesh, or with a hand that is searched for."""
        names = [name for name in given(self) if hand.fit_hand is None or name != "--search-deg"]
        if self.mesh is None and names:
            raise wrong_usage(names[0], "expected --mesh with it")

    def absolute(self) -> FrameAlignOptions:
        """The same for processes in other folders."""
        return replace(self, mesh=self.mesh and self.mesh.absolute())

    def settings(self) -> dict[str, Any]:
        """Settings of `calibration.align_mesh`."""
        search_deg = checks.positive("--search-deg", self.search_deg)
        return {"correct_bias": self.bias, "search_deg": search_deg}


@dataclass(frozen=True, kw_only=True)
class FrameHandOptions(AnyHandOptions):
    """A hand that is fitted to every frame, each from the one before."""

    fit_hand: str | None = option(
        None,
        "Fit a hand to every frame, each from the one before; the first from here: as --pose of "
        "`clradar fit-hand`.",
        metavar="POSE,...",
    )

    def fitting(
        self, shape: ShapeOptions, rigged: RigFileOptions, search_deg: float
    ) -> HandFitOptions | None:
        """The options of the fit, if there is one."""
        if self.fit_hand is None:
            for name in (*given(self), *given(shape), *given(rigged)):
                raise wrong_usage(name, "expected --fit-hand with it")
            return None
        known = {one.name: getattr(self, one.name) for one in fields(AnyHandOptions)}
        return HandFitOptions(pose=self.fit_hand, search_deg=search_deg, **known)


@dataclass(frozen=True, kw_only=True)
class KeepOptions:
    """What is written of every frame beside its depth map."""

    keep_captures: bool = option(False, "Write the cleaned capture of every frame (HDF5).")
    keep_volumes: bool = option(False, "Write the image of every frame (HDF5).")

    def names(self) -> tuple[str, ...]:
        """The folders of what is kept."""
        wanted = {CAPTURES: self.keep_captures, VOLUMES: self.keep_volumes}
        return tuple(name for name, kept in wanted.items() if kept)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSteps:
    """The steps of every frame, as plain values that a worker process gets."""

    source: Path
    run_name: str  # what is kept open of its inputs counts for no other run
    folder: Path
    chosen: FramesOptions
    cleaning: CleaningOptions
    gate: Mapping[str, Any] | None
    grid: VoxelGrid
    imaging: ImagingOptions
    depth: DepthMapOptions
    simulated: tuple[Path, ...]
    aligned: FrameAlignOptions
    hand: bool  # a depth map is kept that a hand can be fitted to
    keep: tuple[str, ...]  # which of `CAPTURES` and `VOLUMES` are written, too
    origin: Mapping[str, Any]
    device: Device | str | None

    def run(self, numbers: Sequence[int], progress: Progress | None = None) -> None:
        """Do a frame, or the mean of several, and write its results."""
        from clradar import backproject

        inputs = self.inputs_of(numbers)  # before it is read, as `content_record` asks for
        capture, record = cleaned(self, numbers)
        record["inputs"] = inputs
        if CAPTURES in self.keep:
            self._save(CAPTURES, numbers[0], capture)
        volume = backproject(
            capture, self.grid, device=self.device, progress=progress, **self.imaging.arguments
        )
        if VOLUMES in self.keep:
            self._save(VOLUMES, numbers[0], volume)
        record |= {"frame": numbers[0], **_figures(volume, self.depth.dynamic_range_db)}
        seen = volume.depth_map(self.depth.dynamic_range_db)
        others = [self._simulated(i, numbers[0]) for i in range(len(self.simulated))]
        record["metrics"] = [self._metrics(seen, other) for other in others]
        if self.aligned.mesh is not None:
            record["alignment"] = self._aligned(volume, capture)
        store = FolderStore(self.folder / MAPS)
        store[f"{numbers[0]:06d}"] = map_arrays(seen)
        if self.hand:
            from calibration.registration.mesh_pose import DEEPEST_DB  # of fits

            store[_hand_name(numbers[0])] = map_arrays(volume.depth_map(DEEPEST_DB))
        for i, other in enumerate(others):
            if fixed_name(i) not in store:
                store[f"{numbers[0]:06d}-{i}"] = map_arrays(other)
        write_json(record_file(self.folder, numbers[0]), record, force=True)

    def inputs_of(self, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """What the files of a group of frames hold."""
        others = [self._frames(path) for path in self.simulated]
        if self.cleaning.empty is not None and self.cleaning.empty_by == "frame":
            others.append(self._frames(self.cleaning.empty))
        source = self._frames(self.source, self.chosen.variant)
        return [content_record(path) for path in files_of(numbers, source, others)]

    def capture_of(self, path: Path, number: int, variant: str | None = None) -> Capture:
        """The capture of a frame; of a single capture that capture."""
        return capture_of(self._frames(path, variant), number)

    def _frames(self, path: Path, variant: str | None = None) -> Frames:
        return _opened(path, variant, self.run_name)

    def _save(self, name: str, number: int, result: Any) -> None:
        from clradar.cli.outputs import save

        save(self.folder / name / f"{number:06d}.h5", result, self.origin, force=True)

    def _simulated(self, i: int, number: int) -> DepthMap:
        """The depth map of a simulation at a frame: kept, if it is the same at every frame."""
        if fixed_name(i) in FolderStore(self.folder / MAPS):
            return self.map_of(fixed_name(i))
        return self.imaged(self._frames(self.simulated[i]).read(number))

    def imaged(self, content: Capture | Volume) -> DepthMap:
        """The depth map of a capture or a volume."""
        from clradar import Volume, backproject

        if not isinstance(content, Volume):
            content = backproject(content, self.grid, device=self.device, **self.imaging.arguments)
        return content.depth_map(self.depth.dynamic_range_db)

    def map_of(self, name: str) -> DepthMap:
        """A depth map that is kept: of a frame, or of a simulation."""
        return self._map(name, self.depth.dynamic_range_db)

    def hand_map_of(self, number: int) -> DepthMap:
        """The depth map of a frame that a hand is fitted to."""
        from calibration.registration.mesh_pose import DEEPEST_DB

        return self._map(_hand_name(number), DEEPEST_DB)

    def _map(self, name: str, dynamic_range_db: float) -> DepthMap:
        from clradar import DepthMap

        arrays = FolderStore(self.folder / MAPS)[name]
        axes_m = (arrays["x_m"], arrays["y_m"])
        return DepthMap(arrays["depth_m"], arrays["amplitude"], *axes_m, dynamic_range_db)

    def _metrics(self, seen: DepthMap, other: DepthMap) -> dict[str, Any] | None:
        from clradar.compare import metrics_of

        try:
            return metrics_of(seen, other, self.depth.dynamic_range_db).to_dict()
        except CompareError:  # nothing above zero in one of the two
            return None

    def _aligned(self, volume: Volume, capture: Capture) -> dict[str, Any]:
        from calibration import align_mesh

        own = self.aligned
        assert own.mesh is not None
        try:
            found = align_mesh(
                volume, _mesh(own.mesh, own.unit, self.run_name), array=capture.array,
                waveform=capture.waveform, device=self.device, **own.settings(),
            )  # fmt: skip
        except CompareError as error:
            return {"failed": str(error)}
        return found.to_dict()


def cleaned(steps: FrameSteps, numbers: Sequence[int]) -> tuple[Capture, dict[str, Any]]:
    """Average, subtract the empty room, gate, correct: the capture, and its time and power."""
    from calibration import average_frames, clean
    from measurement_io.maroon.frame import first_time_stamp

    chosen, cleaning = steps.chosen, steps.cleaning
    times: list[float | None] = []

    def frames() -> Iterator[Capture]:
        for number in numbers:
            capture = steps.capture_of(steps.source, number, chosen.variant)
            times.append(first_time_stamp(capture))
            yield capture

    if len(numbers) > 1:
        capture = average_frames(frames(), align_phase=chosen.align_phase)
    else:
        capture = next(frames())
    record: dict[str, Any] = {"time_us": times[0], "recorded_db": _rms_db(capture)}
    if len(numbers) > 1:
        record["average"] = capture.meta["average"]
    empty = None
    if cleaning.empty is not None:
        number = numbers[0] if cleaning.empty_by == "frame" else 0
        empty = steps.capture_of(cleaning.empty, number)
    capture = clean(
        capture, empty=empty, scaling=cleaning.scaling, gate=steps.gate, channels=cleaning.read(),
        mask=cleaning.mask,
    )  # fmt: skip
    return capture, {**record, "cleaned_db": _rms_db(capture)}


def capture_of(source: Frames, number: int) -> Capture:
    """The capture of a frame."""
    from clradar import Capture

    found = source.read(number)
    if not isinstance(found, Capture):
        fail(source.path, "captures", f"the volume of frame {number}")
    return found


# Workers of a scheduler live longer than a run.
@lru_cache(maxsize=8)
def _opened(path: Path, variant: str | None, run_name: str) -> Frames:
    return Frames.open(path, variant)


@lru_cache(maxsize=1)
def _mesh(path: Path, unit: str, run_name: str) -> Scene:
    from clradar import Scene

    return Scene.from_mesh(path, unit=unit)


def record_file(folder: Path, number: int) -> Path:
    """The file with the figures of a frame; it is written last, so the frame is done."""
    return folder / RECORDS / f"{number:06d}.json"


def read_record(folder: Path, number: int) -> dict[str, Any]:
    """The figures of a frame that is done."""
    return read_json_object(record_file(folder, number))


def fixed_name(i: int) -> str:
    """Under which the depth map of a simulation that is the same at every frame is kept."""
    return f"simulated-{i}"


def _hand_name(number: int) -> str:
    return f"{number:06d}-hand"


def map_arrays(image: DepthMap) -> dict[str, np.ndarray]:
    """A depth map as it is kept."""
    return {
        "amplitude": image.amplitude, "depth_m": image.depth_m, "x_m": image.x_m, "y_m": image.y_m
    }  # fmt: skip


def _rms_db(capture: Capture) -> float | None:
    power = float(np.mean(np.abs(capture.data) ** 2, dtype=np.float64))
    return 10 * math.log10(power) if power > 0 else None


def _figures(volume: Volume, dynamic_range_db: float) -> dict[str, Any]:
    """The level and place of the maximum, and the centre of power of what is above the cut."""
    amplitude = np.abs(volume.data)
    at = np.unravel_index(int(amplitude.argmax()), amplitude.shape)
    peak = float(amplitude[at])
    if peak == 0:
        return {"peak_db": None, "peak_m": None, "centre_m": None}
    axes_m = (volume.grid.z_m, volume.grid.y_m, volume.grid.x_m)
    power = (
        np.where(amplitude >= peak * 10 ** (-dynamic_range_db / 20), amplitude, 0).astype(
            np.float64
        )
        ** 2
    )
    sums = [power.sum(axis=tuple(j for j in range(3) if j != i)) for i in range(3)]
    return {
        "peak_db": 20 * math.log10(peak),
        "peak_m": [float(axis[i]) for axis, i in zip(axes_m, at, strict=True)][::-1],
        "centre_m": [float(s @ axis / s.sum()) for s, axis in zip(sums, axes_m, strict=True)][::-1],
    }
