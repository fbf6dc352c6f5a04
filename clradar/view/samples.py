"""Samples of a data set as frames, read one at a time, with what each was made of."""

from __future__ import annotations

import time
from functools import lru_cache
from pathlib import Path

import numpy as np

from clradar.dataset import Sample
from clradar.dataset.folder import read_manifest
from clradar.dataset.sample import SamplePlan, read_recipe
from clradar.dataset.shards import read_sample
from clradar.files.failures import fail
from clradar.model import Capture, DepthMap, Volume
from clradar.view.drawn import Flat
from clradar.view.truth import Truth

KEPT_SAMPLES = 8

LOOK_S = 1.0
"""Between two looks at a data set that is written."""


class SampleFrames:
    """The stored samples of a data set, numbered as in the plan, read one at a time."""

    def __init__(self, folder: Path, *, watch: bool = False) -> None:
        self.grows = watch
        self.name = folder.name or folder.absolute().name
        self._folder = folder
        self._manifest = read_manifest(folder)
        self._frames = tuple(self._manifest.stored)
        if not self._frames and not watch:
            fail(folder, "a data set with at least one sample", "none")
        self._looked_s = time.perf_counter()
        self._sample = lru_cache(KEPT_SAMPLES)(self._read_sample)

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
            radar = read_recipe(sample.recipe).plan.radar
            return Capture(arrays["capture"], radar.antennas, radar.waveform)
        grid = self._manifest.plan.image.grid
        if "volume" in arrays:
            return Volume(arrays["volume"], grid)
        known = {"projection": "max_projection", "depth": "depth_map"}
        known = {name: array for name, array in known.items() if array in arrays}
        if not known:
            fail(self._folder, "a product that can be drawn", ", ".join(arrays))
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
            _lines(read_recipe(sample.recipe)),
        )

    def look(self) -> bool:
        """Wait a second, take in what was stored since; return whether there are other samples."""
        time.sleep(LOOK_S)
        self._manifest, before = read_manifest(self._folder), self._frames
        self._frames = tuple(self._manifest.stored)
        if self._frames != before:
            self.grows, self._looked_s = True, time.perf_counter()
        return self._frames != before

    def came_s(self, frame: int) -> float:
        """When the last samples were found: when they were written is not known."""
        return self._looked_s

    def _read_sample(self, frame: int) -> Sample:
        shard = self._folder / self._manifest.place_of(frame)
        return read_sample(shard, frame, self._manifest.plan)[0]


def _lines(drawn: SamplePlan) -> tuple[str, ...]:
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
