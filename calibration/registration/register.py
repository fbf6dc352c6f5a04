"""Place a mesh where it was measured, and simulate it there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.registration.align_mesh import radar_of
from calibration.registration.alignment import Alignment
from calibration.registration.closed_loop import (
    MAX_ROUNDS,
    TOLERANCE_M,
    Callback,
    LoopSettings,
    Round,
    close_loop,
)
from calibration.registration.locate import depth_for_mesh, locate
from clradar.model import AntennaArray, Capture, Scene, Volume, Waveform, checks
from clradar.opencl import Device, open_device


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A mesh in its place, and what it looks like there.

    Attributes
    ----------
    alignment : Alignment
        measured = transform . mesh, at the last simulation.
    scene : Scene
        The mesh in its place, with the alpha of the last simulation.
    capture : Capture
    volume : Volume
        The last simulation, on the grid of the measured volume.
    rounds : tuple of Round
    converged : bool
        Whether the last round moved the mesh by less than the tolerance.
    """

    alignment: Alignment
    scene: Scene
    capture: Capture
    volume: Volume
    rounds: tuple[Round, ...]
    converged: bool


def register(
    measured: Volume,
    mesh: Scene,
    *,
    fit_alpha: bool = False,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    samples_per_mm2: float | None = None,
    rays_per_sample: int | None = None,
    seed: int = 0,
    dynamic_range_db: float | None = None,
    search_deg: float = 45.0,
    min_inlier_share: float = 0.5,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = 50,
    max_rounds: int = MAX_ROUNDS,
    device: Device | str | None = None,
    callback: Callback | None = None,
) -> Registration:
    """Place a mesh where it was measured, and simulate it there.

    Parameters
    ----------
    measured : Volume
        Of the object, in the antenna frame.
    mesh : Scene
        Anywhere; with the alpha to simulate with.
    fit_alpha : bool
        Find one alpha for the whole mesh instead, from how the brightness falls with the angle.
    array : AntennaArray, optional
    waveform : Waveform, optional
        Of the measurement: the 94 x 94 imager and 72 to 82 GHz in 128 steps if not given.
    samples_per_mm2, rays_per_sample, seed
        As in `clradar.simulate`; each round has a seed of its own, `seed` and up.
    dynamic_range_db, search_deg, min_inlier_share, max_iterations
        As in `align_mesh`.
    tolerance_m : float, metres
    max_rounds : int
        Rounds before it stops unconverged.
    device : Device, str or None
    callback : callable, optional
        Called with every `Round`.

    Returns
    -------
    Registration

    Raises
    ------
    CompareError
        "could not align, because …", as `align_mesh`; or no ray of a simulation reaches a receiver,
        or a simulation does not look like the mesh either.
    ModelError
        An option is out of its range.

    Notes
    -----
    `calibration.closed_loop` and docs/calibration.md have the equations.
    """
    checks.instance("register: measured", measured, Volume)
    radar, sweep = radar_of("register", array, waveform)
    settings = LoopSettings(
        array=radar,
        waveform=sweep,
        grid=measured.grid,
        fit_alpha=fit_alpha,
        samples_per_mm2=samples_per_mm2,
        rays_per_sample=rays_per_sample,
        seed=checks.whole("register: seed", seed, 0),
        dynamic_range_db=dynamic_range_db,
        tolerance_m=checks.positive("register: tolerance_m", tolerance_m),
        max_rounds=checks.whole("register: max_rounds", max_rounds, 1),
    )
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
        progress=None,
    )
    loop = close_loop(depth, mesh, located, settings, opened, callback)
    return Registration(
        loop.alignment,
        loop.scene,
        loop.capture,
        loop.volume,
        loop.rounds,
        loop.alignment.converged,
    )
