"""Registration of a mesh in closed loop with its simulation."""

from __future__ import annotations

from typing import Any

from calibration.registration.alignment import warned
from calibration.registration.alpha_cue import ALPHA_STARTS, FEWEST_ROUNDS
from calibration.registration.closed_loop import (
    MAX_ROUNDS,
    SEARCH_SHARE,
    TOLERANCE_M,
    Callback,
    LoopSettings,
    Registration,
    close_loop,
)
from calibration.registration.mesh_pose import depth_for_mesh, locate
from calibration.registration.radar import Radar
from calibration.registration.search_space import PoseSearch
from clradar.errors import warn
from clradar.model import AntennaArray, Scene, Volume, Waveform, checks
from clradar.model.material import METAL
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device, open_device
from clradar.tracing.settings import SimulationSettings, merged_settings, takes_settings


@takes_settings
def register(
    measured: Volume,
    mesh: Scene,
    *,
    fit_alpha: bool = False,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    dynamic_range_db: float | None = None,
    search_deg: float = 45.0,
    min_inlier_share: float = 0.5,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = 50,
    max_rounds: int = MAX_ROUNDS,
    device: Device | str | None = None,
    callback: Callback | None = None,
    progress: Progress | None = None,
    settings: SimulationSettings | None = None,
    **fields: Any,
) -> Registration:
    """Find the measured pose of a mesh, and simulate it there.

    docs/registration-method.md has the equations. Every remark of the alignment is a warning.

    Parameters
    ----------
    measured : Volume
        In the antenna frame.
    mesh : Scene
        In any pose; with the alpha of the simulations, or with a material, which chooses the
        physical estimator as in `clradar.simulate`.
    fit_alpha : bool
        Estimate one alpha for the whole mesh instead; not with the physical estimator.
    tolerance_m : float
        Converged when a round moves the mesh by less.
    max_rounds : int
        Rounds before it stops unconverged, at least two to converge, with `fit_alpha` 7.
    callback : callable, optional
        Called with every `Round`.
    settings, **fields
        Of the simulations, as of `clradar.simulate`; rounds use seeds from `seed` upwards.
    array, waveform, dynamic_range_db, search_deg, min_inlier_share, max_iterations
        As for `align_mesh`.

    Returns
    -------
    Registration

    Raises
    ------
    CompareError
        As by `align_mesh`; or no ray of a simulation reaches a receiver.

    Examples
    --------
    A rough plate, and a simulation of it 4 mm farther along x, in place of a measurement:

    >>> corners = [[-.02, -.02, .3], [.02, -.02, .3], [.02, .02, .3], [-.02, .02, .3]]
    >>> plate = clradar.Scene(corners, [[0, 1, 2], [0, 2, 3]], 0.5)
    >>> there = np.eye(4)
    >>> there[0, 3] = 0.004
    >>> array = clradar.arrays.qar50().part(np.s_[::2], np.s_[::2])
    >>> radar = {"array": array, "waveform": clradar.Waveform.sfcw(72e9, 82e9, 16)}
    >>> rays = {"samples_per_mm2": 6.0, "rays_per_sample": 4}
    >>> capture = clradar.simulate(plate.transformed(there), seed=9, **rays, **radar)
    >>> grid = clradar.VoxelGrid.from_extent((-0.036, 0.036), (-0.036, 0.036), (0.28, 0.32), 2e-3)
    >>> image = clradar.backproject(capture, grid)
    >>> found = calibration.register(
    ...     image, plate, search_deg=5.0, tolerance_m=1e-3, max_rounds=4, **rays, **radar)
    >>> print(np.linalg.norm(found.alignment.shift_m - [0.004, 0, 0]) < 0.003)
    True
    """
    checks.instance("register: measured", measured, Volume)
    checks.instance("register: mesh", mesh, Scene)
    chosen = merged_settings(settings, **fields)
    if mesh.materials != (METAL,) and not fit_alpha:
        chosen = chosen.for_scene(mesh)
    simulation = chosen.resolved()
    if fit_alpha and simulation.estimator == "physical":
        checks.fail("register: fit_alpha", "False with estimator='physical'", "True")
    radar = Radar.of("register", array, waveform)
    options = PoseSearch("register", search_deg, min_inlier_share, max_iterations)
    loop_settings = LoopSettings(
        radar=radar,
        grid=measured.grid,
        fit_alpha=fit_alpha,
        simulation=simulation,
        dynamic_range_db=dynamic_range_db,
        tolerance_m=checks.positive("register: tolerance_m", tolerance_m),
        max_rounds=checks.whole("register: max_rounds", max_rounds, 1),
    )
    if fit_alpha and loop_settings.max_rounds < FEWEST_ROUNDS:
        warn(
            f"register: max_rounds is {loop_settings.max_rounds}, and alpha is found in "
            f"{FEWEST_ROUNDS} or more, since the first {len(ALPHA_STARTS)} try fixed ones: take "
            "more, or give alpha (fit_alpha=False, --alpha)"
        )
    opened = open_device(device)
    depth = depth_for_mesh(measured, dynamic_range_db)
    searching, simulating = part_of(progress, 0.0, SEARCH_SHARE), part_of(progress, SEARCH_SHARE, 1)
    located = locate(depth, mesh, radar.aperture, options, opened, searching)
    found = close_loop(depth, mesh, located, loop_settings, opened, callback, simulating)
    warned("register", found.alignment)
    return found
