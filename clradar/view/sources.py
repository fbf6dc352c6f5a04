"""What is viewed: frames of a path, a data set or a Python iterable, and new ones.

Each is read on access; what it was made of is known of samples of data sets, and of frames of
simulated recordings.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import measurement_io
from clradar.dataset import Sample
from clradar.dataset.folder import is_dataset, read_manifest, stored_sample
from clradar.dataset.sample import SamplePlan, read_recipe
from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import fail
from clradar.files.json_file import read_json_object
from clradar.files.watched_folder import WatchedFolder, visible
from clradar.hand import JOINT_NAMES
from clradar.model import Capture, DepthMap, Volume, checks
from clradar.view.drawn import Flat
from measurement_io.maroon.folders import FRAMES_FOLDER, find_radar_folder, frame_file
from measurement_io.opening import kind_of

Content: TypeAlias = Capture | Volume | Flat

SUFFIXES = (".h5", ".hdf5", ".nxs", ".npy")

LOOK_S, REST_S = 0.02, 0.5  # between looks at a folder while files come, and at rest
SAMPLES_S = 1.0  # between two looks at a data set that is written
TRUTH_FILE = "truth/truth.json"
"""Beside the radar folder, as ``clradar simulate --motion --frames`` writes it."""

KEPT_BYTES = 256 * 2**20  # of samples of an iterable, to look back at: 29 frames of the imager


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a frame was made of, as far as it is known.

    Joints, (25 * hands, 3), are in the order of `clradar.hand.JOINT_NAMES`, NaN where a rig has
    none; `lines` are pose, hand, place and surface as text.
    """

    vertices_m: np.ndarray | None
    faces: np.ndarray | None
    joints_m: np.ndarray | None
    lines: tuple[str, ...]


class Source:
    """Frames that are read on access, each under a number of its own: these do not change.

    A number stands for one content: what is written anew gets a new one. What is remembered of a
    frame under its number stays right. `grows`: frames come while it is viewed, and the newest is
    to be shown. `ended`: no more will come, because of an `error` that is to be raised, if any.
    """

    grows, ended = False, False
    error: BaseException | None = None
    truth: Callable[[int], Truth | None] | None = None
    """What a frame was made of, where it may be known."""

    def __init__(self, name: str, labels: Sequence[str] = (), read: Any = None) -> None:
        self.name, self._read = name, read
        self._there: dict[int, tuple[Any, float]] = {i: (one, 0.0) for i, one in enumerate(labels)}
        """What is known of each frame, and when it came; replaced, never changed, since others
        read it meanwhile."""

    def frames(self) -> tuple[int, ...]:
        """Return the numbers of the frames to go through, ascending; they may change."""
        return tuple(self._there)

    def came_s(self, frame: int) -> float:
        """Return when a frame came, by `time.perf_counter`."""
        return self._there.get(frame, (None, time.perf_counter()))[1]

    def label(self, frame: int) -> str:
        """Return what a frame is called."""
        known = self._there.get(frame)
        return "a frame that is gone" if known is None else self._label_of(frame, known[0])

    def read(self, frame: int) -> Content:
        """Read a frame; errors are those of `measurement_io.open_capture`."""
        known = self._there.get(frame)
        if known is None:
            fail(self.name, "a frame that is there", "one that is gone, or not there yet")
        return self._content_of(frame, known[0])

    def _label_of(self, frame: int, known: Any) -> str:
        return str(known)

    def _content_of(self, frame: int, known: Any) -> Content:
        return self._read(frame)

    def look(self) -> bool:
        """Wait a while for other frames; return whether there are."""
        time.sleep(REST_S)
        return False


def open_source(path: Path, variant: str = "raw", *, watch: bool = False) -> Source:
    """Return the frames of a recording, a data set or a folder, or the one of a file."""
    if is_dataset(path):
        return SampleFrames(path, watch=watch)
    if watch or kind_of(path) == "folder":
        return FolderFrames(path, variant, watch=watch)
    name = path.name or path.absolute().name
    content = read_file(path)  # a file that is damaged is refused before there is a page
    return Source(name, (name,), lambda _: content)


def read_file(path: Path) -> Capture | Volume:
    """Read a capture, a recorded frame or a volume; errors as `measurement_io.open_capture`."""
    found = measurement_io.open(path)  # kind and content in one confined process
    return found if isinstance(found, Capture | Volume) else measurement_io.open_capture(path)


class FolderFrames(Source):
    """The files of a folder; new, rewritten and removed ones are taken in by `look`."""

    def __init__(self, path: Path, variant: str, *, watch: bool) -> None:
        super().__init__(path.name or path.absolute().name)
        self.grows, self._path = watch, path
        if not path.is_dir():
            fail(path, "a folder", "a file" if path.exists() else "nothing there")
        data = path
        with suppress(MeasurementError):
            data = find_radar_folder(path) / FRAMES_FOLDER
        self._is_recording = data != path and data.is_dir()

        def counts(name: str) -> bool:
            if not self._is_recording:
                return visible(name) and name.endswith(SUFFIXES)
            file = frame_file(Path(name))
            return file.frame is not None and file.variant == variant

        self._folder = WatchedFolder(data if self._is_recording else path, counts)
        self.truth = recording_truth(path, self.label)
        self._lock = threading.Lock()
        self._last: dict[int, Capture | Volume] = {}
        self._count, self._changed_s = 0, time.perf_counter()
        self._take_in()
        time.sleep(LOOK_S)  # a file is complete once it is the same in two looks
        self._take_in()
        if not self._there and not watch:
            fail(path, f"a recording, or files ({', '.join(SUFFIXES)}) in the folder", "none")

    def _label_of(self, frame: int, known: Any) -> str:
        number = frame_file(known).frame if self._is_recording else None
        return str(known.name) if number is None else f"frame {number}"

    def _content_of(self, frame: int, known: Any) -> Content:
        last = self._last  # the newest is read ahead, while the one before is imaged
        if frame in last:
            return last[frame]
        try:
            content = read_file(known)
        except ClradarError:
            # Half-written, perhaps: once it has changed it comes again, under another number.
            with self._lock:
                self._there = {n: file for n, file in self._there.items() if n != frame}
            raise
        self._last = {**dict(list(last.items())[-1:]), frame: content}
        return content

    def look(self) -> bool:
        """Wait a while, take in new, rewritten and removed files; whether the frames are others."""
        frames, count = self.frames(), self._count
        if time.perf_counter() - self._changed_s > 10 * REST_S:
            time.sleep(REST_S)
            self._take_in()
        time.sleep(LOOK_S)
        begun_s = time.perf_counter()
        self._take_in()
        if self._count > count:
            self.grows, self._changed_s = True, time.perf_counter()
        # Where a look takes long, as over a network, there are fewer.
        time.sleep(min(2.0, 4 * (time.perf_counter() - begun_s)))
        return self.frames() != frames

    def _take_in(self) -> None:
        found = self._folder.changes()
        names = {path.name for path in found}
        now_s = time.perf_counter()
        behind_s = time.time() - now_s
        with self._lock:
            files = {
                number: (path, came_s)
                for number, (path, came_s) in self._there.items()
                if path.name not in names and self._folder.is_there(path.name)
            }
            for path in found:
                came_s = now_s
                with suppress(OSError):  # gone again
                    came_s = min(now_s, path.stat().st_mtime - behind_s)
                files[self._count] = path, came_s
                self._count += 1
            self._there = files


class StreamFrames(Source):
    """Captures or volumes of an iterable, gone through in a thread; the last ones are kept."""

    grows = True

    def __init__(self, frames: Iterable[Capture | Volume], name: str) -> None:
        super().__init__(name)
        self._came = threading.Event()
        threading.Thread(
            target=self._run, args=(frames,), name="clradar frames", daemon=True
        ).start()

    def _label_of(self, frame: int, known: Any) -> str:
        return f"frame {known.meta.get('frame', frame)}"

    def _content_of(self, frame: int, known: Any) -> Content:
        return known

    def look(self) -> bool:
        came = self._came.wait(REST_S)
        self._came.clear()
        return came

    def _run(self, frames: Iterable[Capture | Volume]) -> None:
        try:
            for count, frame in enumerate(frames):
                checks.instance("show: frames", frame, Capture | Volume)
                kept = {**self._there, count: (frame, time.perf_counter())}
                left = sum(one.data.nbytes for one, _ in kept.values())
                while left > KEPT_BYTES and len(kept) > 1:
                    left -= kept.pop(next(iter(kept)))[0].data.nbytes
                self._there = kept
                self._came.set()
        except BaseException as error:
            self.error = error
        finally:
            self.ended = True


def recording_truth(
    path: Path, label: Callable[[int], str]
) -> Callable[[int], Truth | None] | None:
    """Return the truth beside a recording, by the labels of its frames; None where there is none,
    or it cannot be read.
    """
    with suppress(ClradarError):
        radar = find_radar_folder(path)
        for file in (radar / TRUTH_FILE, radar.parent / TRUTH_FILE):
            if file.is_file():
                frames = read_json_object(file).get("frames")
                records = frames if isinstance(frames, list) else []
                known = {f"frame {r.get('frame')}": r for r in records if isinstance(r, Mapping)}
                return lambda frame: _truth_of(known.get(label(frame)))
    return None


def _truth_of(record: Mapping[str, Any] | None) -> Truth | None:
    """Return joints and poses of a frame."""
    if record is None:
        return None
    with suppress(AttributeError, IndexError, TypeError, ValueError):  # not as it is written
        hands = record.get("hands", [record])
        joints = [one["joints_m"] for one in hands if one.get("joints_m")]
        places = [[one.get(name) or [np.nan] * 3 for name in JOINT_NAMES] for one in joints]
        joints_m = np.array(places, np.float64).reshape(-1, 3) if places else None
        lines = [f"pose {one['pose']}" for one in hands if one.get("pose")]
        for name, matrix in record.get("bodies", {}).items():
            x, y, z = 1e3 * np.array(matrix, np.float64)[:3, 3]
            lines.append(f"{name} at ({x:.1f}, {y:.1f}, {z:.1f}) mm")
        return Truth(None, None, joints_m, tuple(lines))
    return None


class SampleFrames(Source):
    """The stored samples of a data set, numbered as in the plan, read one at a time."""

    def __init__(self, folder: Path, *, watch: bool = False) -> None:
        super().__init__(folder.name or folder.absolute().name)
        self.grows, self._folder = watch, folder
        self.truth = self._truth_of
        self._sample = lru_cache(maxsize=8)(self._sample_of)
        self._take_in()
        if not self._there and not watch:
            fail(folder, "a data set with at least one sample", "none")

    def _content_of(self, frame: int, known: Any) -> Content:
        """Read the volume that is stored, else the capture, else projection and depth map.

        Where only one of these two is stored, the other is without a value, or 1 where there is a
        depth.
        """
        sample = self._sample(frame)
        arrays = sample.arrays
        if "volume" not in arrays and "capture" in arrays:
            radar = read_recipe(sample.recipe).plan.radar
            return Capture(arrays["capture"], radar.antennas, radar.waveform)
        grid = self._manifest.plan.image.grid
        if "volume" in arrays:
            return Volume(arrays["volume"], grid)
        products = (("projection", "max_projection"), ("depth", "depth_map"))
        stored = tuple(name for name, array in products if array in arrays)
        if not stored:
            fail(self._folder, "a product that can be drawn", ", ".join(arrays))
        depth_m = arrays.get("depth_map", np.full(grid.shape[1:], np.nan))
        amplitude = np.abs(arrays.get("max_projection", np.isfinite(depth_m))).astype(np.float64)
        image = DepthMap(depth_m.astype(np.float64), amplitude, grid.x_m, grid.y_m)
        return Flat(image, stored)

    def _truth_of(self, frame: int) -> Truth:
        sample = self._sample(frame)
        arrays = sample.arrays
        mesh_m, faces, joints_m = map(arrays.get, ("mesh_vertices", "mesh_faces", "joints"))
        return Truth(mesh_m, faces, joints_m, _recipe_lines(read_recipe(sample.recipe)))

    def look(self) -> bool:
        """Wait a second, take in what was stored since; return whether there are other samples."""
        time.sleep(SAMPLES_S)
        before = self.frames()
        self._take_in()
        if others := self.frames() != before:
            self.grows = True
        return others

    def _take_in(self) -> None:
        # When they were written is not known: new ones came now.
        self._manifest, now_s = read_manifest(self._folder), time.perf_counter()
        stored = self._manifest.stored
        self._there = {n: self._there.get(n, (f"sample {n}", now_s)) for n in stored}

    def _sample_of(self, frame: int) -> Sample:
        return stored_sample(self._folder, self._manifest, frame)[0]


def _recipe_lines(drawn: SamplePlan) -> tuple[str, ...]:
    hands, placement = drawn.plan.hands, drawn.plan.placement
    centre_mm = ", ".join(f"{1e3 * value:.1f}" for value in placement.metres)
    turns_deg = ", ".join(f"{np.degrees(value):.1f}" for value in placement.radians)
    lines = [
        f"pose {drawn.pose.name}, {hands.handedness} hand",
        f"centre ({centre_mm}) mm, turned by ({turns_deg})°",
        *(f"rig {Path(rig.file).name}" for rig in hands.rigs),
    ]
    if drawn.plan.alpha is not None:
        alphas = drawn.plan.alpha.of_parts.items()
        lines.append("alpha: " + ", ".join(f"{name} {value:.2f}" for name, value in alphas))
    if drawn.plan.material is not None:
        materials = drawn.plan.material.of_parts.items()
        lines.append("material: " + ", ".join(f"{name} {own.name}" for name, own in materials))
    return tuple(lines)
