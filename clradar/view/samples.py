"""Samples of a data set as frames, read one at a time, and the truth of each."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset import Sample
from clradar.dataset.plan.recipe import pose_and_hand, recipe
from clradar.dataset.sample import recipe_grid, recipe_radar
from clradar.dataset.store.confined_reader import read_sample
from clradar.dataset.store.folder import PART_NAME, PARTS, Manifest, read_manifest, stored_path
from clradar.dataset.store.shard_schema import data_bytes
from clradar.files.failures import fail
from clradar.model import Capture, Volume

KEPT_SAMPLES = 8

ALL = "all"


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a sample was made of.

    Attributes
    ----------
    vertices_m : ndarray, shape (n, 3), or None
        Of the mesh, where it is stored.
    faces : ndarray, shape (m, 3), or None
    joints_m : ndarray, shape (25, 3), or None
        In the order of `clradar.hand.JOINT_NAMES`; NaN where a rig has none.
    lines : tuple of str
        Pose, hand, place and surface in words.
    """

    vertices_m: np.ndarray | None
    faces: np.ndarray | None
    joints_m: np.ndarray | None
    lines: tuple[str, ...]


class SampleFrames:
    """The stored samples of a data set as a source; frames have the numbers of the plan.

    Only the manifest is read at first. Of shards, one sample at a time is read, in a confined
    process; a few are kept.

    Parameters
    ----------
    folder : Path
        As ``clradar dataset`` writes it, complete or not.
    follow : bool
        Whether a view looks at it again, see `Follower`; it may be empty at first.

    Raises
    ------
    MeasurementError
        It is no data set, damaged, or no sample is stored yet.
    """

    def __init__(self, folder: Path, *, follow: bool = False) -> None:
        self.follow = follow
        self.name = folder.name or folder.absolute().name
        self._folder = folder
        self._manifest = read_manifest(folder)
        self._all = self._frames = tuple(_stored(folder, self._manifest))
        if not self._all and not follow:
            fail(folder, "a data set with at least one sample", "none")
        self._chosen = (ALL, ALL)
        self._kept: OrderedDict[int, Sample] = OrderedDict()
        self._names: dict[int, tuple[str, str]] = {}
        plan = self._manifest.plan
        named = plan.poses.kind in ("list", "around")
        self.poses: tuple[str, ...] = ()
        if named:
            self.poses = tuple(dict.fromkeys(pose.name for pose in plan.poses.poses))

    def frames(self) -> tuple[int, ...]:
        return self._frames

    def label(self, frame: int) -> str:
        return f"sample {frame}"

    def read(self, frame: int) -> Capture | Volume:
        sample = self._sample(frame)
        arrays = sample.arrays
        if "volume" not in arrays and "capture" in arrays:
            return Capture(arrays["capture"], *recipe_radar(sample.recipe))
        if not arrays.keys() & {"volume", "max_projection", "depth_map"}:
            fail(self._folder, "a product that can be drawn", ", ".join(sample.recipe["products"]))
        grid = recipe_grid(sample.recipe)
        return Volume(arrays["volume"] if "volume" in arrays else _relief(arrays, grid.z_m), grid)

    def truth(self, frame: int) -> Truth:
        """Return what a sample was made of; errors as `read`."""
        sample = self._sample(frame)
        arrays = sample.arrays
        return Truth(
            arrays.get("mesh_vertices"),
            arrays.get("mesh_faces"),
            arrays.get("joints"),
            _in_words(sample.recipe),
        )

    def choose(self, pose: str = ALL, hand: str = ALL) -> None:
        """Go through the samples of a pose and of "right" or "left" hands alone."""
        self._chosen = (pose, hand)
        self._frames = tuple(frame for frame in self._all if self._is_chosen(frame))

    def look(self) -> bool:
        """Take in samples that were stored since; return whether there are others now.

        Raises
        ------
        MeasurementError
            The manifest cannot be read; the samples are those of before.
        """
        manifest = read_manifest(self._folder)
        self._manifest, before = manifest, self._all
        self._all = tuple(_stored(self._folder, manifest))
        if self._all != before:
            self.choose(*self._chosen)
        return self._all != before

    def _is_chosen(self, frame: int) -> bool:
        if self._chosen == (ALL, ALL):
            return True
        if frame not in self._names:
            self._names[frame] = pose_and_hand(self._manifest.plan, frame)
        return all(
            wanted in (ALL, found)
            for wanted, found in zip(self._chosen, self._names[frame], strict=True)
        )

    def _sample(self, frame: int) -> Sample:
        if frame not in self._kept:
            path = stored_path(self._folder, self._manifest, frame)
            if path is None:
                fail(self._folder, f"sample {frame}", "none that is stored")
            size = data_bytes(recipe(self._manifest.plan, frame))
            self._kept[frame], _ = read_sample(path, frame, size)
            while len(self._kept) > KEPT_SAMPLES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(frame)
        return self._kept[frame]


def _stored(folder: Path, manifest: Manifest) -> list[int]:
    found = [
        sample
        for number, shard in manifest.shards.items()
        if shard.file is not None
        for sample in manifest.plan.shard_samples(number)
        if sample not in manifest.aside
    ]
    parts = folder / PARTS
    if not manifest.complete and parts.is_dir():  # of shards that are still open
        for path in parts.iterdir():
            if PART_NAME.fullmatch(path.name) and path.suffix == ".h5":
                sample = int(path.stem)
                if sample // manifest.plan.output.shard_size not in manifest.shards:
                    found.append(sample)
    return sorted(found)


def _relief(arrays: Mapping[str, np.ndarray], z_m: np.ndarray) -> np.ndarray:
    """Return voxels with the maximum projection at the depths of the depth map, 0 elsewhere.

    Without a depth map all are in the middle, without a projection all are 1.
    """
    known = arrays.get("depth_map", arrays.get("max_projection"))
    assert known is not None
    rows, columns = np.nonzero(np.isfinite(known))
    planes = np.full(len(rows), len(z_m) // 2)
    if "depth_map" in arrays:
        depths_m = arrays["depth_map"][rows, columns]
        planes = np.abs(z_m[:, None] - depths_m).argmin(axis=0)
    data = np.zeros((len(z_m), *known.shape), np.complex64)
    data[planes, rows, columns] = 1.0
    if "max_projection" in arrays:
        data[planes, rows, columns] = arrays["max_projection"][rows, columns]
    return data


def _in_words(recipe: Mapping[str, Any]) -> tuple[str, ...]:
    hand, placement = recipe["hand"], recipe["placement"]
    centre_mm = ", ".join(f"{1e3 * value:.1f}" for value in placement["center_m"])
    turns_deg = ", ".join(f"{np.degrees(value):.1f}" for value in placement["rotation_rad"])
    lines = [
        f"pose {recipe['pose']['name']}, {hand['handedness']} hand",
        f"centre ({centre_mm}) mm, turned by ({turns_deg})°",
    ]
    if "rig" in hand:
        lines.append(f"rig {Path(hand['rig']['file']).name}")
    if "alpha" in recipe:
        parts = ", ".join(f"{name} {value:.2f}" for name, value in recipe["alpha"].items())
        lines.append(f"alpha: {parts}")
    return tuple(lines)
