"""Simulate a placed mesh at several alphas, and find the one that is most like a measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.roughness.estimate import AlphaEstimate, estimate_alpha
from calibration.roughness.region_pixels import EVERYTHING_DB, region_pixels
from calibration.roughness.region_sweep import RegionImages, RegionSweep, sweep_regions
from calibration.roughness.regions import Regions
from clradar import arrays
from clradar.backproject import backproject
from clradar.compare import METRICS, Metrics, compare, depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import (
    AntennaArray,
    Capture,
    DepthMap,
    Scene,
    Volume,
    VoxelGrid,
    Waveform,
    checks,
)
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device
from clradar.simulation import simulate_alphas
from clradar.tracing.settings import resolve_settings

SEEDS = 3

METRIC = "db_correlation"
"""Needed hundreds of times, and a thousand times as fast as the overlap, which finds alpha about as
well once speckle is taken out (docs/sweep.md)."""

Store = MutableMapping[str, dict[str, np.ndarray]]
"""Where the images that are done are kept: name -> arrays. A dict, or one that keeps files."""

TRACING_SHARE = 0.75
"""Of the time that one image takes, for the progress bar."""

_STEPS = 1000  # of the progress bar, per image


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """What a sweep over alpha found.

    Attributes
    ----------
    alphas : ndarray, shape (A,)
    seeds : tuple of int
    metrics : tuple of tuple of Metrics
        [seed][alpha]; every number NaN where no ray reached a receiver.
    estimate : AlphaEstimate
        The best alpha of the whole mesh.
    measured : DepthMap
    images : tuple of DepthMap or None
        One per alpha, of the first seed.
    regions : RegionSweep or None
        The best alpha of each region, where regions were given.
    """

    alphas: np.ndarray
    seeds: tuple[int, ...]
    metrics: tuple[tuple[Metrics, ...], ...]
    estimate: AlphaEstimate
    measured: DepthMap
    images: tuple[DepthMap | None, ...]
    regions: RegionSweep | None

    def of(self, metric: str) -> np.ndarray:
        """Return one metric of all simulations, shape (K, A)."""
        return np.array([[getattr(m, metric) for m in row] for row in self.metrics])

    def report(self) -> str:
        """Return what was found, in words."""
        found = self.estimate
        seeds = ", ".join(f"{alpha:.3f}" for alpha in found.per_seed)
        lines = [
            f"best alpha {found.text()} by {found.metric}"
            + (", speckle taken out" if found.corrected else ""),
            f"  per seed {seeds}; the metric itself peaks at {found.metric_peak:.3f}",
            *(f"  {remark}" for remark in found.remarks(self.alphas)),
        ]
        if self.regions is not None:
            for name, one in zip(self.regions.names, self.regions.estimates, strict=True):
                lines.append(f"best alpha of {name} {one.text()}, in its own pixels")
                lines += [f"  {remark}" for remark in one.remarks(self.alphas)]
            lines.append(
                f"mean score of the regions {self.regions.score:.4f} with an alpha for each, "
                f"{self.regions.uniform_score:.4f} with one for all"
            )
            if not self.regions.converged:
                lines.append("  the search over the regions did not come to rest")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers in types that strict JSON knows: None stands for NaN."""
        return {
            "alphas": self.alphas.tolist(),
            "seeds": list(self.seeds),
            "estimate": self.estimate.to_dict(self.alphas),
            "metrics": [[m.to_dict() for m in row] for row in self.metrics],
            "regions": None if self.regions is None else self.regions.to_dict(self.alphas),
        }


def sweep(
    measured: Volume,
    scene: Scene,
    alphas: Sequence[float] | np.ndarray,
    *,
    seeds: int = SEEDS,
    seed: int = 0,
    metric: str = METRIC,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    regions: Regions | None = None,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    method: str = "fast",
    window: str = "rect",
    device: Device | str | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
    **simulation: Any,
) -> Sweep:
    """Simulate a mesh at several alphas and compare each image with a measured one.

    Parameters
    ----------
    measured : Volume
        Of the object, in the antenna frame. Simulations are imaged on its grid.
    scene : Scene
        In its place; its own alpha is not used.
    alphas : array_like, shape (A,)
        Ascending, in [0, 1], at least two.
    seeds : int
        How many seeds: `seed`, `seed` + 1, … With a single one there is no uncertainty.
    seed : int
    metric : str
        The field of `Metrics` that the best alpha is chosen by.
    dynamic_range_db : float, decibel
        As in `clradar.compare`.
    regions : Regions, optional
        Find an alpha for each of these, too.
    array : AntennaArray, optional
    waveform : Waveform, optional
        Of the measurement: the 94 x 94 imager and 72 to 82 GHz in 128 steps if not given.
    method, window
        As in `clradar.backproject`.
    device : Device, str or None
    store : mutable mapping, optional
        Images that it holds are not simulated again, new ones are put in one by one: a sweep that
        was interrupted goes on, to the same bits, if it is given the same store and arguments. It
        has to belong to these arguments; nothing in it is checked against them.
    progress : callable, optional
        Called with (done, total).
    **simulation
        Settings of `clradar.simulate`.

    Returns
    -------
    Sweep

    Raises
    ------
    CompareError
        The measured image is zero or has no depth; the mesh lies outside of it; or the metric is
        undefined at every alpha.
    ModelError
        An argument cannot be meant.
    MeshError, DeviceError
        As `clradar.simulate`.

    Notes
    -----
    `docs/sweep.md` has the equations. All alphas of a seed share rays and random numbers.
    """
    checks.instance("sweep: measured", measured, Volume)
    checks.instance("sweep: scene", scene, Scene)
    values = _alphas(alphas)
    checks.one_of("sweep: metric", metric, METRICS)
    n_seeds = checks.whole("sweep: seeds", seeds, 1)
    first = checks.whole("sweep: seed", seed, 0, 2**64 - n_seeds)
    resolved = resolve_settings(**simulation)
    if regions is not None:
        checks.instance("sweep: regions", regions, Regions)
        if len(regions.face) != scene.n_faces:
            checks.fail("sweep: regions", f"{scene.n_faces} faces", f"{len(regions.face)}")
        if resolved.max_bounces > 1:
            checks.fail("sweep: max_bounces", "1 where there are regions", resolved.max_bounces)
    radar = arrays.qar50() if array is None else array
    frequencies = Waveform.sfcw(72e9, 82e9, 128) if waveform is None else waveform
    checks.instance("sweep: array", radar, AntennaArray)
    checks.instance("sweep: waveform", frequencies, Waveform)
    measured_map = depth_map_of(measured, dynamic_range_db, "measured image")
    check_place(scene, measured.grid)
    made = _Images(
        scene=scene,
        alphas=values,
        seeds=tuple(range(first, first + n_seeds)),
        regions=regions,
        array=radar,
        waveform=frequencies,
        grid=measured.grid,
        method=method,
        window=window,
        dynamic_range_db=dynamic_range_db,
        device=open_device(device),
        store={} if store is None else store,
        simulation=simulation,
    )
    pixels = np.zeros((0, 0))
    if regions is not None:  # before the long work: a region may be out of sight
        centre_m = radar.tx_m.mean(axis=0)
        pixels = region_pixels(scene, regions, measured.grid, centre_m, made.device)
    made.make(progress)
    images = made.whole()
    found = estimate_alpha(measured_map, images, values, metric, dynamic_range_db)
    by_region = None
    if regions is not None:
        parts = RegionImages(
            measured=measured.depth_map(EVERYTHING_DB),
            grid=measured.grid,
            names=regions.names,
            pixels=pixels,
            volume_of=made.volume_of,
            n_seeds=n_seeds,
            n_alphas=len(values),
            metric=metric,
            dynamic_range_db=dynamic_range_db,
        )
        by_region = sweep_regions(parts, values, found.grid_best)
    return Sweep(
        alphas=values,
        seeds=made.seeds,
        metrics=tuple(
            tuple(_metrics(measured_map, image, dynamic_range_db) for image in row)
            for row in images
        ),
        estimate=found,
        measured=measured_map,
        images=tuple(images[0]),
        regions=by_region,
    )


def _alphas(alphas: Any) -> np.ndarray:
    values = checks.one_axis("sweep: alphas", alphas)
    if values[0] < 0.0 or values[-1] > 1.0:
        checks.fail("sweep: alphas", "values in [0, 1]", f"[{values[0]:g}, {values[-1]:g}]")
    if len(values) < 2:
        checks.fail("sweep: alphas", "at least two", f"one, {values[0]:g}")
    return values


def check_place(scene: Scene, grid: VoxelGrid) -> None:
    """Raise `CompareError` unless the mesh's box and the volume's overlap."""
    corners_m = scene.vertices_m[np.unique(scene.faces)]
    axes_m = (grid.x_m, grid.y_m, grid.z_m)
    apart = [
        f"{name} {1e3 * low:.4g} to {1e3 * high:.4g} mm"
        for name, low, high, axis_m in zip(
            "xyz", corners_m.min(axis=0), corners_m.max(axis=0), axes_m, strict=True
        )
        if high < axis_m[0] or low > axis_m[-1]
    ]
    if not apart:
        return
    ends = ", ".join(
        f"{name} {1e3 * a[0]:.4g} to {1e3 * a[-1]:.4g}"
        for name, a in zip("xyz", axes_m, strict=True)
    )
    raise CompareError(
        f"sweep: expected the mesh within the measured volume ({ends} mm), got it at "
        f"{', '.join(apart)}; place it (--transform, --align), and check the unit it was read in"
    )


def _metrics(measured: DepthMap, image: DepthMap | None, dynamic_range_db: float) -> Metrics:
    if image is None:
        return Metrics(**dict.fromkeys(METRICS, math.nan), dynamic_range_db=dynamic_range_db)
    return compare(measured, image, dynamic_range_db=dynamic_range_db)


@dataclass(frozen=True, slots=True, eq=False)
class _Images:
    """All images of a sweep, in its store: depth maps, or volumes of the regions."""

    scene: Scene
    alphas: np.ndarray
    seeds: tuple[int, ...]
    regions: Regions | None
    array: AntennaArray
    waveform: Waveform
    grid: VoxelGrid
    method: str
    window: str
    dynamic_range_db: float
    device: Device
    store: Store
    simulation: dict[str, Any]

    def make(self, progress: Progress | None) -> None:
        """Simulate what the store lacks, and put in each image as it is ready."""
        total = len(self.seeds) * len(self.alphas)
        missing = [
            [i for i in range(len(self.alphas)) if not self._is_done(k, i)]
            for k in range(len(self.seeds))
        ]
        ready = total - sum(map(len, missing))

        def show(images: float) -> None:
            if progress is not None:
                progress(round(_STEPS * images), _STEPS * total)

        show(ready)
        for k, which in enumerate(missing):
            if not which:
                continue
            state = [0.0, 0]  # of this seed: share that is traced, images that are ready

            def tell(at: int = ready, n: int = len(which), state: list[float] = state) -> None:
                show(at + TRACING_SHARE * n * state[0] + (1 - TRACING_SHARE) * state[1])

            def traced(
                now: int, of: int, state: list[float] = state, tell: Callable[[], None] = tell
            ) -> None:
                state[0] = now / of
                tell()

            captures = simulate_alphas(
                self.scene,
                self.array,
                self.waveform,
                list(self.alphas[which]),
                region=None if self.regions is None else self.regions.face,
                device=self.device,
                progress=traced,
                **{**self.simulation, "seed": self.seeds[k]},
            )
            for i, made in zip(which, captures, strict=True):
                self._keep(k, i, made)
                state[1] += 1
                tell()
            ready += len(which)

    def whole(self) -> list[list[DepthMap | None]]:
        """Return the depth maps of the whole mesh, [seed][alpha]."""
        indices = range(len(self.alphas))
        return [[self._whole(k, i) for i in indices] for k in range(len(self.seeds))]

    def volume_of(self, k: int, i: int, r: int) -> np.ndarray:
        """Return what region `r` adds to the image of seed `k` at alpha `i`, complex64."""
        return self.store[self._name(k, i, r)]["data"]

    def depth_map(self, data: np.ndarray) -> DepthMap | None:
        """Return the depth map of a volume's data; None if it is zero."""
        if not data.any():
            return None
        return Volume(data, self.grid).depth_map(self.dynamic_range_db)

    def _whole(self, k: int, i: int) -> DepthMap | None:
        if self.regions is not None:
            data = np.zeros(self.grid.shape, np.complex64)
            for r in range(len(self.regions.names)):
                data += self.volume_of(k, i, r)
            return self.depth_map(data)
        held = self.store[self._name(k, i, 0)]
        if not held["amplitude"].any():
            return None
        axes = (self.grid.x_m, self.grid.y_m)
        return DepthMap(held["depth_m"], held["amplitude"], *axes, self.dynamic_range_db)

    def _name(self, k: int, i: int, r: int) -> str:
        region = "" if self.regions is None else f"-region{r}"
        return f"seed{k}-alpha{i}{region}"

    def _is_done(self, k: int, i: int) -> bool:
        parts = 1 if self.regions is None else len(self.regions.names)
        return all(self._name(k, i, r) in self.store for r in range(parts))

    def _keep(self, k: int, i: int, captures: tuple[Capture, ...]) -> None:
        for r, capture in enumerate(captures):
            volume = backproject(
                capture, self.grid, method=self.method, window=self.window, device=self.device
            )
            if self.regions is not None:
                self.store[self._name(k, i, r)] = {"data": volume.data}
                continue
            depth = volume.depth_map(self.dynamic_range_db)
            self.store[self._name(k, i, r)] = {
                "depth_m": depth.depth_m,
                "amplitude": depth.amplitude,
            }
