"""Stratified samples of a triangle mesh on a device, and their visibility from antennas.

Host side of ``sample.cl``; equation E1 in ``docs/equations.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.errors import MeshError
from clradar.geometry.curved import corner_heights
from clradar.geometry.normals import corner_normals
from clradar.model import Scene
from clradar.opencl import Device, build
from clradar.tracing.settings import SimulationSettings
from clradar.tracing.surface_samples import sampled_areas_m2
from clradar.tracing.traced_mesh import TracedMesh


@dataclass(frozen=True, slots=True)
class SampleOptions:
    """Options of ``sample.cl``."""

    width: int = 1


MOST_SAMPLES = 2**31  # of a scene: their ordinals are signed numbers of 32 bits on the device


def samples_per_face(scene: Scene, settings: SimulationSettings) -> np.ndarray:
    """How many samples each face gets, shape (n_faces,), int64.

    By density: face f gets the whole numbers between the running areas before and after it, so that
    the total is right to one sample whatever the tessellation. They start at a random number below
    one sample, drawn by the seed: in the mean over seeds every face has as many samples as its area
    asks for, however small it is. Faces without area get none.
    """
    area_mm2 = sampled_areas_m2(scene) * 1e6
    if not (area_mm2 > 0).any():
        raise MeshError("scene: expected at least one face with an area, got only degenerate faces")
    if settings.rays_per_face is not None:
        return np.where(area_mm2 > 0, settings.rays_per_face, 0).astype(np.int64)
    assert settings.samples_per_mm2 is not None, "settings are resolved"
    _check_samples(float(area_mm2.sum()) * settings.samples_per_mm2)
    start = np.random.Generator(np.random.Philox(key=settings.seed)).random()
    running = np.floor(np.cumsum(area_mm2) * settings.samples_per_mm2 + start)
    counts = np.diff(running, prepend=0.0).astype(np.int64)
    if counts.sum() == 0:  # a scene smaller than one sample
        counts[int(area_mm2.argmax())] = 1
    return counts


def _check_samples(count: float) -> None:
    if count >= MOST_SAMPLES:
        raise MeshError(
            f"scene: expected fewer than 2^31 samples, got {count:.10g}; lower samples_per_mm2 or "
            "rays_per_face, or check the unit of the mesh"
        )


class SampledSurface(TracedMesh):
    """Samples of a scene's surface by resolved settings, and which antennas they see.

    No face with area, or 2^31 samples or more, is a `MeshError`.
    """

    def __init__(self, scene: Scene, settings: SimulationSettings, device: Device) -> None:
        super().__init__(device)
        self.settings = settings
        counts = samples_per_face(scene, settings)
        self.n_samples = int(counts.sum())
        _check_samples(self.n_samples)
        self._scene = scene
        self._face_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)

    def _prepare_surface(self, *antennas_m: np.ndarray) -> None:
        """Upload the mesh and its tree, for rays to any of `antennas_m`, shapes (n, 3)."""
        scene, s, up = self._scene, self.settings, self._buffers.upload
        triangles = scene.triangles_m
        self._prepare_tree(triangles, antennas_m)
        corners, faces = corner_normals(scene, s.normals, s.crease_deg)
        heights = np.zeros((len(faces), 3, 2))
        if s.facets == "curved":
            heights = corner_heights(triangles, corners)
        columns = (triangles, corners, heights, faces)
        self._sampling = [
            up(self._face_start),
            *(up(column.astype(np.float32)) for column in columns),
        ]
        self._sampler = build(self.device, "sample.cl", SampleOptions())

    def _sample(self, first: int, count: int, outputs: list[Any]) -> None:
        """Write samples to buffers: points on flat faces, shading normals, normals of the faces,
        faces, and points on the curved surface."""
        u = np.uint32
        self._sampler.launch(
            "sample_surface", (count,), u(len(self._face_start) - 1), u(first), u(count),
            *self._seed_words(), *self._sampling, *outputs,
        )  # fmt: skip

    def _seed_words(self) -> tuple[np.uint32, np.uint32]:
        seed = self.settings.seed
        return np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32)
