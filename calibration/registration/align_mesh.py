"""The rigid motion that brings a mesh onto what the radar measured of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibration.registration.alignment import Alignment
from calibration.registration.closed_loop import (
    MAX_ROUNDS,
    TOLERANCE_M,
    LoopSettings,
    Round,
    close_loop,
)
from calibration.registration.locate import FINE_STEP_M, density_of, depth_for_mesh, locate
from calibration.registration.mesh_rendering import thinned
from clradar import arrays
from clradar.model import AntennaArray, DepthMap, Scene, Volume, VoxelGrid, Waveform, checks
from clradar.opencl import Device, open_device

SAMPLES_PER_MM2, RAYS_PER_SAMPLE = 3.0, 3
"""Of the simulations that find the bias. The speckle of the image is what limits a round, not the
shot noise of so few rays."""

MOST_SAMPLES = 1_000_000
"""Of one of these simulations: seven times those of a hand."""

ROOM_M = 20e-3
"""Depth before and behind what a depth map shows, where the mesh is imaged."""

Progress = Callable[[int, int], None]
"""Called with (done, total) steps of the search, then of the correction."""


def align_mesh(
    measured: Volume | DepthMap,
    mesh: Scene,
    *,
    correct_bias: bool = True,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    dynamic_range_db: float | None = None,
    search_deg: float = 45.0,
    min_inlier_share: float = 0.5,
    max_iterations: int = 50,
    seed: int = 0,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Alignment:
    """Find the rigid motion that brings a mesh onto what the radar measured of it.

    Parameters
    ----------
    measured : Volume or DepthMap
        In the antenna frame, on pixels that are evenly spaced.
    mesh : Scene
        Anywhere: it need not be in front of the radar. Its alpha has no influence.
    correct_bias : bool
        Simulate the mesh where it was found, a few times and on pixels of 2 mm, and take back what
        the fit is off there. Without, it takes a fraction of the time and is off by up to some
        millimetres where the surface is specular (docs/calibration.md).
    array : AntennaArray, optional
    waveform : Waveform, optional
        What `measured` was recorded with: the 94 x 94 imager and 72 to 82 GHz in 128 steps if not
        given. They say how a point is blurred.
    dynamic_range_db : float, decibel, optional
        Depth points are the pixels within this of the maximum. If not given 20, or what a
        `DepthMap` was cut at if that is less.
    search_deg : float, degrees, in (0, 180]
        The search tries rotations about boresight up to this angle, together with tilts up to 30
        degrees. The result may turn further.
    min_inlier_share : float, in (0, 1]
        Less of the measured amplitude than this on the mesh is a failure.
    max_iterations : int
        Steps of the fit before it stops unconverged.
    seed : int
        Of the first simulation; each has one of its own, counted up from there.
    device : Device, str or None
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total): first the rotations of the search, then the simulations.

    Returns
    -------
    Alignment
        measured = transform . mesh. `inlier_share` is that of the measured amplitude; `iterations`
        counts the simulations, or the steps of the fit without.

    Raises
    ------
    CompareError
        "could not align, because …": no image, an empty one or one with too few depth points; a
        mesh whose size does not fit what was measured; too little of it on the mesh; or a
        simulation of the mesh in its place that does not look like the measurement.
    ModelError
        An option is out of its range.

    Notes
    -----
    The mesh's own depth map, by rays from eight places of the aperture, is blurred by the array's
    power pattern; how bright the surface is at which angle of incidence is fitted along with the
    motion. Brightness counts as speckle, ranges as points that scatter about the surface.
    `docs/calibration.md` has the equations. The result depends on the arguments and the device
    alone.
    """
    seed = checks.whole("align_mesh: seed", seed, 0)
    radar, sweep = radar_of("align_mesh", array, waveform)
    opened = open_device(device)
    depth = depth_for_mesh(measured, dynamic_range_db)
    located = locate(
        depth,
        mesh,
        array=radar,
        centre_frequency_hz=float(np.mean(sweep.frequencies_hz)),
        search_deg=search_deg,
        min_inlier_share=min_inlier_share,
        max_iterations=max_iterations,
        device=opened,
        progress=progress,
    )
    if not correct_bias:
        return located.alignment
    coarse = thinned(depth, FINE_STEP_M)
    settings = LoopSettings(
        array=radar,
        waveform=sweep,
        grid=_coarse_grid(measured, coarse),
        fit_alpha=True,
        samples_per_mm2=density_of(mesh, SAMPLES_PER_MM2, MOST_SAMPLES),
        rays_per_sample=RAYS_PER_SAMPLE,
        seed=seed,
        dynamic_range_db=depth.dynamic_range_db,
        tolerance_m=TOLERANCE_M,
        max_rounds=MAX_ROUNDS,
    )
    done: list[Round] = []

    def count(turn: Round) -> None:
        done.append(turn)
        if progress is not None:
            progress(len(done), MAX_ROUNDS)

    return close_loop(coarse, mesh, located, settings, opened, count).alignment


def radar_of(
    function: str, array: AntennaArray | None, waveform: Waveform | None
) -> tuple[AntennaArray, Waveform]:
    """Return the instrument, the 94 x 94 imager where none is given, checked."""
    radar = arrays.qar50() if array is None else array
    sweep = Waveform.sfcw(72e9, 82e9, 128) if waveform is None else waveform
    checks.instance(f"{function}: array", radar, AntennaArray)
    checks.instance(f"{function}: waveform", sweep, Waveform)
    return radar, sweep


def _coarse_grid(measured: Volume | DepthMap, depth: DepthMap) -> VoxelGrid:
    """Return a grid over what was measured, on pixels of the fit and of `depth`."""
    if isinstance(measured, Volume):
        # The same ends: where they cut the object off, they cut the simulation off, too.
        low_m, high_m = float(measured.grid.z_m[0]), float(measured.grid.z_m[-1])
    else:
        low_m = float(np.nanmin(depth.depth_m)) - ROOM_M
        high_m = float(np.nanmax(depth.depth_m)) + ROOM_M
    n_z = max(3, round((high_m - low_m) / FINE_STEP_M) + 1)
    axes_m = (depth.x_m, depth.y_m, np.linspace(low_m, high_m, n_z))
    spacing_m = [(axis_m[-1] - axis_m[0]) / (len(axis_m) - 1) for axis_m in axes_m]
    origin_m = [axis_m[0] for axis_m in axes_m]
    return VoxelGrid(np.array(origin_m), np.array(spacing_m), (*depth.depth_m.shape[::-1], n_z))
