"""Maximum projection and depth map, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from clradar import DepthMap, Volume, VoxelGrid
from clradar.errors import ModelError
from clradar.model.volume import plane_slabs

# Amplitudes are float32: each errs by 6e-8 of about 1. The parabola's vertex divides differences of
# them by a curvature of 0.2 here, so by some 1e-6 of a voxel.
VERTEX_ERROR = 2e-6
# Depths are origin + spacing * index below 1 m in float64.
ROUNDING_M = 1e-15

SPACING_M = 2e-3
FIRST_M = 0.26


def volume(amplitude: np.ndarray, phase_seed: int = 0) -> Volume:
    """A volume whose amplitude[z, y, x] is given, with random phases."""
    n_z, n_y, n_x = amplitude.shape
    phase = np.random.default_rng(phase_seed).uniform(0, 2 * np.pi, amplitude.shape)
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


def depth_in_voxels(image: Volume, dynamic_range_db: float = 15.0) -> np.ndarray:
    return (image.depth_map(dynamic_range_db).depth_m - FIRST_M) / SPACING_M


def test_max_projection_is_the_largest_amplitude_along_z() -> None:
    amplitude = np.random.default_rng(1).uniform(0, 1, (5, 4, 3))
    image = volume(amplitude).max_projection()
    assert image.shape == (4, 3)
    assert image.dtype == np.float32
    # |exp(j phase)| in complex64: two products, a sum and a root, 6e-8 each.
    np.testing.assert_allclose(image, amplitude.max(axis=0), rtol=3e-7)


@pytest.mark.parametrize("vertex", [3.0, 3.2, 2.75, 3.49, 2.51])
def test_a_parabola_is_found_where_it_is(vertex: float) -> None:
    samples = 1.0 - 0.1 * (np.arange(7) - vertex) ** 2
    assert depth_in_voxels(column(*samples))[0, 0] == pytest.approx(vertex, abs=VERTEX_ERROR)


def test_planes_may_be_read_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    image = volume(np.random.default_rng(3).uniform(0.5, 1, (9, 4, 5)))
    whole = image.depth_map()
    monkeypatch.setattr("clradar.model.volume.plane_slabs", lambda grid: plane_slabs(grid, 1))
    np.testing.assert_array_equal(image.depth_map().depth_m, whole.depth_m)


def test_many_parabolas_at_once() -> None:
    vertex = np.random.default_rng(2).uniform(2, 8, (6, 5))
    z = np.arange(11)[:, None, None]
    image = volume(np.maximum(1.0 - 0.1 * (z - vertex) ** 2, 0.0))
    np.testing.assert_allclose(depth_in_voxels(image), vertex, rtol=0, atol=VERTEX_ERROR)


@pytest.mark.parametrize(
    ("samples", "depth"),
    [
        ((0.0, 1.0, 0.0), 1.0),
        ((0.5, 1.0, 0.5), 1.0),
        ((0.0, 1.0, 1.0), 1.5),  # two equal: half way between them
        ((0.2, 1.0, 0.8), 1.3),  # 0.5 (0.2 - 0.8) / (0.2 - 2 + 0.8)
        ((0.8, 1.0, 0.2), 0.7),
        ((0.7, 0.7, 0.7), 0.0),  # the first of equal ones is an end
        ((0.1, 0.7, 0.7, 0.7, 0.1), 1.5),
        ((1.0, 0.9, 0.1), 0.0),  # no refinement at the ends
        ((0.1, 0.9, 1.0), 2.0),
        ((0.9, 1.0), 1.0),
        ((1.0, 0.9), 0.0),
        ((1.0,), 0.0),
        ((0.2, 1.0, 0.1, 0.9, 1.0, 0.9), 0.5 * (0.2 - 0.1) / (0.2 - 2 + 0.1) + 1),
    ],
)
def test_the_vertex_by_hand(samples: tuple[float, ...], depth: float) -> None:
    assert depth_in_voxels(column(*samples))[0, 0] == pytest.approx(depth, abs=VERTEX_ERROR)


def test_the_depth_stays_in_its_voxel() -> None:
    rng = np.random.default_rng(3)
    amplitude = rng.uniform(0, 1, (7, 40, 50)) ** 0.1  # nearly flat: vertices far off are likely
    found = depth_in_voxels(volume(amplitude), 60.0)
    top = volume(amplitude).data
    nearest = np.abs(top).argmax(axis=0)
    assert np.abs(found - nearest).max() <= 0.5 + VERTEX_ERROR
    ends = (nearest == 0) | (nearest == 6)
    assert ends.any()
    assert np.abs(found - nearest)[ends].max() <= ROUNDING_M / SPACING_M
    # The maximum beats both neighbours, which alone bounds the vertex.
    assert np.abs(found - nearest).max() > 0.49


@pytest.mark.parametrize("dynamic_range_db", [3.0, 15.0, 40.0])
def test_the_cut_lies_at_the_dynamic_range(dynamic_range_db: float) -> None:
    # 0.01 dB to either side of the cut; float32 amplitudes err by 1e-6 dB.
    levels_db = -dynamic_range_db + np.array([0.01, -0.01])
    amplitude = np.zeros((3, 1, 4))
    amplitude[1, 0] = [1.0, *10 ** (levels_db / 20), 0.0]
    depth_map = volume(amplitude).depth_map(dynamic_range_db)
    assert depth_map.mask.tolist() == [[True, True, False, False]]
    assert depth_map.dynamic_range_db == dynamic_range_db
    np.testing.assert_array_equal(np.isnan(depth_map.depth_m), ~depth_map.mask)
    np.testing.assert_allclose(depth_map.amplitude, amplitude[1], rtol=3e-7)


def test_the_default_cut_is_15_db() -> None:
    amplitude = np.zeros((3, 1, 3))
    amplitude[1, 0] = [1.0, 10 ** (-14.99 / 20), 10 ** (-15.01 / 20)]
    assert volume(amplitude).depth_map().mask.tolist() == [[True, True, False]]


def test_the_cut_is_relative_to_the_image_whatever_its_scale() -> None:
    amplitude = np.random.default_rng(4).uniform(0, 1, (5, 6, 7))
    want = volume(amplitude).depth_map()
    for scale in (2.0**-60, 2.0**60):
        got = volume(amplitude * scale).depth_map()
        np.testing.assert_array_equal(got.mask, want.mask)
        np.testing.assert_array_equal(got.depth_m, want.depth_m)


def test_nothing_anywhere_is_nan_everywhere() -> None:
    depth_map = volume(np.zeros((4, 3, 2))).depth_map()
    assert np.isnan(depth_map.depth_m).all()
    assert not depth_map.amplitude.any()
    assert depth_map.points_m().shape == (0, 3)
    assert not volume(np.zeros((4, 3, 2))).max_projection().any()


def test_a_single_plane_has_its_own_depth() -> None:
    amplitude = np.array([[[1.0, 0.5], [0.01, 0.0]]])
    depth_map = volume(amplitude).depth_map()
    assert depth_map.mask.tolist() == [[True, True], [False, False]]
    assert depth_map.depth_m[0].tolist() == [FIRST_M, FIRST_M]


def test_axes_and_points() -> None:
    amplitude = np.zeros((3, 2, 3))
    amplitude[1, 0, 2] = 1.0
    amplitude[2, 1, 0] = 0.9
    depth_map = volume(amplitude).depth_map()
    x_m, y_m = -0.01 + 1e-3 * np.arange(3), -0.02 + 3e-3 * np.arange(2)
    np.testing.assert_allclose(depth_map.x_m, x_m, rtol=0, atol=ROUNDING_M)
    np.testing.assert_allclose(depth_map.y_m, y_m, rtol=0, atol=ROUNDING_M)
    want = [[-0.008, -0.02, FIRST_M + SPACING_M], [-0.01, -0.017, FIRST_M + 2 * SPACING_M]]
    np.testing.assert_allclose(depth_map.points_m(), want, rtol=0, atol=ROUNDING_M)


@pytest.mark.parametrize("dynamic_range_db", [0.0, -15.0, np.nan, np.inf, "15"])
def test_a_dynamic_range_is_a_positive_number(dynamic_range_db: float) -> None:
    with pytest.raises(ModelError, match=r"depth_map: dynamic_range_db: expected a .*number"):
        volume(np.ones((2, 2, 2))).depth_map(dynamic_range_db)


def test_depth_map_makes_its_own_mask() -> None:
    depth = np.array([[0.3, np.nan], [np.nan, 0.31]])
    depth_map = DepthMap(depth, np.ones((2, 2)), [0.0, 1.0], [0.0, 1.0])
    assert depth_map.mask.tolist() == [[True, False], [False, True]]
    np.testing.assert_array_equal(depth_map.points_m(), [[0, 0, 0.3], [1, 1, 0.31]])
