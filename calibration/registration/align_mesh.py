"""Registration of a mesh to a measured image, with correction of its bias."""

from __future__ import annotations

import numpy as np

from calibration.registration.alignment import Alignment, warned
from calibration.registration.closed_loop import (
    MAX_ROUNDS,
    SEARCH_SHARE,
    TOLERANCE_M,
    LoopSettings,
    close_loop,
)
from calibration.registration.mesh_pose import FINE_STEP_M, density_of, depth_for_mesh, locate
from calibration.registration.mesh_rendering import decimated
from calibration.registration.radar import Radar
from calibration.registration.search_space import PoseSearch
from clradar.model import AntennaArray, DepthMap, Scene, Volume, VoxelGrid, Waveform, checks
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device, open_device
from clradar.tracing.settings import SimulationSettings

SIMULATION_SAMPLES_PER_MM2, SIMULATION_RAYS_PER_SAMPLE = 3.0, 3
"""Of the simulations for the bias, whose errors are dominated by speckle, not by shot noise."""

MOST_SIMULATION_SAMPLES = 1_000_000  # of one of these simulations: seven times those of a hand
MARGIN_M = 20e-3  # depth of the imaged region before and behind a depth map


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
    """Find the rigid motion that brings a mesh onto its measured image.

    docs/registration-method.md has the equations. Every remark of the result is a warning.

    Parameters
    ----------
    measured : Volume or DepthMap
        In the antenna frame, on evenly spaced pixels.
    mesh : Scene
        In any pose, not necessarily in front of the radar. Its alpha has no influence.
    correct_bias : bool
        Subtract the error of fits to simulations of the mesh in the estimated pose. Without it, the
        estimate takes a fraction of the time and is off by up to some millimetres for specular
        surfaces.
    array, waveform : AntennaArray and Waveform, optional
        Of the measurement. Default: the 94 x 94 imager and 72 to 82 GHz in 128 steps.
    dynamic_range_db : float, optional
        As for `align`. Default: 20, or that of a `DepthMap` if it is less.
    min_inlier_share : float, in (0, 1]
        Smallest share of the measured amplitude on the mesh.
    search_deg, max_iterations
        As for `align`.
    seed : int
        Of the first simulation; the others count up from there.

    Returns
    -------
    Alignment
        `iterations` counts the simulations, or without bias correction the steps of the fit.

    Raises
    ------
    CompareError
        As by `align`.

    Examples
    --------
    A square plate, and its image 4 mm farther along x and 5 mm along z:

    >>> corners = [[-.02, -.02, .3], [.02, -.02, .3], [.02, .02, .3], [-.02, .02, .3]]
    >>> plate = clradar.Scene(corners, [[0, 1, 2], [0, 2, 3]])
    >>> x, y = np.meshgrid(axis_m := np.arange(-20, 21) * 2e-3, axis_m)
    >>> lit = np.maximum(abs(x - 0.004), abs(y)) < 0.0205
    >>> image = clradar.DepthMap(np.where(lit, 0.305, np.nan), 1.0 * lit, axis_m, axis_m, 20.0)
    >>> found = calibration.align_mesh(image, plate, correct_bias=False, search_deg=5.0)
    >>> np.abs(1e3 * found.shift_m).round()
    array([4., 0., 5.])
    """
    seed = checks.whole("align_mesh: seed", seed, 0)
    radar = Radar.of("align_mesh", array, waveform)
    options = PoseSearch("align_mesh", search_deg, min_inlier_share, max_iterations)
    opened = open_device(device)
    depth = depth_for_mesh(measured, dynamic_range_db)
    search_share = SEARCH_SHARE if correct_bias else 1.0
    searching = part_of(progress, 0.0, search_share)
    located = locate(depth, mesh, radar.aperture, options, opened, searching)
    if not correct_bias:
        return warned("align_mesh", located.alignment)
    coarse = decimated(depth, FINE_STEP_M)
    settings = LoopSettings(
        radar=radar,
        grid=_coarse_grid(measured, coarse),
        fit_alpha=True,
        simulation=SimulationSettings(
            samples_per_mm2=density_of(mesh, SIMULATION_SAMPLES_PER_MM2, MOST_SIMULATION_SAMPLES),
            rays_per_sample=SIMULATION_RAYS_PER_SAMPLE,
            seed=seed,
        ),
        dynamic_range_db=depth.dynamic_range_db,
        tolerance_m=TOLERANCE_M,
        max_rounds=MAX_ROUNDS,
    )
    simulating = part_of(progress, search_share, 1.0)
    found = close_loop(coarse, mesh, located, settings, opened, progress=simulating)
    return warned("align_mesh", found.alignment)


def _coarse_grid(measured: Volume | DepthMap, depth: DepthMap) -> VoxelGrid:
    """Grid over the measured region on the pixels of `depth`."""
    if isinstance(measured, Volume):
        # The same ends, so that the simulation is truncated like the measurement.
        low_m, high_m = float(measured.grid.z_m[0]), float(measured.grid.z_m[-1])
    else:
        low_m = float(np.nanmin(depth.depth_m)) - MARGIN_M
        high_m = float(np.nanmax(depth.depth_m)) + MARGIN_M
    n_z = max(3, round((high_m - low_m) / FINE_STEP_M) + 1)
    axes_m = (depth.x_m, depth.y_m, np.linspace(low_m, high_m, n_z))
    spacing_m = [(axis_m[-1] - axis_m[0]) / (len(axis_m) - 1) for axis_m in axes_m]
    origin_m = [axis_m[0] for axis_m in axes_m]
    return VoxelGrid(np.array(origin_m), np.array(spacing_m), (*depth.depth_m.shape[::-1], n_z))
