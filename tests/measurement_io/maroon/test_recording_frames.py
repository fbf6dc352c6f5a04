"""Recordings in the antenna frame: targets and meshes land in their places, in x too."""

import maroon_files as files
import numpy as np
import pytest

import clradar
from measurement_io import open_recording

STEP_M = 2e-3

PEAK_M = 1e-6
"""Targets lie on voxels, so their peaks do; this is the rounding of the grid's axes."""

SAME_PEAK_DB = 0.1
"""Targets of strength 1 that are 3 cm and more apart: the sidelobes of the others at the peak, some
-45 dB of it, and -54 dB of interpolation in range."""

NOT_THERE = 0.5
"""Sidelobes within 6 mm of a place where there is no target, against targets of strength 1."""


TARGETS = ((0.030, 0.012, 0.300), (-0.012, 0.030, 0.290), (-0.034, -0.022, 0.312))
"""No two of them mirror images of each other in x, in y, or with x and y exchanged."""


@pytest.mark.parametrize("distance", ["30", "40", "50"])
@pytest.mark.parametrize("method", ["exact", "range"])
def test_point_targets_land_where_they_were_put(tmp_path, distance, method, device):
    further_m = int(distance) / 100 - 0.3
    targets = [(x, y, z + further_m) for x, y, z in TARGETS]
    frame = files.point_target_frame([(*t, 1.0) for t in targets], n_freq=24)
    radar = tmp_path / distance / "radar_72.0_82.0_24"
    files.write_frame(radar / "calibrated_data" / "000000.npy", frame)
    capture = open_recording(tmp_path / distance)[0]

    def peak(x: float, y: float, z: float) -> tuple[np.ndarray, float]:
        grid = clradar.VoxelGrid.from_extent(
            *((c - 3 * STEP_M, c + 3 * STEP_M) for c in (x, y, z)), STEP_M
        )
        volume = clradar.backproject(
            capture, grid, method=method, device=device, check_grid=False
        )  # beside the targets on purpose
        amplitude = np.abs(volume.data)
        k, j, i = np.unravel_index(int(amplitude.argmax()), amplitude.shape)
        return np.array([grid.x_m[i], grid.y_m[j], grid.z_m[k]]), float(amplitude.max())

    for x, y, z in targets:
        place, height = peak(x, y, z)
        np.testing.assert_allclose(place, (x, y, z), atol=PEAK_M)
        assert abs(20 * np.log10(height)) < SAME_PEAK_DB
        for wrong in ((-x, y, z), (x, -y, z), (y, x, z)):
            # A reader that mirrored or exchanged axes would find them there.
            assert peak(*wrong)[1] < NOT_THERE
