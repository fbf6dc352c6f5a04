"""Grid search for the roughness alpha whose simulated images match a measured one best."""

from __future__ import annotations

import math
from collections.abc import Iterator, MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.roughness.estimate import AlphaEstimate, estimate_alpha
from calibration.roughness.region_pixels import EVERYTHING_DB, region_pixels
from calibration.roughness.region_sweep import RegionImages, RegionSweep, sweep_regions
from calibration.roughness.regions import Regions
from clradar import arrays
from clradar.backproject import backproject
from clradar.compare import METRICS, Metrics, depth_map_of, metrics_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError, warn
from clradar.jobs.where import Devices, open_devices
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
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device
from clradar.simulation import simulate_alphas
from clradar.tracing.settings import SimulationSettings, resolve_settings, takes_settings

SEEDS = 3

METRIC = "db_correlation"
"""Evaluated hundreds of times, a thousand times faster than the overlap, and about as accurate once
speckle is corrected for (docs/sweep-method.md)."""

Store = MutableMapping[str, dict[str, np.ndarray]]
"""Finished images: name -> arrays. A dict, or a mapping that keeps files."""

TRACING_SHARE = 0.75
"""Fraction of the time of one image, for the progress bar."""

_STEPS = 1000  # of the progress bar, per image


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Result of a sweep over alpha.

    Attributes
    ----------
    alphas : ndarray, shape (A,)
    seeds : tuple of int
    metrics : tuple of tuple of Metrics
        [seed][alpha]; every number NaN if no ray reached a receiver.
    estimate : AlphaEstimate
        The best alpha of the whole mesh.
    measured : DepthMap
    images : tuple of DepthMap or None
        One per alpha, of the first seed.
    regions : RegionSweep or None
        The best alpha of each region, if there were regions.

    Examples
    --------
    >>> import clradar, numpy as np
    >>> import calibration
    >>> axis_m = np.arange(12) * 1e-3
    >>> level = 1.0 + np.add.outer(axis_m, axis_m)
    >>> image = clradar.DepthMap(np.full((12, 12), 0.3), level, axis_m, axis_m, 15.0)
    >>> equal = clradar.compare(image, image)
    >>> found = calibration.Sweep(
    ...     np.array([0.2, 0.4]), (0,), ((equal, equal),), None, image, (image, image), None)
    >>> found.of("overlap").round(6)
    array([[1., 1.]])
    """

    alphas: np.ndarray
    seeds: tuple[int, ...]
    metrics: tuple[tuple[Metrics, ...], ...]
    estimate: AlphaEstimate
    measured: DepthMap
    images: tuple[DepthMap | None, ...]
    regions: RegionSweep | None

    def of(self, metric: str) -> np.ndarray:
        """One metric of all simulations, shape (K, A)."""
        return np.array([[getattr(m, metric) for m in row] for row in self.metrics])

    def remarks(self) -> tuple[str, ...]:
        """Reasons to doubt the estimates, one clause each."""
        found = self.estimate.remarks(self.alphas)
        if self.regions is not None:
            for name, one in zip(self.regions.names, self.regions.estimates, strict=True):
                found += [f"{name}: {remark}" for remark in one.remarks(self.alphas)]
            if not self.regions.converged:
                found.append("the search over the regions did not come to rest")
        return tuple(found)

    def report(self) -> str:
        """The estimates and their caveats as text."""
        found = self.estimate
        seeds = ", ".join(f"{alpha:.3f}" for alpha in found.per_seed)
        lines = [
            f"best alpha {found.text()} by {found.metric}"
            + (", speckle taken out" if found.corrected else ""),
            f"  per seed {seeds}; the metric itself peaks at {found.metric_peak:.3f}",
            *(f"  {line}" for line in found.remarks(self.alphas) + found.notes(self.alphas)),
        ]
        if self.regions is not None:
            for name, one in zip(self.regions.names, self.regions.estimates, strict=True):
                lines.append(f"best alpha of {name} {one.text()}, in its own pixels")
                said = one.remarks(self.alphas) + one.notes(self.alphas)
                lines += [f"  {line}" for line in said]
            lines.append(
                f"mean score of the regions {self.regions.score:.4f} with an alpha for each, "
                f"{self.regions.uniform_score:.4f} with one for all"
            )
            if not self.regions.converged:
                lines.append("  the search over the regions did not come to rest")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """All numbers in types that strict JSON has; None stands for NaN."""
        return {
            "alphas": self.alphas.tolist(),
            "seeds": list(self.seeds),
            "estimate": self.estimate.to_dict(self.alphas),
            "metrics": [[m.to_dict() for m in row] for row in self.metrics],
            "regions": None if self.regions is None else self.regions.to_dict(self.alphas),
        }


@takes_settings
def sweep(
    measured: Volume,
    scene: Scene,
    alphas: Sequence[float] | np.ndarray,
    *,
    seeds: int = SEEDS,
    metric: str = METRIC,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    regions: Regions | None = None,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    method: str = "fast",
    window: str = "rect",
    device: Devices | Device | str | Sequence[str] | None = None,
    store: Store | None = None,
    progress: Progress | None = None,
    settings: SimulationSettings | None = None,
    **fields: Any,
) -> Sweep:
    """Simulate a mesh at several alphas and compare each image with a measured one.

    Parameters
    ----------
    measured : Volume
        Of the object, in the antenna frame. Simulations are imaged on its grid.
    scene : Scene
        In its measured pose; its own alpha is not used.
    alphas : array_like, shape (A,)
        Ascending, in [0, 1], at least two.
    seeds : int
        Number of seeds, from the `seed` of the settings upwards. One seed gives no uncertainty.
    metric : str
        The field of `Metrics` that the best alpha is chosen by.
    dynamic_range_db : float, decibel
        As in `clradar.compare`.
    regions : Regions, optional
        Estimate an alpha for each of these, too.
    array : AntennaArray, optional
    waveform : Waveform, optional
        Of the measurement. Default: the 94 x 94 imager and 72 to 82 GHz in 128 steps.
    method, window
        As in `clradar.backproject`.
    device : Devices, Device, str, sequence of str or None
        Images are divided among several devices of one kind, as `clradar.map_devices` has them
        ("all"): to the same bits.
    store : mutable mapping, optional
        Images in it are not simulated again, new ones are stored one by one: given the same store
        and arguments, an interrupted sweep resumes, to the same bits. Its content is not checked
        against the arguments.
    progress : callable, optional
        Called with (done, total).
    settings : SimulationSettings, optional
        The defaults if not given.
    **fields
        Fields of `SimulationSettings`, in place of those of `settings`.

    Returns
    -------
    Sweep

    Raises
    ------
    CompareError
        The measured image is zero or has no depth; the mesh lies outside of it; or the metric is
        undefined at every alpha.
    ModelError
        An argument is invalid.
    MeshError, DeviceError
        As `clradar.simulate`.

    Warns
    -----
    ClradarWarning
        Every remark of the result: `Sweep.remarks`.

    Notes
    -----
    `docs/sweep-method.md` has the equations. All alphas of a seed share rays and random numbers.

    Examples
    --------
    A simulation with the sweep's seed in place of a measurement: at its alpha the images are equal.

    >>> import clradar, trimesh
    >>> import calibration
    >>> mesh = trimesh.creation.icosphere(3, 0.04)
    >>> scene = clradar.Scene(mesh.vertices + [0, 0, 0.3], mesh.faces)
    >>> q = clradar.arrays.qar50()
    >>> radar = {"array": clradar.AntennaArray(q.tx_m[::12], q.rx_m[::12]),
    ...          "waveform": clradar.Waveform.sfcw(72e9, 82e9, 16), "device": "pocl"}
    >>> rays = {"samples_per_mm2": 0.2, "reception_radius_m": 0.02}
    >>> rough = scene.with_alpha(0.5)
    >>> capture = clradar.simulate(rough, **radar, **rays, estimator="stochastic")
    >>> grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.25, 0.3), 5e-3)
    >>> image = clradar.backproject(capture, grid, device="pocl")
    >>> found = calibration.sweep(image, scene, [0.1, 0.5, 0.9], seeds=1, **radar, **rays)
    >>> print(found.alphas[found.estimate.grid_best], found.estimate.score.max().round(6))
    0.5 1.0
    """
    checks.instance("sweep: measured", measured, Volume)
    checks.instance("sweep: scene", scene, Scene)
    values = _alphas(alphas)
    checks.one_of("sweep: metric", metric, METRICS)
    n_seeds = checks.whole("sweep: seeds", seeds, 1)
    resolved = resolve_settings(settings, **fields)
    first = checks.whole("sweep: seed", resolved.seed, 0, 2**64 - n_seeds)
    if regions is not None:
        _check_regions(regions, scene, resolved)
    radar = arrays.qar50() if array is None else array
    frequencies = Waveform.sfcw(72e9, 82e9, 128) if waveform is None else waveform
    checks.instance("sweep: array", radar, AntennaArray)
    checks.instance("sweep: waveform", frequencies, Waveform)
    measured_map = depth_map_of(measured, dynamic_range_db, "measured image")
    check_within_grid(scene, measured.grid)
    simulations = _Simulations(
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
        settings=resolved,
    )
    devices = open_devices(device)
    devices.check_alike("a sweep")
    images = _SweepImages(simulations, devices, {} if store is None else store)
    # Before the simulations: a region may be hidden.
    pixels = None if regions is None else images.region_pixels()
    images.simulate_missing(progress)
    whole = images.whole()
    estimate = estimate_alpha(measured_map, whole, values, metric, dynamic_range_db)
    result = Sweep(
        alphas=values,
        seeds=simulations.seeds,
        metrics=tuple(
            tuple(_metrics(measured_map, image, dynamic_range_db) for image in row) for row in whole
        ),
        estimate=estimate,
        measured=measured_map,
        images=tuple(whole[0]),
        regions=None
        if pixels is None
        else sweep_regions(images.of_regions(measured, pixels, metric), values, estimate.grid_best),
    )
    for remark in result.remarks():
        warn(f"sweep: {remark}")
    return result


def _check_regions(regions: Regions, scene: Scene, settings: SimulationSettings) -> None:
    checks.instance("sweep: regions", regions, Regions)
    if len(regions.face) != scene.n_faces:
        checks.fail("sweep: regions", f"{scene.n_faces} faces", f"{len(regions.face)}")
    if settings.max_bounces > 1:
        checks.fail("sweep: max_bounces", "1 where there are regions", settings.max_bounces)


def _alphas(alphas: Any) -> np.ndarray:
    values = checks.one_axis("sweep: alphas", alphas)
    if values[0] < 0.0 or values[-1] > 1.0:
        checks.fail("sweep: alphas", "values in [0, 1]", f"[{values[0]:g}, {values[-1]:g}]")
    if len(values) < 2:
        checks.fail("sweep: alphas", "at least two", f"one, {values[0]:g}")
    return values


def check_within_grid(scene: Scene, grid: VoxelGrid) -> None:
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
        unknown: dict[str, Any] = dict.fromkeys(METRICS, math.nan)
        return Metrics(**unknown, dynamic_range_db=dynamic_range_db)
    return metrics_of(measured, image, dynamic_range_db)


@dataclass(frozen=True, slots=True, eq=False)
class _Simulations:
    """What is simulated: makes the images of some alphas of one seed on a device."""

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
    settings: SimulationSettings

    def __call__(
        self, item: tuple[int, list[int]], device: Device, progress: Progress
    ) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
        """Yield name and arrays of the images of seed k and some alphas."""
        k, indices = item
        traced, stored = 0.0, 0

        def tell() -> None:
            share = TRACING_SHARE * traced + (1 - TRACING_SHARE) * stored / len(indices)
            progress(round(_STEPS * share), _STEPS)

        def on_tracing(now: int, of: int) -> None:
            nonlocal traced
            traced = now / of
            tell()

        captures = simulate_alphas(
            self.scene,
            self.array,
            self.waveform,
            list(self.alphas[indices]),
            region=None if self.regions is None else self.regions.face,
            settings=replace(self.settings, seed=self.seeds[k]),
            device=device,
            progress=on_tracing,
        )
        for i, of_alpha in zip(indices, captures, strict=True):
            for r, capture in enumerate(of_alpha):
                yield self.name(k, i, r), self._image(capture, device)
            stored += 1
            tell()

    def _image(self, capture: Capture, device: Device) -> dict[str, np.ndarray]:
        volume = backproject(
            capture, self.grid, method=self.method, window=self.window, check_grid=False,
            device=device,
        )  # fmt: skip
        if self.regions is not None:
            return {"data": volume.data}
        depth = volume.depth_map(self.dynamic_range_db)
        return {"depth_m": depth.depth_m, "amplitude": depth.amplitude}

    def name(self, k: int, i: int, r: int) -> str:
        region = "" if self.regions is None else f"-region{r}"
        return f"seed{k}-alpha{i}{region}"


@dataclass(frozen=True, slots=True, eq=False)
class _SweepImages:
    """All images of a sweep, in its store: depth maps, or volumes of the regions."""

    of: _Simulations
    devices: Devices
    store: Store

    def simulate_missing(self, progress: Progress | None) -> None:
        """Simulate the images that the store lacks, and store each as soon as it is finished."""
        n_seeds, n_alphas = len(self.of.seeds), len(self.of.alphas)
        missing = [
            [i for i in range(n_alphas) if not self._is_stored(k, i)] for k in range(n_seeds)
        ]
        # A batch of alphas shares rays, so they are divided no more than the devices need.
        n_devices = len(self.devices.infos)
        parts = n_devices // math.gcd(n_devices, n_seeds)
        items = [
            (k, part.tolist())
            for k, indices in enumerate(missing)
            for part in np.array_split(indices, parts)
            if len(part)
        ]
        done = 1.0 - sum(map(len, missing)) / (n_seeds * n_alphas)
        rest = part_of(progress, done, 1.0)
        for _, (name, image) in self.devices.made(self.of, items, rest):
            self.store[name] = image

    def _is_stored(self, k: int, i: int) -> bool:
        parts = 1 if self.of.regions is None else len(self.of.regions.names)
        return all(self.of.name(k, i, r) in self.store for r in range(parts))

    def whole(self) -> list[list[DepthMap | None]]:
        """Depth maps of the whole mesh, [seed][alpha]; None where the image is zero."""
        indices = range(len(self.of.alphas))
        return [[self._whole(k, i) for i in indices] for k in range(len(self.of.seeds))]

    def _whole(self, k: int, i: int) -> DepthMap | None:
        if self.of.regions is not None:
            data = np.zeros(self.of.grid.shape, np.complex64)
            for r in range(len(self.of.regions.names)):
                data += self._volume(k, i, r)
            if not data.any():
                return None
            return Volume(data, self.of.grid).depth_map(self.of.dynamic_range_db)
        stored = self.store[self.of.name(k, i, 0)]
        if not stored["amplitude"].any():
            return None
        axes = (self.of.grid.x_m, self.of.grid.y_m)
        return DepthMap(stored["depth_m"], stored["amplitude"], *axes, self.of.dynamic_range_db)

    def _volume(self, k: int, i: int, r: int) -> np.ndarray:
        return self.store[self.of.name(k, i, r)]["data"]

    def region_pixels(self) -> np.ndarray:
        """Number of the region that each pixel shows, shape (n_y, n_x), -1 for none."""
        assert self.of.regions is not None
        centre_m = self.of.array.tx_m.mean(axis=0)
        return region_pixels(
            self.of.scene, self.of.regions, self.of.grid, centre_m, self.devices.first
        )

    def of_regions(self, measured: Volume, pixels: np.ndarray, metric: str) -> RegionImages:
        assert self.of.regions is not None
        return RegionImages(
            measured=measured.depth_map(EVERYTHING_DB),
            grid=self.of.grid,
            names=self.of.regions.names,
            pixels=pixels,
            volume_of=self._volume,
            n_seeds=len(self.of.seeds),
            n_alphas=len(self.of.alphas),
            metric=metric,
            dynamic_range_db=self.of.dynamic_range_db,
        )
