"""S-parameters of the physical estimator, from the scene to dBsm."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from nightly import nightly

import clradar
from clradar import AntennaPattern, Scene, Waveform

WAVEFORM = Waveform.sfcw(72e9, 82e9, 8)
PATTERN = AntennaPattern(5.0, 1.0)


def power_mean_db(level_db: np.ndarray) -> float:
    return float(10 * np.log10(np.mean(10 ** (level_db / 10))))


@pytest.mark.parametrize("pattern", [PATTERN, *nightly([None])])
def test_a_sphere_has_pi_a_squared_and_its_image_reads_that(device, pattern):
    q = clradar.arrays.qar50()
    array = replace(q.part(*2 * (slice(None, None, 6),)), tx_pattern=pattern, rx_pattern=pattern)
    radius_m, range_m = 0.01, 0.6
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius_m)
    scene = Scene.from_mesh(ball.apply_translation([0, 0, range_m]))
    capture = clradar.simulate(
        scene, array, WAVEFORM, estimator="physical", samples_per_mm2=4.0, device=device
    )
    wanted = 10 * np.log10(np.pi * radius_m**2)
    # The divergence d / (d + a) is 0.15 dB. The sum ends at the shadow, which adds 1 / (2 ka) of
    # the amplitude with a phase that turns by 240 degrees over the band: 0.27 dB at most (ka = 16).
    samples = capture.rcs_dbsm([0, 0, range_m - radius_m])
    assert power_mean_db(samples) == pytest.approx(wanted - 0.15, abs=0.27)
    grid = clradar.VoxelGrid.from_extent((0, 0), (0, 0), (0.58, 0.60), 1e-3)
    image = clradar.backproject(capture, grid, check_grid=False, device=device)
    assert image.rcs_dbsm().max() == pytest.approx(wanted - 0.15, abs=0.3)
