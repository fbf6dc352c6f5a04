"""Recordings in the antenna frame: targets and meshes land in their places, in x too."""

from __future__ import annotations

import maroon_files as files
import numpy as np
import pytest
import trimesh
from shapes import Mesh

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

MESH_M = 1e-3
"""What the depth of a placed mesh may be off by, in the median. The resolution in range is 15 mm;
the maximum along z is refined within the voxel of 2 mm, and what is left is speckle."""

EXPLAINED, NOT_EXPLAINED = 0.6, 0.4
"""Share of the depth map's pixels within two `MESH_M` of the mesh: the rest is beside it, where its
edges spread by the resolution of 4 mm over 260 mm of outline, a quarter of its area."""

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


def corner() -> Mesh:
    """Two bars at a right angle, one longer: no turn or mirror brings it onto itself. Metres."""
    vertices = np.array(
        [[-35, -30, 0], [35, -30, 0], [35, 0, 0], [0, 0, 0], [0, 25, 0], [-35, 25, 0]]
    )
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    return vertices * 1e-3, faces


def test_a_placed_mesh_coincides_with_its_own_depth_map(tmp_path, device):
    vertices, faces = corner()
    # To the radar it is turned about all three axes, and further about y than about x.
    matrix = files.rigid((3, 174, 31), (0.02, -0.01, 0.3))
    radar = files.write_recording(tmp_path / "30", n_frames=1)
    files.write_mesh(radar.parent, "mesh", vertices, faces)
    files.write_alignment(radar.parent, {"photogrammetry2radar": matrix})

    scene = open_recording(radar).scene(alpha=0.3)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
    capture = clradar.simulate(
        scene, clradar.arrays.qar50(), waveform, samples_per_mm2=8, device=device
    )
    grid = clradar.VoxelGrid.from_extent((-0.06, 0.02), (-0.05, 0.03), (0.28, 0.32), STEP_M)
    depth = clradar.backproject(capture, grid, device=device).depth_map()
    assert depth.mask.sum() > 300

    in_radar = vertices @ matrix[:3, :3].T + matrix[:3, 3]

    def errors_m(placed: np.ndarray) -> np.ndarray:
        """Depth along z minus that of the mesh, where a line along z meets it."""
        points = depth.points_m()
        along_z = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        mesh = trimesh.Trimesh(placed, faces, process=False)
        hits, rays, _ = mesh.ray.intersects_location(
            points * (1, 1, 0), along_z, multiple_hits=False
        )
        return np.abs(points[rays, 2] - hits[:, 2])

    placed = errors_m(in_radar * (-1, 1, 1))
    assert np.median(placed) < MESH_M
    pixels = depth.mask.sum()
    assert np.count_nonzero(placed < 2 * MESH_M) > EXPLAINED * pixels
    unmirrored = errors_m(in_radar)
    assert np.count_nonzero(unmirrored < 2 * MESH_M) < NOT_EXPLAINED * pixels
