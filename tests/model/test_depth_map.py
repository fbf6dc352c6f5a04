"""Maximum projection and depth map, against closed forms."""

import numpy as np
import pytest

from clradar import Volume, VoxelGrid

# Amplitudes are float32: each errs by 6e-8 of about 1. The parabola's vertex divides differences of
# them by a curvature of 0.2 here, so by some 1e-6 of a voxel.
VERTEX_ERROR = 2e-6
# Depths are origin + spacing * index below 1 m in float64.
ROUNDING_M = 1e-15

SPACING_M = 2e-3
FIRST_M = 0.26


def volume(amplitude: np.ndarray) -> Volume:
    """A volume whose amplitude[z, y, x] is given, with random phases."""
    n_z, n_y, n_x = amplitude.shape
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, amplitude.shape)
    grid = VoxelGrid(
        np.array([-0.01, -0.02, FIRST_M]), np.array([1e-3, 3e-3, SPACING_M]), (n_x, n_y, n_z)
    )
    return Volume(amplitude * np.exp(1j * phase), grid)


def column(*amplitude: float) -> Volume:
    """A volume of one column along z, its phases zero."""
    data = np.array(amplitude, np.complex64)[:, None, None]
    return Volume(
        data, VoxelGrid(np.array([0, 0, FIRST_M]), np.full(3, SPACING_M), (1, 1, len(data)))
    )


def depth_in_voxels(image: Volume) -> np.ndarray:
    return (image.depth_map().depth_m - FIRST_M) / SPACING_M


def test_max_projection_is_the_largest_amplitude_along_z():
    amplitude = np.random.default_rng(1).uniform(0, 1, (5, 4, 3))
    image = volume(amplitude).max_projection()
    assert image.shape == (4, 3)
    assert image.dtype == np.float32
    # |exp(j phase)| in complex64: two products, a sum and a root, 6e-8 each.
    np.testing.assert_allclose(image, amplitude.max(axis=0), rtol=3e-7)


@pytest.mark.parametrize("vertex", [3.0, 3.2, 2.51])
def test_a_parabola_is_found_where_it_is(vertex):
    samples = 1.0 - 0.1 * (np.arange(7) - vertex) ** 2
    assert depth_in_voxels(column(*samples))[0, 0] == pytest.approx(vertex, abs=VERTEX_ERROR)


@pytest.mark.parametrize(
    ("samples", "depth"),
    [
        ((0.0, 1.0, 1.0), 1.5),  # two equal: half way between them
        ((0.2, 1.0, 0.8), 1.3),  # 0.5 (0.2 - 0.8) / (0.2 - 2 + 0.8)
        ((0.7, 0.7, 0.7), 0.0),  # the first of equal ones is an end
        ((0.1, 0.7, 0.7, 0.7, 0.1), 1.5),
        ((1.0, 0.9, 0.1), 0.0),  # no refinement at the ends
        ((0.1, 0.9, 1.0), 2.0),
        ((1.0,), 0.0),
        ((0.2, 1.0, 0.1, 0.9, 1.0, 0.9), 0.5 * (0.2 - 0.1) / (0.2 - 2 + 0.1) + 1),
    ],
)
def test_the_vertex_by_hand(samples, depth):
    assert depth_in_voxels(column(*samples))[0, 0] == pytest.approx(depth, abs=VERTEX_ERROR)


@pytest.mark.parametrize("dynamic_range_db", [3.0, 40.0])
def test_the_cut_lies_at_the_dynamic_range(dynamic_range_db):
    # 0.01 dB to either side of the cut; float32 amplitudes err by 1e-6 dB.
    levels_db = -dynamic_range_db + np.array([0.01, -0.01])
    amplitude = np.zeros((3, 1, 4))
    amplitude[1, 0] = [1.0, *10 ** (levels_db / 20), 0.0]
    depth_map = volume(amplitude).depth_map(dynamic_range_db)
    assert depth_map.mask.tolist() == [[True, True, False, False]]
    assert depth_map.dynamic_range_db == dynamic_range_db
    np.testing.assert_array_equal(np.isnan(depth_map.depth_m), ~depth_map.mask)
    np.testing.assert_allclose(depth_map.amplitude, amplitude[1], rtol=3e-7)


def test_nothing_anywhere_is_nan_everywhere():
    depth_map = volume(np.zeros((4, 3, 2))).depth_map()
    assert np.isnan(depth_map.depth_m).all()
    assert not depth_map.amplitude.any()
    assert depth_map.points_m().shape == (0, 3)
    assert not volume(np.zeros((4, 3, 2))).max_projection().any()


def test_axes_and_points():
    amplitude = np.zeros((3, 2, 3))
    amplitude[1, 0, 2] = 1.0
    amplitude[2, 1, 0] = 0.9
    depth_map = volume(amplitude).depth_map()
    x_m, y_m = -0.01 + 1e-3 * np.arange(3), -0.02 + 3e-3 * np.arange(2)
    np.testing.assert_allclose(depth_map.x_m, x_m, rtol=0, atol=ROUNDING_M)
    np.testing.assert_allclose(depth_map.y_m, y_m, rtol=0, atol=ROUNDING_M)
    want = [[-0.008, -0.02, FIRST_M + SPACING_M], [-0.01, -0.017, FIRST_M + 2 * SPACING_M]]
    np.testing.assert_allclose(depth_map.points_m(), want, rtol=0, atol=ROUNDING_M)
