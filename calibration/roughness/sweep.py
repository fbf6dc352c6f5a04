"""Sweep over alpha: which one's simulations have the statistics of a measured image."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from calibration.roughness import design
from calibration.roughness.estimates import AlphaEstimate, estimate_alpha
from calibration.roughness.meters import BrightnessMeter, surface_points
from calibration.roughness.regions import Regions
from clradar import arrays
from clradar.backproject import backproject
from clradar.compare.images import depth_map_of
from clradar.compare.metrics import METRICS, Metrics, check_size, metrics_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError, warn
from clradar.jobs.where import Where, open_devices
from clradar.model import AntennaArray, DepthMap, Scene, Volume, VoxelGrid, Waveform, checks
from clradar.model.progress import Progress
from clradar.model.volume import capture_meta
from clradar.opencl import Device
from clradar.simulation import simulate_alphas
from clradar.tracing.settings import SimulationSettings, resolve_settings, takes_settings

ESTIMATOR = "stochastic"

FEWEST_OF_ONE_SEED = 5  # alphas, where the scatter of a single seed follows from its neighbours
MAX_PASSES = 6  # over the regions, until the alpha of none goes to another simulated one


@dataclass(frozen=True, slots=True, eq=False)
class Sweep(design.Estimates):
    """Result of a sweep over alpha.

    Attributes
    ----------
    alphas : ndarray, shape (n_alphas,)
    seeds : tuple of int
    metrics : tuple of tuple of Metrics
        Against the measurement, [seed][alpha]; NaN if no ray reached a receiver.
    estimates : tuple of AlphaEstimate
        That of the whole mesh, `estimate`, then those of the `regions`.
    measured : DepthMap
    images : tuple of DepthMap or None
        Of each alpha and the first seed.
    """

    wanted: ClassVar[str] = "alpha"
    drawn: ClassVar[tuple[str, ...]] = ("measured", "images")

    alphas: np.ndarray
    seeds: tuple[int, ...]
    metrics: tuple[tuple[Metrics, ...], ...]
    estimates: tuple[AlphaEstimate, ...]
    measured: DepthMap
    images: tuple[DepthMap | None, ...]

    @property
    def estimate(self) -> AlphaEstimate:
        return self.estimates[0]

    @property
    def regions(self) -> tuple[AlphaEstimate, ...]:
        return self.estimates[1:]

    @property
    def nearest(self) -> int:
        """Index of the simulated alpha nearest to the estimate."""
        return int(np.argmin(np.abs(self.alphas - self.estimate.alpha)))

    def of(self, metric: str) -> np.ndarray:
        """One metric of all simulations, shape (n_seeds, n_alphas)."""
        return np.array([[getattr(m, metric) for m in row] for row in self.metrics])

    def tables(self) -> list[design.Table]:
        """Metrics of each simulation, and limits of each region's alpha."""
        rows = [
            [float(alpha), seed, *(getattr(self.metrics[k][i], name) for name in METRICS)]
            for i, alpha in enumerate(self.alphas)
            for k, seed in enumerate(self.seeds)
        ]
        regions = [[r.name, *(getattr(r.interval, n) for n in design.LIMITS)] for r in self.regions]
        metrics = ("alpha", "seed", *METRICS), rows
        return [metrics, (("region", *design.LIMITS), regions)] if regions else [metrics]


@takes_settings
def sweep(
    measured: Volume,
    scene: Scene,
    alphas: Sequence[float] | np.ndarray,
    *,
    seeds: int = design.SEEDS,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    regions: Regions | None = None,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    method: str = "fast",
    window: str = "rect",
    device: Where | Device | str | Sequence[str] | None = None,
    store: design.Store | None = None,
    progress: Progress | None = None,
    settings: SimulationSettings | None = None,
    **fields: Any,
) -> Sweep:
    """Simulate a mesh at several alphas and compare each image with a measured one.

    docs/sweep-method.md has the statistics that are compared. Every remark of the result is a
    warning.

    Parameters
    ----------
    measured : Volume
        Of the object, in the antenna frame. Simulations are imaged on its grid.
    scene : Scene
        In its measured pose; its own alpha is not used.
    alphas : array_like, shape (n_alphas,)
        Ascending, in [0, 1], at least two.
    seeds : int
        Number of seeds, from that of the settings upwards; one needs at least five alphas.
    regions : Regions, optional
        Estimate an alpha for each of these, too; single reflections only.
    array, waveform
        As for `align_mesh`.
    dynamic_range_db, method, window
        As of `clradar.compare` and `clradar.backproject`.
    device : Where, Device, str, sequence of str or None
        Several of one kind ("all") share the images, to the same bits.
    store : mutable mapping, optional
        Keeps images as they are simulated, so that an interrupted sweep resumes to the same bits.
    settings, **fields
        Of `clradar.SimulationSettings`.

    Raises
    ------
    CompareError
        The measured image has no depth; the mesh lies outside of it; a region is not visible or too
        small; or no ray reaches a receiver.

    Examples
    --------
    A ball, simulated with another seed in place of a measurement:

    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(4, 0.04)
    >>> scene = clradar.Scene(ball.vertices + [0, 0, 0.3], ball.faces)
    >>> array = clradar.arrays.qar50().part(np.s_[::4], np.s_[::4])
    >>> radar = {"array": array, "waveform": clradar.Waveform.sfcw(72e9, 82e9, 16)}
    >>> rays = {"samples_per_mm2": 2, "reception_radius_m": 0.02, "estimator": "stochastic"}
    >>> capture = clradar.simulate(scene.with_alpha(0.4), **radar, **rays, seed=9)
    >>> grid = clradar.VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.252, 0.32), 4e-3)
    >>> image = clradar.backproject(capture, grid, check_grid=False)
    >>> found = calibration.sweep(image, scene, [0.1, 0.3, 0.5, 0.7], seeds=2, **radar, **rays)
    >>> bool(abs(found.estimate.alpha - 0.4) < 3 * found.estimate.uncertainty)
    True
    """
    checks.instance("sweep: measured", measured, Volume)
    checks.instance("sweep: scene", scene, Scene)
    values = checks.one_axis("sweep: alphas", alphas)
    if len(values) < 2 or values[0] < 0.0 or values[-1] > 1.0:
        checks.fail("sweep: alphas", "at least two in [0, 1]", f"{values.tolist()}")
    n_seeds = checks.whole("sweep: seeds", seeds, 1)
    if n_seeds == 1 and len(values) < FEWEST_OF_ONE_SEED:
        expected = f"at least two, or {FEWEST_OF_ONE_SEED} alphas"
        checks.fail("sweep: seeds", expected, f"one, of {len(values)} alphas")
    resolved = resolve_settings(settings, **fields)
    first = checks.whole("sweep: seed", resolved.seed, 0, 2**64 - n_seeds)
    names = design.check_regions("sweep", regions, scene)
    if names and resolved.max_bounces > 1:
        checks.fail("sweep: max_bounces", "1 where there are regions", resolved.max_bounces)
    radar = arrays.qar50() if array is None else array
    frequencies = Waveform.sfcw(72e9, 82e9, 128) if waveform is None else waveform
    checks.instance("sweep: array", radar, AntennaArray)
    checks.instance("sweep: waveform", frequencies, Waveform)
    measured_map = depth_map_of(measured, dynamic_range_db, "measured image")
    check_size(measured_map)
    check_within_grid(scene, measured.grid)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    points = surface_points(scene, regions, radar.tx_m.mean(axis=0), devices.first)
    meters = [BrightnessMeter(points, i, radar) for i in (None, *range(len(names)))]
    design.estimable("alpha", (design.WHOLE, *names), meters)
    imaging = {"method": method, "window": window, "check_grid": False}
    given = (
        scene, (radar, frequencies), values, tuple(range(first, first + n_seeds)), regions,
        measured.grid, imaging, dynamic_range_db, resolved,
    )  # fmt: skip
    images = _Images(design.fingerprint(*given), *given)
    kept: design.Store = {} if store is None else store
    images.simulate_missing(kept, devices, progress)
    whole = images.along(kept, lambda i: (i,) * max(1, len(names)))
    none: dict[str, Any] = dict.fromkeys(METRICS, math.nan)
    unknown = Metrics(**none, dynamic_range_db=dynamic_range_db)

    def compared(one: DepthMap | None) -> Metrics:
        return metrics_of(measured_map, one, dynamic_range_db) if one else unknown

    estimates = (
        _estimate(design.WHOLE, meters[0], measured_map, whole, values),
        *_of_regions(names, meters[1:], measured_map, images, kept),
    )
    metrics = tuple(tuple(map(compared, row)) for row in whole)
    result = Sweep(values, images.seeds, metrics, estimates, measured_map, tuple(whole[0]))
    # Of a simulation in place of a measurement.
    estimator = capture_meta(measured.meta).get("settings", {}).get("estimator", ESTIMATOR)
    if estimator != ESTIMATOR:
        warn(
            f"sweep: the measured image is a simulation by the {estimator} estimator, whose images "
            f"have other statistics than those of the {ESTIMATOR} one that is swept"
        )
    result.warn()
    return result


def _estimate(
    name: str,
    meter: BrightnessMeter,
    measured: DepthMap,
    images: Sequence[Sequence[DepthMap | None]],
    alphas: np.ndarray,
) -> AlphaEstimate:
    """The alpha of a region, from images [seed][alpha]."""
    if not meter.sees(measured):
        raise CompareError(f"sweep: the measured image is 0 in the region '{name}'")
    seen = [
        (alpha, meter.measure(image), meter.displaced(image))
        for row in images
        for alpha, image in zip(alphas, row, strict=True)
        if image is not None and meter.sees(image)
    ]
    simulated, statistics, displaced = (np.array([one[i] for one in seen]) for i in range(3))
    if (n := len(np.unique(simulated))) < 2:
        raise CompareError(
            f"sweep: no ray reaches a receiver from the region '{name}' at all alphas but "
            f"{n}; look at where the mesh is placed, or take more samples or rays"
        )
    return estimate_alpha(
        name, meter.names, meter.measure(measured), simulated, statistics, displaced, meter.n_points
    )


def _of_regions(
    names: tuple[str, ...],
    meters: list[BrightnessMeter],
    measured: DepthMap,
    images: _Images,
    store: design.Store,
) -> tuple[AlphaEstimate, ...]:
    """The alpha of each region, the others at the simulated ones nearest to theirs.

    With single reflections a capture is the sum over the regions, and so is its image. What the
    others' own uncertainty adds follows from estimates with their neighbours on the grid.
    """
    alphas, n = images.alphas, len(names)

    @cache
    def among(region: int, others: tuple[int, ...]) -> AlphaEstimate:
        along = images.along(store, lambda i: (*others[:region], i, *others[region:]))
        return _estimate(names[region], meters[region], measured, along, alphas)

    def estimate(region: int, at: Sequence[int]) -> AlphaEstimate:
        return among(region, (*at[:region], *at[region + 1 :]))

    best = [len(alphas) // 2] * n
    for _ in range(MAX_PASSES):
        before = list(best)
        for region in range(n):
            best[region] = int(np.argmin(np.abs(alphas - estimate(region, best).alpha)))
        if best == before:
            break
    found = [estimate(region, best) for region in range(n)]
    widened = []
    for region, one in enumerate(found):
        variance = 0.0
        for other in (i for i in range(n) if i != region):
            moved = list(best)
            moved[other] += 1 if best[other] + 1 < len(alphas) else -1
            change = estimate(region, moved).alpha - one.alpha
            slope = change / (alphas[moved[other]] - alphas[best[other]])
            off = found[other].alpha - alphas[best[other]]  # the other is simulated at
            variance += slope**2 * (found[other].uncertainty ** 2 + off**2)
        std = one.interval.std
        factor = math.hypot(std, math.sqrt(variance)) / max(std, 1e-6)
        own = np.array([getattr(one.interval, limit) for limit in design.LIMITS])
        limits = np.clip(own[0] + factor * (own - own[0]), *alphas[[0, -1]]).tolist()
        interval = replace(one.interval, **dict(zip(design.LIMITS, limits, strict=True)))
        widened.append(replace(one, interval=interval))
    return tuple(widened)


def check_within_grid(scene: Scene, grid: VoxelGrid) -> None:
    """Raise `CompareError` unless the mesh's box and the volume's overlap."""
    corners_m = scene.vertices_m[np.unique(scene.faces)]
    mesh_mm = 1e3 * np.stack([corners_m.min(axis=0), corners_m.max(axis=0)], axis=1)
    grid_mm = 1e3 * np.array([axis_m[[0, -1]] for axis_m in (grid.x_m, grid.y_m, grid.z_m)])
    apart = (mesh_mm[:, 1] < grid_mm[:, 0]) | (mesh_mm[:, 0] > grid_mm[:, 1])
    if apart.any():
        mesh, volume = (
            ", ".join(f"{n} {a:.4g} to {b:.4g}" for n, (a, b) in zip("xyz", box, strict=True))
            for box in (mesh_mm, grid_mm)
        )
        raise CompareError(
            f"sweep: expected the mesh within the measured volume ({volume} mm), got it at {mesh} "
            "mm; place it (--transform), and check the unit it was read in"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Images:
    """The images of a sweep: makes those of some alphas of one seed on a device.

    A store has depth maps of the whole mesh, or volumes of the regions, by names that begin alike.
    """

    begin: str
    scene: Scene
    radar: tuple[AntennaArray, Waveform]
    alphas: np.ndarray
    seeds: tuple[int, ...]
    regions: Regions | None
    grid: VoxelGrid
    imaging: dict[str, Any]  # arguments of `backproject`
    dynamic_range_db: float
    settings: SimulationSettings

    def __call__(
        self, item: tuple[int, list[int]], device: Device, progress: Progress
    ) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
        """Yield name and arrays of the images of seed k and some alphas."""
        k, indices = item
        captures = simulate_alphas(
            self.scene, *self.radar, list(self.alphas[indices]),
            region=None if self.regions is None else self.regions.face,
            settings=replace(self.settings, seed=self.seeds[k]), device=device, progress=progress,
        )  # fmt: skip
        for i, of_alpha in zip(indices, captures, strict=True):
            for r, capture in enumerate(of_alpha):
                volume = backproject(capture, self.grid, **self.imaging, device=device)
                found = {"data": volume.data}
                if self.regions is None:
                    depth = volume.depth_map(self.dynamic_range_db)
                    found = {"depth_m": depth.depth_m, "amplitude": depth.amplitude}
                yield self._name(k, i, r), found

    def simulate_missing(
        self, store: design.Store, devices: Where, progress: Progress | None
    ) -> None:
        """Simulate the images that the store lacks, and store each as soon as it is finished."""
        seeds, alphas = range(len(self.seeds)), range(len(self.alphas))
        regions = range(1 if self.regions is None else len(self.regions.names))
        missing = [
            [i for i in alphas if any(self._name(k, i, r) not in store for r in regions)]
            for k in seeds
        ]
        # A batch of alphas shares rays, so they are divided no more than the devices need.
        n_devices = len(devices.infos)
        parts = n_devices // math.gcd(n_devices, len(seeds))
        items = [(k, own) for k in seeds for n in range(parts) if (own := missing[k][n::parts])]
        for _, (name, image) in devices.made(self, items, progress):
            store[name] = image

    def along(
        self, store: design.Store, at: Callable[[int], tuple[int, ...]]
    ) -> list[list[DepthMap | None]]:
        """The depth maps [seed][alpha], where an alpha of the sweep is one for each region."""
        alphas, seeds = range(len(self.alphas)), range(len(self.seeds))
        return [[self._of(store, k, at(i)) for i in alphas] for k in seeds]

    def _of(self, store: design.Store, k: int, at: tuple[int, ...]) -> DepthMap | None:
        """The depth map of a seed, with an alpha for each region; None where it is zero."""
        if self.regions is None:
            stored = store[self._name(k, at[0], 0)]
            if not stored["amplitude"].any():
                return None
            axes = (self.grid.x_m, self.grid.y_m)
            return DepthMap(stored["depth_m"], stored["amplitude"], *axes, self.dynamic_range_db)
        data = np.zeros(self.grid.shape, np.complex64)
        for r, i in enumerate(at):
            data += store[self._name(k, i, r)]["data"]
        return Volume(data, self.grid).depth_map(self.dynamic_range_db) if data.any() else None

    def _name(self, k: int, i: int, r: int) -> str:
        return f"{self.begin}-seed{k}-alpha{i}-region{r}"
