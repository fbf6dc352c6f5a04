"""A whole recording: its frames one at a time, and what lies beside them."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from clradar.errors import MeasurementError, MeshError, warn
from clradar.files.confined.process import Companion
from clradar.files.failures import clean, fail, reading, shown
from clradar.files.json_file import read_json_object
from clradar.model import AntennaArray, Capture, DepthMap, Scene, Waveform, checks
from measurement_io.maroon import folders
from measurement_io.maroon.folders import ALIGNMENT_FILE, MESH_FOLDER, METADATA_FILE
from measurement_io.maroon.frame import antenna_array, read_frame_file, read_time_stamp

if TYPE_CHECKING:
    from measurement_io.maroon.alignment import SensorAlignment

_EXPECTED = (
    "the folder of a recording: radar_<low GHz>_<high GHz>_<points>, or the <object>/<distance> "
    "folder that holds one"
)


def open_recording(
    path: str | os.PathLike[str],
    *,
    variant: str = "raw",
    rx_file: str | os.PathLike[str] | None = None,
    tx_file: str | os.PathLike[str] | None = None,
) -> Recording:
    """Return the frames of a recording, none of them read yet.

    Parameters
    ----------
    path : path-like
        A `radar_<low>_<high>_<points>` folder, or the `<object>/<distance>` folder that holds
        exactly one.
    variant : {"raw", "emptyfiltered"}
        As recorded, or with the empty room removed.
    rx_file, tx_file : path-like, optional
        Text: a line `x,y,z`, then a row per antenna, metres. Default: of the folder, else `qar50`.

    Examples
    --------
    >>> radar = measurement_io.save_recording("plate/30", frames)
    >>> [float(frame.data[0, 0, 0].real) for frame in measurement_io.open_recording("plate/30")]
    [1.0, 2.0, 3.0]
    """
    source = Path(path)
    variant = checks.one_of("open_recording: variant", variant, folders.VARIANTS)
    with reading(source, _EXPECTED):
        if not source.is_dir():
            fail(source, _EXPECTED, "a file" if source.exists() else "nothing there")
        radar = folders.find_radar_folder(source)
        array = antenna_array(rx_file, tx_file, radar / folders.ANTENNAS_FILE)
        frames = folders.frames(radar)
        if not any(frames.values()):
            fail(radar, f"frames %06d.npy in {folders.FRAMES_FOLDER}", "none")
        return Recording(radar, array, frames)._view(variant)


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Sequence[Capture]):
    """The frames of a recording, read on access; made by `open_recording`.

    ``recording[i]`` is the i-th frame that is there: `frame_numbers` can have gaps. A slice is a
    recording of some frames, and reads nothing. Nothing that was read is kept. A frame that is
    damaged, or has other frequencies than the first, raises `MeasurementError` on access.

    Attributes
    ----------
    path : Path
        The radar folder.
    array : AntennaArray
        Antennas of all frames.
    variant : str
        "raw" or "emptyfiltered".
    frame_numbers : tuple of int
        The numbers of the files of the frames.
    """

    path: Path
    array: AntennaArray
    _frames: Mapping[str, Mapping[int, Path]]
    variant: str = "raw"
    frame_numbers: tuple[int, ...] = ()
    # Of all views of it:
    _companion: Companion = field(default_factory=Companion)
    _read_once: dict[str, Any] = field(default_factory=dict)

    def _view(self, variant: str, numbers: tuple[int, ...] | None = None) -> Recording:
        """Return the same recording in a variant, of all frames or those of some numbers."""
        there = self._frames[variant]
        missing = [n for n in numbers or () if n not in there]
        if missing or not there:
            found = folders.ranges(there) or "no frame of this variant"
            wanted = f"frames {folders.ranges(missing)}" if missing else "frames"
            fail(self.path, f"{wanted} of the variant '{variant}'", found)
        chosen = tuple(sorted(there)) if numbers is None else numbers
        return replace(self, variant=variant, frame_numbers=chosen)

    def __len__(self) -> int:
        return len(self.frame_numbers)

    @overload
    def __getitem__(self, index: int) -> Capture: ...
    @overload
    def __getitem__(self, index: slice) -> Recording: ...
    def __getitem__(self, index: int | slice) -> Capture | Recording:
        if isinstance(index, slice):
            return self._view(self.variant, self.frame_numbers[index])
        return self._capture_of_number(self._number(index))

    def __iter__(self) -> Iterator[Capture]:
        # Not a generator: after an unreadable frame next() continues with the following one.
        return map(self._capture_of_number, self.frame_numbers)

    def readable(self) -> Iterator[Capture]:
        """Go through the frames that can be read; a warning names each of the others."""
        for number in self.frame_numbers:
            try:
                capture = self._capture_of_number(number)
            except MeasurementError as error:
                warn(f"frame {number} is left out: {error}")
                continue
            yield capture

    def __repr__(self) -> str:
        return f"<Recording {shown(self.path)}: {len(self)} frames, {self.variant}>"

    @property
    def variants(self) -> tuple[str, ...]:
        """The variants of which there are frames."""
        return tuple(name for name, frames in self._frames.items() if frames)

    def with_variant(self, variant: str) -> Recording:
        """The same recording in another variant; of a slice, the frames of the same numbers."""
        variant = checks.one_of("Recording.with_variant: variant", variant, folders.VARIANTS)
        whole = len(self.frame_numbers) == len(self._frames[self.variant])
        return self._view(variant, None if whole else self.frame_numbers)

    @property
    def timestamps_us(self) -> tuple[int | float | None, ...]:
        """Time stamp of every frame; None where it has none or cannot be read.

        Every use reads all files: keep what it returns.
        """
        files = self._frames[self.variant]
        found: list[int | float | None] = []
        for number in self.frame_numbers:
            found.append(None)
            with suppress(MeasurementError):
                found[-1] = read_time_stamp(files[number], self._companion)
        return tuple(found)

    @property
    def waveform(self) -> Waveform:
        """Frequencies of the first frame that can be read."""
        failures = []
        for path in (files[n] for files in self._frames.values() for n in sorted(files)):
            try:
                found: Waveform = self._read_once.get("waveform") or self._read(path).waveform
            except MeasurementError as error:
                failures.append(error)
                continue
            self._read_once["waveform"] = found
            return found
        raise failures[0]

    @property
    def metadata(self) -> dict[str, Any] | None:
        """Content of `metadata.json`, if there is one; its `mask_bb` is in radar space."""
        return self._beside(METADATA_FILE, read_json_object)

    @property
    def alignment(self) -> SensorAlignment | None:
        """Transforms of `alignment.json`, if there is one."""
        from measurement_io.maroon.alignment import read_alignment

        return self._beside(ALIGNMENT_FILE, read_alignment)

    @property
    def mesh_names(self) -> tuple[str, ...]:
        """Names of the photogrammetric meshes, without ".obj"."""
        return tuple(sorted(mesh_files(self._distance)))

    def scene(self, name: str = "mesh", *, alpha: float | np.ndarray = 0.5) -> Scene:
        """Return a photogrammetric mesh, one of `mesh_names`, in the antenna frame.

        p_antenna = diag(-1, 1, 1) T_photogrammetry2radar p_mesh, metres. Where that mirrors, the
        winding of the faces is turned, so that they keep their outside. `alpha` is as of
        `clradar.Scene`.
        """
        checks.text("Recording.scene: name", name)
        if (alignment := self.alignment) is None:
            fail(self._distance, f"{ALIGNMENT_FILE}, to place the mesh with", "none")
        meshes = mesh_files(self._distance)
        if name not in meshes:
            there = clean(", ".join(sorted(meshes))) or "no mesh"
            fail(self._distance / MESH_FOLDER, f"the mesh {clean(name)}.obj", there)
        matrix = alignment.to_antenna("photogrammetry")
        try:
            scene = Scene.from_mesh(meshes[name], transform=matrix)
        except MeshError as error:
            raise MeasurementError(str(error)) from error
        parts = scene.part_names if len(scene.part_names) > 1 else (name,)
        turn = -1 if np.linalg.det(matrix[:3, :3]) < 0 else 1
        return replace(scene, faces=scene.faces[:, ::turn], part_names=parts).with_alpha(alpha)

    def depth_map(self, index: int) -> DepthMap:
        """Return the depth map beside the frame at a position, as `read_depth_map` does."""
        from measurement_io.maroon.depth_map import read_depth_map

        return read_depth_map(self.path, self._number(index))

    def _number(self, index: int) -> int:
        position = operator.index(index)
        if not -len(self) <= position < len(self):
            raise IndexError(f"{shown(self.path)}: frame {position} of {len(self)}, from 0")
        return self.frame_numbers[position]

    def _capture_of_number(self, number: int) -> Capture:
        path = self._frames[self.variant][number]
        capture = self._read(path)
        firsts = (files[min(files)] for files in self._frames.values() if files)
        if "waveform" not in self._read_once and path == next(firsts):
            self._read_once["waveform"] = capture.waveform
        if not self.waveform.same_frequencies(capture.waveform):
            fail(path, "the frequencies of the recording's first frame", "others")
        return capture

    def _read(self, path: Path) -> Capture:
        return read_frame_file(path, self.array, self._companion)

    @property
    def _distance(self) -> Path:
        return self.path.absolute().parent

    def _beside(self, name: str, read: Callable[[Path], Any]) -> Any:
        """Return `read` of a file of the distance folder; None if it is not there."""
        if name not in self._read_once:
            path = self._distance / name
            with reading(path, "a file"):
                there = os.path.lexists(path)
            self._read_once[name] = read(path) if there else None
        return self._read_once[name]


def mesh_files(distance: Path) -> dict[str, Path]:
    """Return the meshes of an `<object>/<distance>` folder by their name without ".obj"."""
    folder = distance / MESH_FOLDER
    with reading(folder, "a folder of meshes"):
        if not folder.is_dir():
            return {}
    return {p.stem: p for p in folders.entries(folder) if p.suffix == ".obj"}
