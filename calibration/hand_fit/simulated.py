"""A hand simulated and imaged as a fit does it: fast, with errors below the speckle."""

from __future__ import annotations

from calibration.registration.align_mesh import (
    MOST_SIMULATION_SAMPLES,
    SIMULATION_RAYS_PER_SAMPLE,
    SIMULATION_SAMPLES_PER_MM2,
)
from calibration.registration.mesh_pose import density_of
from calibration.registration.radar import Radar
from clradar.backproject import backproject
from clradar.model import AntennaArray, Capture, Scene, Volume, VoxelGrid, Waveform
from clradar.opencl import Device
from clradar.simulation import simulate


def simulated(
    scene: Scene,
    grid: VoxelGrid,
    *,
    array: AntennaArray | None = None,
    waveform: Waveform | None = None,
    seed: int = 0,
    device: Device | str | None = None,
) -> tuple[Capture, Volume]:
    """Return the capture of a hand, and its image on `grid`."""
    radar = Radar.of("fit_hand", array, waveform)
    capture = simulate(
        scene,
        radar.array,
        radar.waveform,
        samples_per_mm2=density_of(scene, SIMULATION_SAMPLES_PER_MM2, MOST_SIMULATION_SAMPLES),
        rays_per_sample=SIMULATION_RAYS_PER_SAMPLE,
        seed=seed,
        device=device,
    )
    return capture, backproject(capture, grid, device=device)
