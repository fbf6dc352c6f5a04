"""Segmentation of image pixels by the region of the mesh visible in them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from calibration.roughness.regions import Regions
from clradar.errors import CompareError
from clradar.model import DepthMap, Scene, VoxelGrid
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

REACH_M = 4e-3
"""Largest distance along x and y of a pixel from the visible surface it shows: the lateral
resolution of the imager."""

VISIBILITY_SAMPLES_PER_MM2 = 1.0

EVERYTHING_DB = 400.0
"""Dynamic range that keeps every non-zero pixel of a depth map."""


def region_pixels(
    scene: Scene, regions: Regions, grid: VoxelGrid, centre_m: np.ndarray, device: Device
) -> np.ndarray:
    """Number of the region that each pixel shows from the viewpoint `centre_m`, -1 for none.

    The scene is in its measured pose; the result has shape (n_y, n_x).

    Raises
    ------
    CompareError
        A region is visible in no pixel.
    """
    triangles = scene.triangles_m
    reach_m = float(np.linalg.norm(centre_m)) + 1.0
    with VisibleSurface(scene, VISIBILITY_SAMPLES_PER_MM2, reach_m, device) as surface:
        points_m = surface.points_m[surface.visible_from(centre_m[None])[:, 0]]
    # By the centroids of the faces: either they are smaller than the pixels, or the regions are
    # large compared with them.
    _, nearest = cKDTree(triangles.mean(axis=1)).query(points_m)
    label = regions.face[nearest]
    x_m, y_m = np.meshgrid(grid.x_m, grid.y_m)
    pixels_m = np.stack([x_m.ravel(), y_m.ravel()], axis=1)
    found = np.full(len(pixels_m), -1)
    if len(points_m):
        apart_m, at = cKDTree(points_m[:, :2]).query(pixels_m)
        found = np.where(apart_m <= REACH_M, label[at], -1)
    for number, name in enumerate(regions.names):
        if not (found == number).any():
            raise CompareError(f"sweep: region '{name}' is visible in no pixel of the image")
    return found.reshape(x_m.shape)


def within(image: DepthMap, pixels: np.ndarray, dynamic_range_db: float) -> DepthMap | None:
    """Restrict an image to some pixels, cut below their own maximum; None if they are zero.

    `image` has a depth wherever its amplitude is not zero; `pixels` has shape (n_y, n_x), bool.
    """
    amplitude = np.where(pixels, image.amplitude, np.float32(0))
    top = float(amplitude.max())
    if top == 0.0:
        return None
    kept = (amplitude >= top * 10.0 ** (-dynamic_range_db / 20.0)) & (amplitude > 0)
    depth_m = np.where(kept, image.depth_m, np.nan)
    return DepthMap(depth_m, amplitude, image.x_m, image.y_m, dynamic_range_db)
