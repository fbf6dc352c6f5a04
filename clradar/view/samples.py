"""Samples of a data set as frames, read one at a time, with what each was made of."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset import Sample
from clradar.dataset.folder import read_manifest
from clradar.dataset.plan.recipe import pose_and_hand, recipe
from clradar.dataset.sample import recipe_grid, recipe_radar
from clradar.dataset.shards import data_bytes, read_sample
from clradar.files.failures import fail
from clradar.model import Capture, DepthMap, Volume
from clradar.view.drawn import Flat
from clradar.view.truth import Truth

KEPT_SAMPLES = 8

ALL = "all"

LOOK_S = 1.0
"""Between two looks at a data set that is written."""


class SampleFrames:
    """The stored samples of a data set as a source; frames have the numbers of the plan.

    Only the manifest is read at first. Of shards, one sample at a time is read, in a confined
    process; a few are kept.
    """

    def __init__(self, folder: Path, *, watch: bool = False) -> None:
        self.grows = watch
        self.name = folder.name or folder.absolute().name
        self._folder = folder
        self._manifest = read_manifest(folder)
        self._all = self._frames = tuple(self._manifest.stored)
        if not self._all and not watch:
            fail(folder, "a data set with at least one sample", "none")
        self._looked_s = time.perf_counter()
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

    def read(self, frame: int) -> Capture | Volume | Flat:
        """Read the volume that is stored, else the capture, else projection and depth map.

        Where only one of these two is stored, the other is without a value, or 1 where there is a
        depth.
        """
        sample = self._sample(frame)
        arrays = sample.arrays
        if "volume" not in arrays and "capture" in arrays:
            return Capture(arrays["capture"], *recipe_radar(sample.recipe))
        grid = recipe_grid(sample.recipe)
        if "volume" in arrays:
            return Volume(arrays["volume"], grid)
        known = {"projection": "max_projection", "depth": "depth_map"}
        known = {name: array for name, array in known.items() if array in arrays}
        if not known:
            fail(self._folder, "a product that can be drawn", ", ".join(sample.recipe["products"]))
        depth_m = arrays.get("depth_map", np.full(grid.shape[1:], np.nan))
        amplitude = np.abs(arrays.get("max_projection", np.isfinite(depth_m))).astype(np.float64)
        image = DepthMap(depth_m.astype(np.float64), amplitude, grid.x_m, grid.y_m)
        return Flat(image, tuple(known))

    def truth(self, frame: int) -> Truth:
        """Return what a sample was made of; errors as `read`."""
        sample = self._sample(frame)
        arrays = sample.arrays
        return Truth(
            arrays.get("mesh_vertices"),
            arrays.get("mesh_faces"),
            arrays.get("joints"),
            _lines(sample.recipe),
        )

    def choose(self, pose: str = ALL, hand: str = ALL) -> None:
        """Go through the samples of a pose and of "right" or "left" hands alone."""
        self._chosen = (pose, hand)
        self._frames = tuple(frame for frame in self._all if self._is_chosen(frame))

    def look(self) -> bool:
        """Wait a second, take in what was stored since; return whether there are other samples."""
        time.sleep(LOOK_S)
        manifest = read_manifest(self._folder)
        self._manifest, before = manifest, self._all
        self._all = tuple(manifest.stored)
        if self._all != before:
            self.grows, self._looked_s = True, time.perf_counter()
            self.choose(*self._chosen)
        return self._all != before

    def came_s(self, frame: int) -> float:
        """When the last samples were found: when they were written is not known."""
        return self._looked_s

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
            place = self._manifest.place_of(frame)
            if place is None:
                fail(self._folder, f"sample {frame}", "none that is stored")
            size = data_bytes(recipe(self._manifest.plan, frame))
            self._kept[frame], _ = read_sample(self._folder / place, frame, size)
            while len(self._kept) > KEPT_SAMPLES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(frame)
        return self._kept[frame]


def _lines(recipe: Mapping[str, Any]) -> tuple[str, ...]:
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
