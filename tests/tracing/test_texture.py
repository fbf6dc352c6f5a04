"""Roughness that moves with the body."""

from dataclasses import replace

import numpy as np
import trimesh

import clradar
from clradar.phasors.kirchhoff_sum import TOLERANCE_DB

ROUGH = clradar.Material("rough", conductor=True, roughness_rms_m=0.4e-3, correlation_length_m=4e-3)
WAVEFORM = clradar.Waveform.sfcw(76e9, 78e9, 3)
IMAGER = clradar.arrays.qar50()
ARRAY = clradar.AntennaArray(IMAGER.tx_m[::12], IMAGER.rx_m[::12])


def simulated(scene: clradar.Scene, array: clradar.AntennaArray, seed: int = 0) -> np.ndarray:
    return clradar.simulate(
        scene, array, WAVEFORM, estimator="physical", seed=seed, device="pocl"
    ).data


def off_db(got: np.ndarray, want: np.ndarray) -> float:
    return float(20 * np.log10(np.linalg.norm(got - want) / np.linalg.norm(want)))


def test_bumps_move_with_the_body():
    """A body and antennas that move together record the same; with other bumps another thing."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.012)
    ball.apply_translation([0.01, -0.005, 0.25])
    scene = clradar.Scene.from_mesh(ball, material=ROUGH)
    here = simulated(scene, ARRAY)
    motion = trimesh.transformations.rotation_matrix(0.6, [0, 0, 1])
    motion[:3, 3] = [0.03, -0.02, 0.05]
    moved = scene.transformed(motion)
    array = clradar.AntennaArray(
        *(side @ motion[:3, :3].T + motion[:3, 3] for side in (ARRAY.tx_m, ARRAY.rx_m))
    )
    # Both are within the tolerance of the sums.
    assert off_db(simulated(moved, array), here) < TOLERANCE_DB + 6
    # Scattered power is most of it here, g = (2 k h)^2 = 1.7: bumps of other places change it all.
    assert off_db(simulated(replace(moved, texture_m=None), array), here) > -10
    assert off_db(simulated(moved, array, seed=1), here) > -10
