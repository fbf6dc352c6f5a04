"""Statistics of a surface's images that tell how rough it is, and no pixel of its speckle.

docs/sweep-method.md says which, and why.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import csr_array

from calibration.roughness.regions import Regions
from clradar.errors import CompareError
from clradar.imaging.operator import ImagingOperator
from clradar.model import AntennaArray, Capture, DepthMap, Scene, Waveform
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

SPACING_M = 3e-3  # of the points; a quarter of the 14 cm aperture's pairs resolve 7.6 mm at 0.3 m
SAMPLES_PER_POINT = 8.0

PATCH_M = 10e-3
"""Edge of the cubes within which an image's phase relative to the smooth surface's is one: larger
than a resolution cell, small enough that a mesh displaced by a fraction of a degree fits."""

TILT_EDGES_DEG = (0.0, 4.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0, 55.0)
"""Bins of the angle between the normal and the bisector of Tx and Rx. The lobe of a surface with
the slope 0.1 falls by 1/e over 8 degrees, that of 0.3 over 23; beyond 55 degrees the surface is
seen at a grazing angle."""

LEAST_IN_BIN = 40  # points and apertures: the mean power of as many speckles is known to 0.7 dB
COHERENT, REST, CONTRAST, ALIKE = "coherent", "rest at", "contrast", "apertures alike"

LEAST_BRIGHT = 20  # points in a bin
LEVELS_DB = (3.0, 6.0, 10.0, 15.0, 20.0)  # below the brightest point
DARK = 1e-12  # power of a point that is 0, relative to the mean
PLACEMENT_STD_M = 1e-3  # how well a mesh is taken to be in its place, along x and y each


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
    bins = {f"{low:g} to {high:g} deg": number == i for i, (low, high) in ends}
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


class BrightnessMeter:
    """Measures the statistics of a region, or of the whole: in the image, at its surface's points.

    `names` are of what `measure` returns, natural logarithms.
    """

    def __init__(self, points: SurfacePoints, region: int | None, array: AntennaArray) -> None:
        mine = np.ones(len(points.region), bool) if region is None else points.region == region
        self._points_m = points.points_m[mine, :2]
        self.n_points = len(self._points_m)
        self.bins = tilt_bins(points.tilts([array])[0, mine], LEAST_BRIGHT)
        self.names = (
            *(f"power at {tilt}" for tilt in [*self.bins][:-1]),  # the last follows from the rest
            CONTRAST,
            *(f"within {level:g} dB" for level in LEVELS_DB),
        )

    def sees(self, image: DepthMap) -> bool:
        """Whether anything of the region is bright."""
        return bool(self._amplitude(image, (0.0, 0.0)).any())

    def measure(self, image: DepthMap, shift_m: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Return the statistics, with the surface displaced along x and y."""
        power = self._amplitude(image, shift_m).astype(np.float64) ** 2
        power = power / power.mean() + DARK
        bins = self.bins.values()
        means = [power[own].mean() for own in bins]
        near = [np.count_nonzero(power > power.max() * 10 ** (-level / 10)) for level in LEVELS_DB]
        return np.array([*np.log(means[:-1]), contrast(power, bins), *np.log(near)])

    def displaced(self, image: DepthMap) -> np.ndarray:
        """Return the variance of the statistics by a mesh that is not quite in its place."""
        middle = self.measure(image)
        variance = np.zeros_like(middle)
        for x, y in ((PLACEMENT_STD_M, 0.0), (0.0, PLACEMENT_STD_M)):
            one, other = self.measure(image, (x, y)), self.measure(image, (-x, -y))
            variance += ((one - other) ** 2 + (one + other - 2 * middle) ** 2) / 4
        return variance

    def _amplitude(self, image: DepthMap, shift_m: tuple[float, float]) -> np.ndarray:
        places_m = self._points_m + shift_m
        at = [
            (places_m[:, axis] - axis_m[0]) / (axis_m[1] - axis_m[0])
            for axis, axis_m in ((1, image.y_m), (0, image.x_m))
        ]
        return np.asarray(map_coordinates(image.amplitude, at, order=1, mode="nearest"))


class SubApertures:
    """Two halves of the Tx, each with two halves of the Rx: four views of points, metres."""

    def __init__(
        self, array: AntennaArray, waveform: Waveform, points_m: np.ndarray, device: Device
    ) -> None:
        self._pairs = [(tx, rx) for tx in halves(array.tx_m) for rx in halves(array.rx_m)]
        self.arrays = [AntennaArray(array.tx_m[tx], array.rx_m[rx]) for tx, rx in self._pairs]
        self._operators = [
            ImagingOperator(own, waveform, points_m, device=device) for own in self.arrays
        ]

    def images(self, capture: Capture) -> np.ndarray:
        """Mean over the pairs and frequencies, shape (4, n_points), complex64."""
        found = []
        for operator, pair in zip(self._operators, self._pairs, strict=True):
            samples = np.ascontiguousarray(capture.data[np.ix_(*pair)])
            found.append(operator.adjoint(samples) / np.float32(samples.size))
        return np.stack(found)


def halves(antennas_m: np.ndarray) -> list[np.ndarray]:
    """Indices of the antennas at either end of their longest extent; of a single one, that."""
    if len(antennas_m) < 2:
        return [np.arange(len(antennas_m))]
    off_m = antennas_m - antennas_m.mean(axis=0)
    axis = np.linalg.svd(off_m, full_matrices=False)[2][0]
    order = np.argsort(off_m @ axis, kind="stable")
    middle = len(order) // 2
    return [np.sort(order[:middle]), np.sort(order[middle:])]


class TextureMeter:
    """Measures the statistics of one region.

    `tilts`, shape (4, n_points), are in radians; `smooth`, of the same shape, images of the smooth
    surface from the quarters of the aperture. Where the gain is unknown, powers are relative to the
    coherent one. `names` are of what `measure` returns, natural logarithms.
    """

    def __init__(
        self,
        points: SurfacePoints,
        region: int,
        tilts: np.ndarray,
        smooth: np.ndarray,
        calibrated: bool,
    ) -> None:
        self._mine = points.region == region
        self._patch = np.unique(points.patch[self._mine], return_inverse=True)[1].ravel()
        self.n_points = len(self._patch)
        self._smooth = smooth[:, self._mine].astype(np.complex128)
        at = np.arange(self.n_points), self._patch
        self._sums = csr_array((np.ones(self.n_points), at))  # from points to patches
        self._smooth_power = np.abs(self._smooth) ** 2 @ self._sums
        self._level = float(np.mean(np.abs(self._smooth) ** 2))
        self.bins = tilt_bins(tilts[:, self._mine], LEAST_IN_BIN)
        rest = (f"{REST} {tilt}" for tilt in self.bins)
        self.names = (*(COHERENT,) * calibrated, *rest, CONTRAST, ALIKE)

    def measure(self, images: np.ndarray) -> np.ndarray:
        """The statistics of images (4, n_points), complex; powers relative to the smooth image."""
        mine = images[:, self._mine].astype(np.complex128)
        product = mine * self._smooth.conj() @ self._sums
        factor = product / np.maximum(self._smooth_power, 1e-300)
        rest = np.abs(mine - factor[:, self._patch] * self._smooth) ** 2 / self._level
        power = np.abs(mine) ** 2 + 1e-300
        coherent = np.sum(np.abs(product) ** 2) / np.sum(self._smooth_power**2)
        bins = self.bins.values()
        logarithms = np.log([coherent + 1e-300, *(rest[own].mean() + 1e-300 for own in bins)])
        if COHERENT not in self.names:
            logarithms = logarithms[1:] - logarithms[0]
        alike = [np.corrcoef(a, b)[0, 1] for a, b in combinations(np.sqrt(power), 2)]
        return np.array([*logarithms, contrast(power, bins), np.mean(alike) if alike else 0.0])
