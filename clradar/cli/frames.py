"""The frames of ``clradar process``: where they come from, and what is done with one of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import calibration
import clradar as cl
import measurement_io
from clradar.cli import images as img, options as opt, outputs as out, parse
from clradar.compare.metrics import metrics_of
from clradar.errors import CompareError, warn
from clradar.files.failures import fail
from clradar.files.json_file import write_json
from clradar.jobs import FolderStore
from clradar.model.progress import Progress

_FRAME = re.compile(r"([0-9]+)(?:_(emptyfiltered))?\Z")
"""Names of captures as `convert --all-frames` gives them."""


class Frames:
    """Captures or volumes by their numbers; a single one, which has no `files`, is at each.

    Of a recording, a folder of captures or volumes (.h5), or a single one.
    """

    def __init__(self, path: Path, variant: str | None = None) -> None:
        self.path, self.files = path, dict[int, Path]()
        self.read: Callable[[int], img.Content]
        if not path.is_dir():
            content = img.open_image(path)
            self.read = lambda _: content
        elif any(path.glob("*.h5")) and not any(path.glob("radar_*")):
            self.files = _captures_by_number(path, variant)
            self.read = lambda number: img.open_image(self.files[number])
        else:
            from measurement_io.maroon.folders import frames

            recording = measurement_io.open_recording(path, variant=variant or "raw")
            self.files = frames(recording.path)[recording.variant]
            if not self.files:
                fail(path, f"frames of the variant {recording.variant}", "none")
            self.read = lambda number: recording[recording.frame_numbers.index(number)]

    def capture(self, number: int) -> cl.Capture:
        """The capture of a frame; of a single capture that capture."""
        found = self.read(number)
        if not isinstance(found, cl.Capture):
            fail(self.path, "captures", f"the volume of frame {number}")
        return found

    def files_of(self, numbers: Iterable[int] | None = None) -> list[Path]:
        """The files of these frames or of all, or the one file that the path is."""
        chosen = self.files if numbers is None else numbers
        return [self.files[number] for number in chosen] if self.files else [self.path]


def _captures_by_number(folder: Path, variant: str | None) -> dict[int, Path]:
    """Without a variant raw ones, if there are any; other names count from 0."""
    files = sorted(folder.glob("*.h5"))
    named = [(match, path) for path in files if (match := _FRAME.match(path.stem))]
    if not named and variant != "emptyfiltered":
        return dict(enumerate(files))
    raw = any(match[2] is None for match, _ in named)
    chosen = variant or ("raw" if raw else "emptyfiltered")
    found = {int(match[1]): path for match, path in named if (match[2] or "raw") == chosen}
    if not found:
        there = listed(path.name for path in files)
        fail(folder, f"frames of the variant {chosen} by their names", there)
    if others := [path.name for path in files if not _FRAME.match(path.stem)]:
        warn(f"{folder}: left out, as they are not named like frames: {listed(others)}")
    return dict(sorted(found.items()))


def listed(items: Iterable[object]) -> str:
    """The first five."""
    texts = [str(item) for item in items]
    return ", ".join(texts[:5]) + (", ..." if len(texts) > 5 else "")


# Folders with a file for each frame.
MAPS = "maps"  # depth maps, .npz; written before the record of the frame
RECORDS = "frames"  # .json, of frames that are done
CAPTURES, VOLUMES = "captures", "volumes"


@dataclass(frozen=True, kw_only=True)
class ProcessOptions(
    opt.CleaningOptions, opt.ImagingOptions, opt.DepthMapOptions, opt.UnitOptions, opt.HandOptions
):
    """Which frames, what is done with each, and what is written of it beside its depth map."""

    frames: str = opt.option("The frames to process.", parse.ALL, metavar=parse.FRAMES_METAVAR)
    variant: opt.Variant | None = opt.option("Variant of the frames. [default: raw]")
    mesh: Path | None = opt.option(
        "Align this mesh with every frame: its motion goes into the table.", metavar="MESH"
    )
    bias: bool = opt.option(
        "Correct the bias of each pose by simulations: about a minute a frame.",
        False,
        needs="--mesh",
    )
    fit_hand: str | None = opt.option(
        "Fit a hand to every frame, each from the one before; the first from here: as --pose of "
        "`clradar fit-hand`.",
        metavar="POSE,...",
        files=opt.start_files,
    )
    keep_captures: bool = opt.option(
        "Write the cleaned capture of every frame (HDF5).", False, panel="Output", kept=True
    )
    keep_volumes: bool = opt.option(
        "Write the image of every frame (HDF5).", False, panel="Output", kept=True
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSteps:
    """The steps of every frame, as plain values that a worker process gets."""

    source: Path
    simulated: tuple[Path, ...]
    folder: Path
    how: ProcessOptions
    origin: Mapping[str, Any]
    run_name: str  # what is kept open of its inputs counts for no other run
    grid: cl.VoxelGrid

    def run(self, number: int, device: cl.Device, progress: Progress) -> None:
        """Do a frame, and write its results; its record last."""
        how, range_db = self.how, self.how.dynamic_range_db
        capture, record = self.cleaned(number)
        volume = cl.backproject(
            capture, self.grid, device=device, progress=progress, **how.arguments
        )
        record |= {"frame": number, **_figures(volume, range_db)}
        image = volume.depth_map(range_db)
        others = (self._simulated(i, number, device) for i in range(len(self.simulated)))
        record["metrics"] = [_metrics(image, other, range_db) for other in others]
        if how.mesh is not None:
            record["alignment"] = self._alignment(volume, capture, how.mesh, device)
        name = f"{number:06d}"
        if how.keep_captures:
            out.save(self.folder / CAPTURES / f"{name}.h5", capture, self.origin)
        if how.keep_volumes:
            out.save(self.folder / VOLUMES / f"{name}.h5", volume, self.origin)
        self.keep_map(name, image)
        if how.fit_hand is not None:
            from calibration.registration.mesh_pose import DEEPEST_DB  # of fits

            self.keep_map(f"{name}-hand", volume.depth_map(DEEPEST_DB))
        write_json(record_file(self.folder, number), record, force=True)

    def cleaned(self, number: int) -> tuple[cl.Capture, dict[str, Any]]:
        """Subtract the empty room, gate, correct: the capture, and its time and power."""
        from measurement_io.maroon.frame import first_time_stamp

        capture = _opened(self.source, self.how.variant, self.run_name).capture(number)
        record = {"time_us": first_time_stamp(capture.meta), "recorded_db": img.rms_db(capture)}
        room = self.how.empty
        empty = None if room is None else _opened(room, None, self.run_name).capture(0)
        capture = self.how.cleaned(capture, empty)
        return capture, {**record, "cleaned_db": img.rms_db(capture)}

    def _simulated(self, i: int, number: int, device: cl.Device) -> cl.DepthMap:
        """The depth map of a simulation at a frame: kept, if it is the same at every frame."""
        frames, name = _opened(self.simulated[i], None, self.run_name), f"simulated-{i}"
        if frames.files:
            return self._imaged(frames.read(number), device)
        if name not in FolderStore(self.folder / MAPS):
            self.keep_map(name, self._imaged(frames.read(number), device))
        return self.map_of(name)

    def _imaged(self, content: img.Content, device: cl.Device) -> cl.DepthMap:
        if not isinstance(content, cl.Volume):
            how = self.how.arguments
            content = cl.backproject(content, self.grid, device=device, **how)
        return content.depth_map(self.how.dynamic_range_db)

    def keep_map(self, name: str, image: cl.DepthMap) -> None:
        arrays = {one.name: np.asarray(getattr(image, one.name)) for one in fields(image)}
        FolderStore(self.folder / MAPS)[name] = arrays

    def map_of(self, name: str) -> cl.DepthMap:
        """A depth map that is kept: of a frame, of its hand, or of a simulation."""
        kept: dict[str, Any] = FolderStore(self.folder / MAPS)[name]
        return cl.DepthMap(**{**kept, "dynamic_range_db": float(kept["dynamic_range_db"])})

    def _alignment(
        self, volume: cl.Volume, capture: cl.Capture, mesh: Path, device: cl.Device
    ) -> dict[str, Any]:
        try:
            found = calibration.align_mesh(
                volume, _mesh(mesh, self.how.unit, self.run_name), array=capture.array,
                waveform=capture.waveform, device=device, correct_bias=self.how.bias,
                search_deg=self.how.search_deg,
            )  # fmt: skip
        except CompareError as error:
            return {"failed": str(error)}
        return found.to_dict()


# Workers of a scheduler live longer than a run.
@lru_cache(maxsize=8)
def _opened(path: Path, variant: str | None, run_name: str) -> Frames:
    return Frames(path, variant)


@lru_cache(maxsize=1)
def _mesh(path: Path, unit: str, run_name: str) -> cl.Scene:
    return cl.Scene.from_mesh(path, unit=unit)


def record_file(folder: Path, number: int) -> Path:
    """The file with the figures of a frame; it is written last, so the frame is done."""
    return folder / RECORDS / f"{number:06d}.json"


def _metrics(image: cl.DepthMap, other: cl.DepthMap, range_db: float) -> dict[str, Any] | None:
    try:
        return metrics_of(image, other, range_db).to_dict()
    except CompareError:  # nothing above zero in one of the two
        return None


def _figures(volume: cl.Volume, dynamic_range_db: float) -> dict[str, Any]:
    """The level and place of the maximum, and the centre of power of what is above the cut."""
    amplitude = np.abs(volume.data)
    at = np.unravel_index(int(amplitude.argmax()), amplitude.shape)
    peak = float(amplitude[at])
    if peak == 0:
        return {"peak_db": None, "peak_m": None, "centre_m": None}
    axes_m = (volume.grid.z_m, volume.grid.y_m, volume.grid.x_m)
    cut = np.where(amplitude >= peak * 10 ** (-dynamic_range_db / 20), amplitude, 0)
    power = cut.astype(np.float64) ** 2
    sums = [power.sum(axis=tuple(j for j in range(3) if j != i)) for i in range(3)]
    return {
        "peak_db": 20 * math.log10(peak),
        "peak_m": [float(axis[i]) for axis, i in zip(axes_m, at, strict=True)][::-1],
        "centre_m": [float(s @ axis / s.sum()) for s, axis in zip(sums, axes_m, strict=True)][::-1],
    }
