"""Points of a mesh's visible surface at which images are read, and groups of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calibration.roughness.regions import Regions
from clradar.errors import CompareError
from clradar.model import AntennaArray, Scene
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

SPACING_M = 3e-3
"""Of the points. A quarter of the 14 cm aperture's pairs resolve 7.6 mm at 0.3 m."""

PATCH_M = 10e-3
"""Edge of the cubes within which an image's phase relative to the smooth surface's is one: larger
than a resolution cell, small enough that a mesh displaced by a fraction of a degree fits."""

SAMPLES_PER_POINT = 8.0

TILT_EDGES_DEG = (0.0, 4.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0, 55.0)
"""Bins of the angle between the normal and the bisector of Tx and Rx. The lobe of a surface with
the slope 0.1 falls by 1/e over 8 degrees, that of 0.3 over 23; beyond 55 degrees the surface is
seen at a grazing angle."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points of the surface that the aperture's centre sees, shape (n, 3) or (n,)."""

    points_m: np.ndarray
    normals: np.ndarray  # of length 1, turned to the aperture
    region: np.ndarray
    patch: np.ndarray  # number of the cube that a point is in; those of two regions have two

    def tilts(self, apertures: list[AntennaArray]) -> np.ndarray:
        """Angles between normals and bisectors of Tx and Rx, (n_apertures, n), radians."""
        found = []
        for array in apertures:
            bisector = np.zeros_like(self.points_m)
            for antennas_m in (array.tx_m, array.rx_m):
                towards = antennas_m.mean(axis=0) - self.points_m
                bisector += towards / np.linalg.norm(towards, axis=1, keepdims=True)
            cosine = np.einsum("pa,pa->p", bisector, self.normals)
            found.append(np.clip(cosine / np.linalg.norm(bisector, axis=1), -1.0, 1.0))
        return np.arccos(np.stack(found))


def tilt_bins(tilts: np.ndarray, least: int) -> dict[str, np.ndarray]:
    """Which of these tilts, radians, are in each bin of `TILT_EDGES_DEG` with at least so many."""
    number = np.digitize(np.degrees(tilts), TILT_EDGES_DEG)
    ends = enumerate(pairwise(TILT_EDGES_DEG), 1)
    bins = {f"{low:g} to {high:g} degrees": number == i for i, (low, high) in ends}
    return {name: own for name, own in bins.items() if np.count_nonzero(own) >= least}


def contrast(power: np.ndarray, bins: Collection[np.ndarray]) -> float:
    """Mean of ln(power) less ln of the mean, in the bins: -0.58 for full speckle."""
    grain = [np.log(power[own]).mean() - np.log(power[own].mean()) for own in bins]
    return float(np.average(grain, weights=[np.count_nonzero(own) for own in bins]))


def surface_points(
    scene: Scene, regions: Regions | None, centre_m: np.ndarray, device: Device
) -> SurfacePoints:
    """The points of a scene in its measured pose that are visible from `centre_m`.

    One in every cube of `SPACING_M` that the surface passes, so that their number per area hardly
    depends on the surface's direction.
    """
    density = SAMPLES_PER_POINT / (1e3 * SPACING_M) ** 2
    reach_m = float(np.linalg.norm(centre_m)) + 1.0
    with VisibleSurface(scene, density, reach_m, device) as surface:
        seen = surface.visible_from(centre_m[None])[:, 0]
        points_m, normals = surface.points_m[seen], surface.normals[seen]
    if not len(points_m):
        raise CompareError("sweep: no part of the mesh is visible from the antennas")
    away = np.einsum("pa,pa->p", normals, centre_m - points_m) < 0
    normals = np.where(away[:, None], -normals, normals)
    cell = _cells(points_m, SPACING_M, np.zeros(len(points_m), int))
    mean_m, normal = _means(points_m, cell), _means(normals, cell)
    label = np.zeros(len(mean_m), int)
    if regions is not None:
        from scipy.spatial import cKDTree  # the region of the face whose centroid is nearest

        label = regions.face[cKDTree(scene.triangles_m.mean(axis=1)).query(mean_m)[1]]
        hidden = [name for i, name in enumerate(regions.names) if not (label == i).any()]
        if hidden:
            raise CompareError(f"sweep: region '{hidden[0]}' is not visible from the antennas")
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return SurfacePoints(mean_m, normal, label, _cells(mean_m, PATCH_M, label))


def _cells(points_m: np.ndarray, edge_m: float, label: np.ndarray) -> np.ndarray:
    """Number of the cube and region that each point is in, from 0, without gaps."""
    cube = np.floor(points_m / edge_m).astype(np.int64)
    return np.unique(np.column_stack([label, cube]), axis=0, return_inverse=True)[1].ravel()


def _means(values: np.ndarray, cell: np.ndarray) -> np.ndarray:
    total = np.stack([np.bincount(cell, column) for column in values.T], axis=1)
    return total / np.bincount(cell)[:, None]
