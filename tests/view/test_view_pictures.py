"""What the live view draws of a volume: colours where they belong, in the radar's view."""

from __future__ import annotations

import numpy as np
import pytest

import clradar
from clradar.errors import ModelError
from clradar.view.grids import LIVE_VOXELS, extents_mm, grid_mm, live_grid
from clradar.view.pictures import PANEL_PX, amplitude_colours, picture_of, voxels_of
from clradar.view.scene import box_edges

GRID = clradar.VoxelGrid([-0.01, 0.0, 0.30], [0.01, 0.01, 0.01], (3, 2, 4))


def volume_of(*voxels: tuple[int, int, int, float]) -> clradar.Volume:
    """A volume with these voxels (x, y, z, amplitude), 0 elsewhere."""
    data = np.zeros(GRID.shape, np.complex64)
    for x, y, z, amplitude in voxels:
        data[z, y, x] = amplitude
    return clradar.Volume(data, GRID)


def test_x_is_to_the_left_and_y_upwards() -> None:
    picture = picture_of(volume_of((2, 1, 1, 1.0)), 20.0)
    lit = (picture.amplitude == amplitude_colours(np.zeros(1), 20.0)[0]).all(axis=2)
    rows, columns = np.nonzero(lit)
    assert lit.shape == (PANEL_PX * 2 // 3, PANEL_PX)
    # The voxel of the largest x and y: a third of the width, half the height.
    assert (rows.min(), rows.max()) == (0, PANEL_PX // 3 - 1)
    assert (columns.min(), columns.max()) == (0, PANEL_PX // 3 - 1)
    assert lit.sum() == (PANEL_PX // 3) ** 2


def test_points_are_where_the_voxels_are_coloured_by_level() -> None:
    cloud = picture_of(volume_of((0, 0, 1, 1.0), (2, 1, 2, 0.5), (1, 1, 1, 0.01)), 20.0).cloud
    np.testing.assert_allclose(cloud.points_m, [[-0.01, 0, 0.31], [0.01, 0.01, 0.32]], atol=1e-7)
    expected = amplitude_colours(np.array([0.0, 20 * np.log10(0.5)]), 20.0)
    np.testing.assert_array_equal(cloud.colours, expected)
    assert not np.array_equal(expected[0], expected[1])


def test_an_image_without_anything_has_no_points() -> None:
    picture = picture_of(volume_of(), 20.0)
    assert len(picture.cloud.points_m) == 0
    assert np.isnan(picture.depth_mm).all()
    assert len(voxels_of(volume_of(), 20.0).points_m) == 0


def test_voxels_are_those_within_the_range_the_strongest_first() -> None:
    volume = volume_of((0, 0, 0, 1.0), (1, 0, 0, 0.5), (2, 0, 3, 0.2), (1, 1, 1, 0.05))
    np.testing.assert_allclose(
        voxels_of(volume, 20.0).points_m,
        [[-0.01, 0, 0.30], [0, 0, 0.30], [0.01, 0, 0.33]],
        atol=1e-7,
    )
    np.testing.assert_allclose(
        voxels_of(volume, 20.0, most=2).points_m, [[-0.01, 0, 0.30], [0, 0, 0.30]], atol=1e-7
    )


def test_the_papers_grid_is_viewed_every_second_millimetre() -> None:
    paper = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
    live = live_grid(paper)
    assert live.counts == (101, 101, 41)
    assert extents_mm(live) == ((-100.0, 100.0), (-100.0, 100.0), (260.0, 340.0))
    assert live_grid(live).same_voxels(live)
    assert np.prod(live.counts) <= LIVE_VOXELS


def test_a_grid_reaches_as_far_as_whole_steps() -> None:
    grid = grid_mm((-10, 10), (0, 0), (260, 275), 4.0)
    assert grid.counts == (6, 1, 4)
    assert extents_mm(grid) == ((-10.0, 10.0), (0.0, 0.0), (260.0, 272.0))


@pytest.mark.parametrize(
    ("x_mm", "step_mm", "words"),
    [
        ((10, -10), 1.0, "first <= last"),
        ((-10, 10), 0.0, "voxel size"),
        ((-900, 900), 0.1, "at most"),
    ],
)
def test_grids_that_cannot_be_viewed(x_mm: tuple[float, float], step_mm: float, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        grid_mm(x_mm, (-100, 100), (260, 340), step_mm)


def test_a_box_has_twelve_edges_along_the_axes() -> None:
    ends = np.array([[0.0, 1.0], [0.0, 2.0], [5.0, 8.0]])
    edges = box_edges(ends)
    lengths = np.abs(edges[:, 1] - edges[:, 0])
    assert (np.count_nonzero(lengths, axis=1) == 1).all()
    np.testing.assert_array_equal(np.sort(lengths.sum(axis=1)), [1] * 4 + [2] * 4 + [3] * 4)
    assert len({tuple(edge.ravel()) for edge in edges}) == 12
