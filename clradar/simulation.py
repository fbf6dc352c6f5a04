"""Simulation of captures: tracing and phasor sum tile by tile, for one alpha or for several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np

from clradar.imaging.frame_imager import FrameImager
from clradar.model import AntennaArray, Capture, Scene, TraceStatistics, Waveform, checks
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device, open_device
from clradar.phasors.phasor_sum import PhasorSum, pairs_within
from clradar.phasors.physical import physical_samples
from clradar.tracing.ambiguous import warn_of_ambiguity
from clradar.tracing.expected import ExpectedTracer
from clradar.tracing.facets import warn_of_coarse_facets
from clradar.tracing.lit_surface import SUM_SHARE
from clradar.tracing.placement import check_placement
from clradar.tracing.settings import (
    SimulationSettings,
    merged_settings,
    require_stochastic,
    simulated_meta,
    takes_settings,
)
from clradar.tracing.starvation import warn_if_starved
from clradar.tracing.stochastic import Tracer

SUM_BYTES = 2**30
"""Most that the sums of pairs take, 11.5 kB each with 128 frequencies; of more pairs the sums of a
block of Tx are held at a time, and their rays traced; fewer where memory is short. No result
depends on it."""

SUMS_AT_ONCE = 12
"""Phasor sums held at the same time, fewer where memory is short. No result depends on it."""


@takes_settings
def simulate(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    *,
    settings: SimulationSettings | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Capture:
    """Simulate a capture: trace and synthesize tile by tile, in little memory (docs/bodies.md).

    Parameters
    ----------
    scene : Scene
    array : AntennaArray
    waveform : Waveform
    settings : SimulationSettings, optional
        The stochastic estimator gives the bits of ``synthesize(trace(...))`` with the same radius.
    device
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) samples.
    **fields
        Fields of `SimulationSettings`, in place of those of `settings`.

    Returns
    -------
    Capture
        With the resolved settings, the scene's digest, the counts of rays and the device in `meta`.

    Raises
    ------
    MeshError
        The scene has no face with area, or more samples than 2^31.

    Warns
    -----
    ClradarWarning
        Coarse faces or points, ambiguities, too few rays, and so on: docs/messages.md.

    Examples
    --------
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(radius=0.02).apply_translation([0, 0, 0.3])
    >>> scene = clradar.Scene.from_mesh(ball, alpha=0.5)
    >>> array = clradar.arrays.qar50().part(slice(None, None, 12), slice(None, None, 12))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> capture = clradar.simulate(scene, array, waveform, samples_per_mm2=5)
    >>> capture.data.shape, capture.meta["settings"]["samples_per_mm2"]
    ((8, 8, 16), 5.0)
    """
    checks.instance("simulate: waveform", waveform, Waveform)
    check_placement("simulate", scene, array)
    warn_of_ambiguity(scene, array, waveform)
    resolved = merged_settings(settings, **fields).for_scene(scene, array, waveform).resolved()
    if resolved.estimator != "physical":
        array.refuse_patterns("simulate")
    opened = open_device(device)
    warn_of_coarse_facets("simulate", scene, resolved, float(waveform.frequencies_hz.max()))
    if resolved.estimator == "physical":
        data, meta = physical_samples(scene, array, waveform, resolved, opened, progress)
    else:
        data = np.empty((array.n_tx, array.n_rx, waveform.n_freq), np.complex64)

        def take(tx: slice, total: PhasorSum, _: dict[str, Any]) -> None:
            data[tx] = total.result()

        meta = _summed_paths(scene, array, waveform, resolved, opened, progress, take)
        data.flags.writeable = False
    return Capture(array.with_gains(data), array, waveform, meta)


@takes_settings
def simulate_image(
    scene: Scene,
    imager: FrameImager,
    *,
    settings: SimulationSettings | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> None:
    """Simulate a capture and form its image, which `imager` holds then.

    It has the bits of ``imager.form(simulate(scene, imager.array, imager.waveform, ...))``; but
    samples of rays stay on the device where image and sums fit.

    Parameters
    ----------
    scene : Scene
    imager : FrameImager
    settings, progress, **fields
        As of `simulate`.

    Examples
    --------
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(radius=0.02).apply_translation([0, 0, 0.3])
    >>> array = clradar.arrays.qar50().part(slice(None, None, 6), slice(None, None, 6))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 16)
    >>> grid = clradar.VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.27, 0.33), 2e-3)
    >>> with clradar.FrameImager(array, waveform, grid) as imager:
    ...     clradar.simulate_image(clradar.Scene.from_mesh(ball), imager, samples_per_mm2=5)
    ...     imager.depth_map().depth_m.shape
    (31, 31)
    """
    checks.instance("simulate_image: imager", imager, FrameImager)
    checks.instance("simulate_image: scene", scene, Scene)
    merged = merged_settings(settings, **fields)
    suited = merged.for_scene(scene, imager.array, imager.waveform)
    physical = suited.estimator == "physical"
    in_blocks = len(_blocks_of_tx(imager.array, imager.waveform, imager.device)) > 1
    if not imager.keeps_image or physical or imager.array.has_gains or in_blocks:
        imager.form(
            simulate(
                scene, imager.array, imager.waveform,
                settings=merged, device=imager.device, progress=progress,
            )
        )  # fmt: skip
        return
    check_placement("simulate_image", scene, imager.array)
    resolved = suited.resolved()
    imager.array.refuse_patterns("simulate_image")
    highest_hz = float(imager.waveform.frequencies_hz.max())
    warn_of_coarse_facets("simulate_image", scene, resolved, highest_hz)

    def take(_: slice, total: PhasorSum, meta: dict[str, Any]) -> None:
        kept = total.on_device()
        if kept is None:
            imager.form(Capture(total.result(), imager.array, imager.waveform, meta))
        else:
            imager.form_on_device(*kept, meta)

    _summed_paths(scene, imager.array, imager.waveform, resolved, imager.device, progress, take)


def _blocks_of_tx(array: AntennaArray, waveform: Waveform, device: Device) -> list[slice]:
    """Tx whose sums are held at the same time."""
    room = min(SUM_BYTES, SUM_SHARE * device.budget_bytes)
    most = max(1, pairs_within(room, waveform, device) // array.n_rx)
    starts = range(0, array.n_tx, most)
    return [slice(start, min(start + most, array.n_tx)) for start in starts]


def _summed_paths(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    resolved: SimulationSettings,
    opened: Device,
    progress: Progress | None,
    take: Callable[[slice, PhasorSum, dict[str, Any]], None],
) -> dict[str, Any]:
    """Sum paths, by chance or on average; return `meta` of the capture.

    `take` is called with every block of Tx, its sum, and `meta` so far.
    """
    statistics = TraceStatistics(0, 0, 0, 0)
    paths = np.zeros(array.n_tx * array.n_rx, np.int64)
    expected = resolved.estimator == "expected"
    blocks, meta = _blocks_of_tx(array, waveform, opened), dict[str, Any]()
    kind = ExpectedTracer if expected else Tracer
    for i, tx in enumerate(blocks):
        share = progress
        if len(blocks) > 1:
            share = part_of(progress, i / len(blocks), (i + 1) / len(blocks))
        of_block = paths[tx.start * array.n_rx : tx.stop * array.n_rx]
        # The sum, which may be using the tracer's memory, ends first.
        with (
            kind(scene, array, resolved, opened, tx) as tracer,
            PhasorSum(tracer.array, waveform, opened, expected) as total,
        ):
            for tile in tracer.tiles(share):
                total.add_on_device(tile.start, tile.length, tile.amplitude, tile.longest_m)
                of_block += np.diff(tile.start)
                new = replace(tile.statistics, samples=0) if i else tile.statistics
                statistics = statistics + new
            meta = simulated_meta(scene, resolved, statistics, int(paths.sum()), opened)
            take(tx, total, meta)
    warn_if_starved(paths, scene, array, resolved)
    return meta


@takes_settings
def simulate_alphas(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    alphas: Sequence[float | np.ndarray | Mapping[str, float]],
    *,
    region: np.ndarray | None = None,
    settings: SimulationSettings | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Iterator[tuple[Capture, ...]]:
    """Yield captures of a scene at several alphas with the same rays and random numbers.

    Alphas are what `Scene.with_alpha` takes. The tree, the samples and their visibility are found
    once for up to twelve of them. Each capture, the only one of its tuple, has the bits of
    ``simulate(scene.with_alpha(alpha), ...)`` by the stochastic estimator.

    With `region`, whole numbers (n_faces,) from 0, there is one for each: of the paths that are
    reflected in it only, by single reflections; all regions block rays. They add up to that of the
    whole scene, to the rounding of complex64.
    """
    checks.instance("simulate_alphas: waveform", waveform, Waveform)
    check_placement("simulate_alphas", scene, array)
    warn_of_ambiguity(scene, array, waveform)
    array.refuse_patterns("simulate_alphas")
    merged = merged_settings(settings, **fields)
    require_stochastic("simulate_alphas", merged.resolved())
    merged = replace(merged, estimator="stochastic").for_scene(scene, array, waveform)
    resolved = merged.resolved()
    if len(alphas) == 0:
        checks.fail("simulate_alphas: alphas", "at least one", "none")
    scenes = [scene.with_alpha(alpha) for alpha in alphas]
    if region is not None:
        region = checks.read_only("simulate_alphas: region", region, np.int32, (scene.n_faces,))
        if region.min() < 0:
            checks.fail("simulate_alphas: region", "whole numbers from 0", f"{region.min()}")
        if resolved.max_bounces > 1:
            # A path of two bounces belongs to two regions, and to neither of their alphas alone.
            expected = "max_bounces 1 where there are regions"
            checks.fail("simulate_alphas", expected, resolved.max_bounces)
    warn_of_coarse_facets("simulate_alphas", scene, resolved, float(waveform.frequencies_hz.max()))
    return _in_batches(scenes, array, waveform, region, resolved, open_device(device), progress)


def _in_batches(
    scenes: list[Scene],
    array: AntennaArray,
    waveform: Waveform,
    region: np.ndarray | None,
    settings: SimulationSettings,
    device: Device,
    progress: Progress | None,
) -> Iterator[tuple[Capture, ...]]:
    n_regions = 1 if region is None else int(region.max()) + 1
    room = pairs_within(0.25 * device.budget_bytes, waveform, device)
    at_once = max(1, min(SUMS_AT_ONCE, room // (array.n_tx * array.n_rx)) // n_regions)
    for start in range(0, len(scenes), at_once):
        batch = scenes[start : start + at_once]
        share = part_of(progress, start / len(scenes), (start + len(batch)) / len(scenes))
        yield from _batch(batch, array, waveform, region, n_regions, settings, device, share)


def _batch(
    scenes: list[Scene],
    array: AntennaArray,
    waveform: Waveform,
    region: np.ndarray | None,
    n_regions: int,
    settings: SimulationSettings,
    device: Device,
    progress: Progress | None,
) -> list[tuple[Capture, ...]]:
    statistics = [TraceStatistics(0, 0, 0, 0) for _ in scenes]
    paths = np.zeros((len(scenes), n_regions, array.n_tx * array.n_rx), dtype=np.int64)
    with ExitStack() as stack:
        sums = [
            [stack.enter_context(PhasorSum(array, waveform, device)) for _ in range(n_regions)]
            for _ in scenes
        ]
        tracer = stack.enter_context(Tracer(scenes[0], array, settings, device))
        alphas = [np.asarray(scene.alpha, dtype=np.float32) for scene in scenes]
        for i, tile in tracer.tiles_of(alphas, progress):
            statistics[i] = statistics[i] + tile.statistics
            if region is None:
                sums[i][0].add_on_device(tile.start, tile.length, tile.amplitude, tile.longest_m)
                paths[i, 0] += np.diff(tile.start)
                continue
            columns = tracer.read(tile)
            region_of = region[columns.face]
            for r, total in enumerate(sums[i]):
                chosen = region_of == r
                pair = columns.pair[chosen]
                total.add(pair, columns.length_m[chosen], columns.amplitude[chosen])
                paths[i, r] += np.bincount(pair, minlength=paths.shape[2])
        data = [[total.result() for total in row] for row in sums]
    of_pairs = paths.sum(axis=1)
    emptiest = int((of_pairs == 0).sum(axis=1).argmax())
    warn_if_starved(of_pairs[emptiest], scenes[emptiest], array, settings, only_stochastic=True)
    made = []
    for i, (scene, row) in enumerate(zip(scenes, data, strict=True)):
        meta = simulated_meta(scene, settings, statistics[i], int(paths[i].sum()), device)
        metas = [meta]
        if region is not None:
            counts = enumerate(paths[i].sum(axis=1).tolist())
            metas = [{**meta, "region": {"number": r, "paths": count}} for r, count in counts]
        captures = zip(map(array.with_gains, row), metas, strict=True)
        made.append(tuple(Capture(data, array, waveform, own) for data, own in captures))
    return made
