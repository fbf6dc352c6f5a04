"""Sweep over the roughness and correlation length of a mesh, in metres."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from calibration.roughness import design
from calibration.roughness.estimates import RoughnessEstimate, estimate_roughness
from calibration.roughness.meters import SubApertures, TextureMeter, surface_points
from calibration.roughness.regions import Regions
from clradar.constants import PLAUSIBLE_CORRELATION_M, PLAUSIBLE_ROUGHNESS_M
from clradar.errors import ClradarWarning, CompareError
from clradar.jobs.where import Where, open_devices
from clradar.model import AntennaArray, Capture, Scene, Waveform, checks
from clradar.model.plausible import check_plausible
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.simulation import simulate
from clradar.tracing.settings import SimulationSettings, resolve_settings, takes_settings

CORRELATIONS_M = (1.5e-3, 3e-3, 6e-3)  # that are tried if none are given
LEAST_SIMULATIONS = 30  # mean and covariance of a dozen statistics need more
ESTIMATOR = "physical"


@dataclass(frozen=True, slots=True, eq=False)
class RoughnessSweep(design.Estimates):
    """Result of a sweep over roughness and correlation length.

    Attributes
    ----------
    estimates : tuple of RoughnessEstimate
        One per region; of the whole mesh where there are none.
    heights_m, lengths_m : ndarray, shape (n_heights,) and (n_lengths,)
        That were simulated.
    seeds : tuple of int
        First and last.
    """

    wanted: ClassVar[str] = "roughness"

    estimates: tuple[RoughnessEstimate, ...]
    heights_m: np.ndarray
    lengths_m: np.ndarray
    seeds: tuple[int, int]

    def tables(self) -> list[design.Table]:
        """Limits of what was estimated of each region, and what is determined."""
        pairs = [*itertools.product(("roughness_m", "correlation_m", "slope"), design.LIMITS)]
        rows = [
            [one.name, *(getattr(getattr(one, q), limit) for q, limit in pairs), one.text()]
            for one in self.estimates
        ]
        return [(("region", *map("_".join, pairs), "told"), rows)]


@takes_settings
def sweep_roughness(
    measured: Capture,
    scene: Scene,
    roughness_m: Sequence[float] | np.ndarray,
    correlation_m: Sequence[float] | np.ndarray | float = CORRELATIONS_M,
    *,
    seeds: int = design.SEEDS,
    regions: Regions | None = None,
    calibrated: bool = False,
    device: Where | Device | str | Sequence[str] | None = None,
    store: design.Store | None = None,
    progress: Progress | None = None,
    settings: SimulationSettings | None = None,
    **fields: Any,
) -> RoughnessSweep:
    """Estimate the roughness of a mesh by simulations with several roughnesses.

    docs/sweep-method.md has the statistics that are compared, and how exact it is. Every remark of
    the result is a warning.

    Parameters
    ----------
    measured : Capture
        Of the object, in the antenna frame, without clutter.
    scene : Scene
        In its measured pose, with its materials; their roughness is replaced.
    roughness_m : array_like, shape (n_heights,)
        Root mean square heights h to simulate, ascending, at least three above 0. Of a surface
        below the lowest only that is said.
    correlation_m : float or array_like, shape (n_lengths,)
        Correlation lengths l, ascending. A single one is taken for known.
    seeds : int
        Simulations for each pair, each with a seed of its own; 30 in all at least.
    calibrated : bool
        The capture is in S-parameters, and antennas and materials are right: the level counts, too.
    regions, device, store, settings, **fields
        As of `sweep`, of the physical estimator.

    Raises
    ------
    CompareError
        The mesh, or a region, is not visible, or too small to be judged.

    Examples
    --------
    A plate, measured with another seed than the simulations':

    >>> import trimesh, warnings
    >>> warnings.simplefilter("ignore", clradar.ClradarWarning)  # of a coarse surface
    >>> plate = trimesh.creation.box((0.04, 0.04, 0.001)).apply_translation([0, 0, 0.3])
    >>> scene = clradar.Scene.from_mesh(plate)
    >>> array = clradar.arrays.qar50().part(np.s_[::12], np.s_[::12])
    >>> rough = clradar.Material(
    ...     "rough", conductor=True, roughness_rms_m=0.2e-3, correlation_length_m=3e-3)
    >>> capture = clradar.simulate(
    ...     scene.with_material(rough), array, clradar.Waveform.sfcw(72e9, 82e9, 8), seed=102)
    >>> heights_m, lengths_m = [0.1e-3, 0.2e-3, 0.4e-3], [2e-3, 5e-3]
    >>> found = calibration.sweep_roughness(capture, scene, heights_m, lengths_m, seeds=5)
    >>> height = found.estimates[0].roughness_m
    >>> bool(height.low95 < 0.2e-3 < height.high95)
    True
    """
    checks.instance("sweep_roughness: measured", measured, Capture)
    checks.instance("sweep_roughness: scene", scene, Scene)
    named = "sweep_roughness: roughness_m", "sweep_roughness: correlation_m"
    heights = checks.one_axis(named[0], roughness_m)
    lengths = checks.one_axis(named[1], np.atleast_1d(correlation_m))
    check_plausible(named[0], "lengths", heights, PLAUSIBLE_ROUGHNESS_M)
    check_plausible(named[1], "lengths", lengths, PLAUSIBLE_CORRELATION_M)
    if np.count_nonzero(heights) < 3:
        checks.fail(named[0], "at least three values above 0", f"{heights.tolist()}")
    n_seeds = checks.whole("sweep_roughness: seeds", seeds, 1)
    pairs = [*itertools.product(heights[heights > 0].tolist(), lengths.tolist(), range(n_seeds))]
    if len(pairs) < LEAST_SIMULATIONS:
        expected = f"at least {LEAST_SIMULATIONS} simulations, heights times lengths times seeds"
        checks.fail("sweep_roughness", expected, f"{len(pairs)}; take more of them, or more seeds")
    settings = resolve_settings(settings, **{"estimator": ESTIMATOR, **fields})
    checks.one_of("sweep_roughness: estimator", settings.estimator, (ESTIMATOR,))
    first = checks.whole("sweep_roughness: seed", settings.seed, 0, 2**64 - len(pairs))
    names = design.check_regions("sweep_roughness", regions, scene) or (design.WHOLE,)
    devices = open_devices(device)
    devices.check_alike("a sweep")
    array, waveform = measured.array, measured.waveform
    points = surface_points(scene, regions, array.tx_m.mean(axis=0), devices.first)
    apertures = SubApertures(array, waveform, points.points_m, devices.first)
    simulated = partial(_simulated, scene, (array, waveform), points.points_m, settings)
    own = design.fingerprint(scene, array, waveform, heights, lengths, n_seeds, settings)
    kept: design.Store = {} if store is None else store

    def simulate_missing(items: Sequence[_Item], progress: Progress | None = None) -> None:
        missing = [item for item in items if item[0] not in kept]
        for _, (name, images) in devices.made(simulated, missing, progress):
            kept[name] = images

    smooth = f"{own}-smooth"
    simulate_missing([(smooth, 0.0, float(lengths[0]), first)])
    tilts = points.tilts(apertures.arrays)
    at_smooth = kept[smooth]["images"]
    meters = [TextureMeter(points, i, tilts, at_smooth, calibrated) for i in range(len(names))]
    design.estimable("roughness", names, meters)
    items = [
        (f"{own}-{1e3 * height_m:g}-{1e3 * length_m:g}-{k}", height_m, length_m, first + i)
        for i, (height_m, length_m, k) in enumerate(pairs)
    ]
    # At an end of the range they are too rough for Kirchhoff; only the estimate matters.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClradarWarning)
        simulate_missing(items, progress)
    image = apertures.images(measured)
    if not image.any():
        raise CompareError("sweep: the measured image is 0 on the whole mesh")
    height_m, length_m, _ = np.array(pairs).T
    estimates = []
    for name, meter in zip(names, meters, strict=True):
        rows = np.stack([meter.measure(kept[item[0]]["images"]) for item in items])
        seen = meter.measure(image)
        one = estimate_roughness(name, meter.names, seen, height_m, length_m, rows, meter.n_points)
        estimates.append(one)
    result = RoughnessSweep(tuple(estimates), heights, lengths, (first, first + len(pairs) - 1))
    result.warn()
    return result


_Item = tuple[str, float, float, int]  # name, height, length and seed of a simulation


def _simulated(
    scene: Scene,
    radar: tuple[AntennaArray, Waveform],
    points_m: np.ndarray,
    settings: SimulationSettings,
    item: _Item,
    device: Device,
    progress: Progress,
) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Yield the name and the images of an item; of the module, where workers find it by name."""
    name, height_m, length_m, seed = item
    rough = tuple(
        replace(own, roughness_rms_m=height_m, correlation_length_m=length_m)
        for own in scene.materials
    )
    capture = simulate(
        replace(scene, materials=rough), *radar, settings=replace(settings, seed=seed),
        device=device,
    )  # fmt: skip
    yield name, {"images": SubApertures(*radar, points_m, device).images(capture)}
