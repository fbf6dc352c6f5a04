"""Mean and standard deviation of a simulated image over seeds."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from clradar.backproject import backproject
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ClradarWarning
from clradar.impairments.impair import impair
from clradar.jobs.where import Device, Where, open_devices
from clradar.model import AntennaArray, Capture, Scene, Spread, Volume, VoxelGrid, Waveform, checks
from clradar.model.progress import Progress
from clradar.simulation import simulate
from clradar.tracing.settings import SimulationSettings, merged_settings, takes_settings

VARIES = {  # with the seed of each estimator
    "stochastic": "shot noise of random rays", "expected": "choice of samples",
    "physical": "roughness",
}  # fmt: skip


@takes_settings
def spread(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    grid: VoxelGrid,
    *,
    seeds: int = 8,
    impairments: Mapping[str, Any] | None = None,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    method: str = "fast",
    window: str | np.ndarray = "rect",
    tolerance_db: float | None = None,
    settings: SimulationSettings | None = None,
    device: Where | Device | str | Sequence[str] | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Spread:
    """Simulate and image a scene with several seeds: mean and standard deviation of the image.

    With ``estimator="physical"`` a seed is one realisation of the surface's roughness; with the
    others the spread says how far to trust one image (docs/estimators.md).

    Parameters
    ----------
    scene, array, waveform, grid
        As of `clradar.simulate` and `clradar.backproject`.
    seeds : int, from 2
        How many: `seed` and those after it.
    impairments : mapping, optional
        Settings of `clradar.impair`, applied to every capture; their seed counts up, too.
    dynamic_range_db : float
        Of the depth maps.
    method, window, tolerance_db
        As of `clradar.backproject`.
    device : Where, Device, str, sequence of str or None
        Seeds are divided among several, as by `clradar.map_devices`.
    settings, progress, **fields
        As of `clradar.simulate`.

    Notes
    -----
    The varying share is the sum over voxels of ``sum |V_i - M|^2 / (n - 1)`` over that of
    ``sum |V_i|^2 / n``, M the mean of the n images V_i.

    Examples
    --------
    How much of a ball's image is shot noise.

    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(radius=0.01).apply_translation([0, 0, 0.3])
    >>> scene = clradar.Scene.from_mesh(ball, alpha=0.5)
    >>> array = clradar.arrays.qar50().part(slice(None, None, 12), slice(None, None, 12))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> grid = clradar.VoxelGrid.from_extent((-0.02, 0.02), (-0.02, 0.02), (0.28, 0.31), 2e-3)
    >>> for density in (10, 100):
    ...     rays = {"estimator": "stochastic", "samples_per_mm2": density}
    ...     found = clradar.spread(scene, array, waveform, grid, seeds=4, **rays)
    ...     print(f"{found.varies}: {found.varying_share:.1f}")
    shot noise of random rays: 0.4
    shot noise of random rays: 0.1
    """
    checks.instance("spread: scene", scene, Scene)
    checks.instance("spread: grid", grid, VoxelGrid)
    count = checks.whole("spread: seeds", seeds, 2, 100_000)
    checks.dynamic_range("spread: dynamic_range_db", dynamic_range_db)
    base = merged_settings(settings, **fields)
    faults = None if impairments is None else dict(impairments)
    known = [n for n, p in inspect.signature(impair).parameters.items() if p.kind is p.KEYWORD_ONLY]
    for unknown in sorted(set(faults or ()) - set(known)):
        checks.fail("spread: impairments", f"settings of impair ({', '.join(known)})", unknown)
    simulated = partial(simulate, scene, array, waveform)
    imaged = partial(
        backproject, grid=grid, method=method, window=window, tolerance_db=tolerance_db
    )
    devices = open_devices(device)
    devices.check_alike("a spread")
    estimator = str(base.for_scene(scene, array, waveform).resolved().estimator)
    rough = any(m.roughness_rms_m > 0 or m.micro_roughness_rms_m > 0 for m in scene.materials)
    causes = [VARIES[estimator]] * (estimator != "physical" or rough)
    varies = " and ".join(causes + ["noise"] * (faults is not None)) or "nothing"
    work = partial(_image_of, simulated, base, faults, imaged)
    volumes = (volume for _, volume in devices.made(work, range(count), progress))
    used = tuple(range(base.seed, base.seed + count))
    return _accumulated(volumes, grid, dynamic_range_db, used, varies)


def _image_of(
    simulated: Callable[..., Capture],
    base: SimulationSettings,
    faults: dict[str, Any] | None,
    imaged: Callable[..., Volume],
    i: int,
    device: Device,
    progress: Progress,
) -> list[Volume]:
    """The image of a seed; a function of this module, which workers find by its name."""
    with warnings.catch_warnings():
        if i:  # the first has warned
            warnings.simplefilter("ignore", ClradarWarning)
        settings = replace(base, seed=base.seed + i)
        capture = simulated(settings=settings, device=device, progress=progress)
        if faults is not None:
            capture = impair(capture, **{**faults, "seed": faults.get("seed", 0) + i})
        return [imaged(capture, device=device)]


def _accumulated(
    volumes: Iterator[Volume],
    grid: VoxelGrid,
    dynamic_range_db: float,
    seeds: tuple[int, ...],
    varies: str,
) -> Spread:
    """Return the spread of images that come one at a time, of which no more is kept."""
    mean, flat = np.zeros(grid.shape, np.complex128), (2, *grid.shape[1:])
    count, average, squares = np.zeros(flat, np.int32), np.zeros(flat), np.zeros(flat)
    varying = power = 0.0
    first = next(volumes)
    for n, volume in enumerate(chain([first], volumes), 1):
        # Slice by slice: no temporary of the volume's size in double precision.
        for single, its_mean in zip(volume.data, mean, strict=True):
            data = single.astype(np.complex128)
            away = data - its_mean
            its_mean += away / n
            varying += float(np.vdot(away, data - its_mean).real)
            power += float(np.vdot(data, data).real)
        values = np.full(flat, np.nan)
        values[0] = volume.max_projection()
        if values[0].any():
            values[1] = volume.depth_map(dynamic_range_db).depth_m
        there = np.isfinite(values)
        count += there
        away = np.where(there, values - average, 0.0)
        average += away / np.maximum(count, 1)
        squares += away * np.where(there, values - average, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.where(count > 1, np.sqrt(squares / (count - 1.0)), np.nan)
    share = varying / (len(seeds) - 1) / (power / len(seeds)) if power > 0.0 else 0.0
    meta = {**first.meta, "spread": {"seeds": list(seeds), "varies": varies}}
    return Spread(
        mean=Volume(mean.astype(np.complex64), first.grid, meta, first.scale),
        amplitude=average[0], amplitude_sd=deviation[0],
        depth_m=np.where(count[1] > 0, average[1], np.nan), depth_sd_m=deviation[1],
        depth_count=count[1], seeds=seeds, varying_share=min(1.0, max(0.0, share)), varies=varies,
        dynamic_range_db=dynamic_range_db,
    )  # fmt: skip
