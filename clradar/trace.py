"""Ray tracing of a scene: the public function `trace` (E1 to E6 in ``docs/equations.md``)."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.model import AntennaArray, Paths, Scene, TraceStatistics
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device
from clradar.tracing.placement import check_placement
from clradar.tracing.settings import (
    SimulationSettings,
    require_stochastic,
    resolve_settings,
    takes_settings,
)
from clradar.tracing.stochastic import PathColumns, Tracer


@takes_settings
def trace(
    scene: Scene,
    array: AntennaArray,
    *,
    settings: SimulationSettings | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    **fields: Any,
) -> Paths:
    """Trace rays from every Tx over the scene to every Rx (E1 to E6 in docs/equations.md).

    Parameters
    ----------
    scene : Scene
    array : AntennaArray
    settings : SimulationSettings, optional
        Of the stochastic estimator.
    device, progress, **fields
        As of `clradar.simulate`.

    Returns
    -------
    Paths
        The same bits for the same seed and device.

    Examples
    --------
    A mirror at 0.3 m.

    >>> corners_m = [[-0.05, -0.05, 0.3], [0.05, -0.05, 0.3], [0, 0.08, 0.3]]
    >>> mirror = clradar.Scene(corners_m, [[0, 1, 2]], alpha=0.0)
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.003, 0, 0]])
    >>> paths = clradar.trace(mirror, array, samples_per_mm2=1.0)
    >>> print(f"{paths.length_m.mean():.3f} m, {paths.bounces.max()} bounce")
    0.600 m, 1 bounce
    """
    check_placement("trace", scene, array)
    array.refuse_patterns("trace")
    resolved = resolve_settings(settings, **fields)
    require_stochastic("trace", resolved)
    with Tracer(scene, array, resolved, open_device(device)) as tracer:
        statistics = TraceStatistics(0, 0, 0, 0)
        tiles = []
        for tile in tracer.tiles(progress):
            tiles.append(tracer.read(tile))
            statistics = statistics + tile.statistics
    return _paths_of(tiles, array, statistics)


def _paths_of(tiles: list[PathColumns], array: AntennaArray, statistics: TraceStatistics) -> Paths:
    pair = np.concatenate([tile.pair for tile in tiles])
    # Tiles come in the order of samples and each is sorted, so a stable sort by pair is enough.
    order = np.argsort(pair, kind="stable")
    tx, rx = np.divmod(pair[order].astype(np.int64), array.n_rx)
    columns = {"tx": tx.astype(np.int32), "rx": rx.astype(np.int32)}
    for name in ("length_m", "amplitude", "bounces"):
        columns[name] = np.concatenate([getattr(tile, name) for tile in tiles])[order]
    for column in columns.values():
        column.flags.writeable = False  # so that the record need not copy it
    return Paths(**columns, n_tx=array.n_tx, n_rx=array.n_rx, statistics=statistics)
