"""What ``clradar process`` does with one frame of a recording, in this process or on a worker."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.frame_sources import Frames, files_of
from clradar.cli.resumable import FolderStore
from clradar.errors import CompareError
from clradar.files.failures import fail
from clradar.files.hashing import content_record
from clradar.files.json_file import read_json_object, write_json

if TYPE_CHECKING:
    from clradar import Capture, DepthMap, Device, Scene, Volume, VoxelGrid

MAPS = "maps"
"""Folder of depth maps, one .npz for each frame; written before the record of the frame."""

GRID = "grid"
"""Under which the grid is kept among the maps."""

RECORDS = "frames"
"""Folder of records, one .json for each frame that is done."""

CAPTURES, VOLUMES = "captures", "volumes"


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSteps:
    """The steps of every frame, as plain values that a worker process gets.

    Attributes
    ----------
    source : Path
    variant : str or None
    run_name : str
        Of this run alone: what is kept open of its inputs counts for no other.
    folder : Path
        Results go into folders there.
    align_phase : bool
        Of averages.
    empty : Path or None
        A capture, or with `empty_by_frame` a recording whose frame of the same number counts.
    empty_by_frame : bool
    scaling : str
        Of `calibration.subtract_background`.
    gate : mapping or None
        Settings of `calibration.range_gate`.
    channels : Path or None
    keep_noisy : bool
        Noisy channels are not set to zero.
    grid : VoxelGrid
    imaging : mapping
        Settings of `clradar.backproject`.
    dynamic_range_db : float, decibel
    simulated : tuple of Path
    mesh : Path or None
        It is aligned with every frame.
    mesh_unit : str
    align : mapping
        Settings of `calibration.align_mesh`.
    hand : bool
        A depth map is kept that a hand can be fitted to.
    keep : tuple of str
        Which of `CAPTURES` and `VOLUMES` are written, too.
    origin : mapping
        From `clradar.cli.provenance.provenance`.
    device : Device, str or None
    """

    source: Path
    variant: str | None
    run_name: str
    folder: Path
    align_phase: bool
    empty: Path | None
    empty_by_frame: bool
    scaling: str
    gate: Mapping[str, Any] | None
    channels: Path | None
    keep_noisy: bool
    grid: VoxelGrid
    imaging: Mapping[str, Any]
    dynamic_range_db: float
    simulated: tuple[Path, ...]
    mesh: Path | None
    mesh_unit: str
    align: Mapping[str, Any]
    hand: bool
    keep: tuple[str, ...]
    origin: Mapping[str, Any]
    device: Device | str | None

    def run(self, numbers: Sequence[int]) -> None:
        """Do a frame, or the mean of several, and write its results.

        Raises
        ------
        MeasurementError
            It cannot be read.
        """
        from clradar import backproject

        inputs = self.inputs_of(numbers)  # before it is read, as `content_record` asks for
        capture, record = cleaned(self, numbers)
        record["inputs"] = inputs
        if CAPTURES in self.keep:
            self._save(CAPTURES, numbers[0], capture)
        volume = backproject(capture, self.grid, device=self.device, **self.imaging)
        if VOLUMES in self.keep:
            self._save(VOLUMES, numbers[0], volume)
        record |= {"frame": numbers[0], **_figures(volume, self.dynamic_range_db)}
        seen = volume.depth_map(self.dynamic_range_db)
        others = [self._simulated(i, numbers[0]) for i in range(len(self.simulated))]
        record["metrics"] = [self._metrics(seen, other) for other in others]
        if self.mesh is not None:
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
        if self.empty is not None and self.empty_by_frame:
            others.append(self._frames(self.empty))
        source = self._frames(self.source, self.variant)
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
            content = backproject(content, self.grid, device=self.device, **self.imaging)
        return content.depth_map(self.dynamic_range_db)

    def map_of(self, name: str) -> DepthMap:
        """A depth map that is kept: of a frame, or of a simulation."""
        return self._map(name, self.dynamic_range_db)

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
            return metrics_of(seen, other, self.dynamic_range_db).to_dict()
        except CompareError:  # nothing above zero in one of the two
            return None

    def _aligned(self, volume: Volume, capture: Capture) -> dict[str, Any]:
        from calibration import align_mesh

        assert self.mesh is not None
        try:
            found = align_mesh(
                volume, _mesh(self.mesh, self.mesh_unit, self.run_name), array=capture.array,
                waveform=capture.waveform, device=self.device, **self.align,
            )  # fmt: skip
        except CompareError as error:
            return {"failed": str(error)}
        return found.to_dict()


def cleaned(steps: FrameSteps, numbers: Sequence[int]) -> tuple[Capture, dict[str, Any]]:
    """Average, subtract the empty room, gate, correct: the capture, and its time and power."""
    from calibration import average_frames, correct, range_gate, subtract_background
    from calibration.channels.correction import MASKS
    from measurement_io import open_channels
    from measurement_io.maroon.frame import first_time_stamp

    times: list[float | None] = []

    def frames() -> Iterator[Capture]:
        for number in numbers:
            capture = steps.capture_of(steps.source, number, steps.variant)
            times.append(first_time_stamp(capture))
            yield capture

    if len(numbers) > 1:
        capture = average_frames(frames(), align_phase=steps.align_phase)
    else:
        capture = next(frames())
    record: dict[str, Any] = {"time_us": times[0], "recorded_db": _rms_db(capture)}
    if len(numbers) > 1:
        record["average"] = capture.meta["average"]
    if steps.empty is not None:
        empty_number = numbers[0] if steps.empty_by_frame else 0
        empty = steps.capture_of(steps.empty, empty_number)
        capture = subtract_background(capture, empty, scaling=steps.scaling)
    if steps.gate is not None:
        capture = range_gate(capture, **steps.gate)
    if steps.channels is not None:
        mask = [state for state in MASKS if state == "dead" or not steps.keep_noisy]
        capture = correct(capture, open_channels(steps.channels), mask=mask)
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
