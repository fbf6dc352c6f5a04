"""What the live view draws of a volume: colours where they belong, in the radar's view."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

import clradar
from clradar.calibration import CornerReflector, response
from clradar.errors import CompareError, ModelError
from clradar.view.channels import pair_drawings
from clradar.view.framed import Axis
from clradar.view.grids import LIVE_VOXELS, extents_mm, grid_mm, live_grid
from clradar.view.pictures import (
    amplitude_colours,
    depth_drawing,
    difference_drawing,
    picture_of,
    projection_drawing,
    voxels_of,
)
from clradar.view.scene import box_edges
from clradar.view.slices import clicked_m, pointed_m, slice_drawings, strongest_m

GRID = clradar.VoxelGrid([-0.01, 0.0, 0.30], [0.01, 0.01, 0.01], (3, 2, 4))


def volume_of(*voxels: tuple[int, int, int, float]) -> clradar.Volume:
    """A volume with these voxels (x, y, z, amplitude), 0 elsewhere."""
    data = np.zeros(GRID.shape, np.complex64)
    for x, y, z, amplitude in voxels:
        data[z, y, x] = amplitude
    return clradar.Volume(data, GRID)


def pixels_of(drawing: str) -> np.ndarray:
    """The first image in an SVG."""
    data = drawing.split("data:image/png;base64,")[1].split('"')[0]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


STRONGEST = amplitude_colours(np.zeros(1), 20.0)[0]


def lit(drawing: str) -> list[tuple[int, int]]:
    """Rows and columns of the strongest pixels."""
    rows, columns = np.nonzero((pixels_of(drawing) == STRONGEST).all(axis=2))
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def test_x_is_to_the_left_and_y_upwards() -> None:
    drawing = projection_drawing(picture_of(volume_of((2, 1, 1, 1.0)), 20.0).image)
    assert pixels_of(drawing).shape == (2, 3, 3)
    assert lit(drawing) == [(0, 0)]
    # From the upper left corner: ticks of y, falling, and of x, from the largest to the smallest.
    texts = re.findall(r'<text x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]+)</text>', drawing)
    at = {words: (float(x), float(y)) for x, y, words in texts}
    assert at["10"][0] < at["-10"][0]
    assert {"x (mm)", "y (mm)", "dB", "0", "-20"} <= set(at)


def test_slices_go_through_the_place_in_the_radars_view() -> None:
    volume = volume_of((2, 1, 3, 1.0), (0, 0, 0, 0.5))
    assert strongest_m(volume) == pytest.approx((0.01, 0.01, 0.33))
    across, along, side = slice_drawings(volume, (0.012, 0.008, 0.331), 20.0)
    assert lit(across) == [(0, 0)]  # x to the left, y up
    assert pixels_of(along).shape == (4, 3, 3)
    assert lit(along) == [(0, 0)]  # x to the left, z up
    assert pixels_of(side).shape == (2, 4, 3)
    assert lit(side) == [(0, 3)]  # z to the right, y up
    for drawing, title in ((across, "z = 330 mm"), (along, "y = 10 mm"), (side, "x = 10 mm")):
        assert title in drawing
    # A place without the strongest voxel: its slices are dark relative to the whole volume.
    assert not any(lit(drawing) for drawing in slice_drawings(volume, (-0.01, 0.0, 0.30), 20.0))


def test_a_click_on_a_drawing_means_the_voxel_that_is_drawn_there() -> None:
    volume = volume_of((2, 1, 3, 1.0), (0, 0, 1, 0.9))
    slices = slice_drawings(volume, (0.01, 0.01, 0.33), 20.0)
    drawings = dict(zip(("xy", "xz", "zy"), slices, strict=True))
    drawings["projection"] = projection_drawing(picture_of(volume, 20.0).image)
    for name, drawing in drawings.items():
        assert f"/click/{name}/" in drawing
        rows, columns = pixels_of(drawing).shape[:2]
        for row, column in lit(drawing):
            place = (column + 0.5) / columns, (row + 0.5) / rows
            assert pointed_m(volume, (0.01, 0.01, 0.33), name, *place) == strongest_m(volume)
    # In a projection the strongest voxel along z; at the very edge the last voxel.
    assert pointed_m(volume, (0.01, 0.01, 0.33), "projection", 1.0, 1.0) == pytest.approx(
        (-0.01, 0.0, 0.31)
    )


def test_a_click_takes_the_point_that_its_ray_meets_first() -> None:
    points_m = np.array([[0.0, 0.0, 0.32], [0.0, 0.001, 0.30], [0.03, 0.0, 0.25]], np.float32)
    eye = np.array([0.0, 0.0, -0.2])
    ahead = np.array([0.0, 0.0, 5.0])
    assert clicked_m(points_m, eye, ahead, 2e-3) == pytest.approx((0.0, 0.001, 0.30))
    aside = points_m[2] - eye
    assert clicked_m(points_m, eye, aside, 2e-3) == pytest.approx((0.03, 0.0, 0.25))
    assert clicked_m(points_m, eye, np.array([0.0, 1.0, 0.0]), 2e-3) is None
    assert clicked_m(points_m, eye, -ahead, 2e-3) is None  # behind the eye


def test_the_difference_is_brown_where_the_simulation_is_farther() -> None:
    first, second = (
        picture_of(volume_of((0, 0, z, 1.0), (1, 0, 1, 1.0)), 20.0).image for z in (1, 2)
    )
    image = pixels_of(difference_drawing(first, second)).astype(int)
    red, _, blue = image[1, 2]  # the lowest y, the smallest x
    assert red > blue + 100
    np.testing.assert_array_equal(image[1, 1] > 250, True)  # no difference: white
    other = clradar.VoxelGrid(GRID.origin_m, GRID.spacing_m, (3, 3, 4))
    with pytest.raises(CompareError):
        difference_drawing(
            first, picture_of(clradar.Volume(np.ones(other.shape), other), 20.0).image
        )


def test_channel_data_of_a_pair_peak_at_its_range() -> None:
    array, waveform = clradar.arrays.qar50(), clradar.Waveform.sfcw(72e9, 82e9, 64)
    data = response(CornerReflector((0.0, 0.0, 0.3)), array, waveform)
    data[5, 7] *= 1e-3
    capture = clradar.Capture(data, array, waveform)
    overview, magnitude, phase, profile = pair_drawings(capture, 5, 7)
    image = pixels_of(overview).astype(int)
    assert image.shape == (94, 94, 3)
    dark = image.sum(axis=2)
    assert np.unravel_index(dark.argmin(), dark.shape) == (93 - 5, 7)  # Tx from below
    for drawing, unit in ((magnitude, "GHz"), (phase, "turns"), (profile, "half the path (mm)")):
        assert "Tx 5, Rx 7" in drawing
        assert unit in drawing
    line = re.search(r'points="([^"]+)"', profile)
    assert line is not None
    x, y = np.array([point.split(",") for point in line[1].split()], float).T
    path_m = np.linalg.norm(array.tx_m[5] - [0, 0, 0.3]) + np.linalg.norm(
        array.rx_m[7] - [0, 0, 0.3]
    )
    share = path_m / 2 / waveform.unambiguous_range_m
    assert (x[y.argmin()] - x[0]) / (x[-1] - x[0]) == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(
    ("first", "last", "ticks"),
    [
        (100.0, -100.0, [-100, -50, 0, 50, 100]),
        (-0.5, 93.5, [0, 20, 40, 60, 80]),
        (0.30, 0.31, [0.3, 0.302, 0.304, 0.306, 0.308, 0.31]),
    ],
)
def test_ticks_are_round(first: float, last: float, ticks: list[float]) -> None:
    assert Axis("x", first, last).ticks() == ticks


def test_points_are_where_the_voxels_are_coloured_by_level() -> None:
    cloud = picture_of(volume_of((0, 0, 1, 1.0), (2, 1, 2, 0.5), (1, 1, 1, 0.01)), 20.0).cloud
    np.testing.assert_allclose(cloud.points_m, [[-0.01, 0, 0.31], [0.01, 0.01, 0.32]], atol=1e-7)
    expected = amplitude_colours(np.array([0.0, 20 * np.log10(0.5)]), 20.0)
    np.testing.assert_array_equal(cloud.colours, expected)
    assert not np.array_equal(expected[0], expected[1])


def test_an_image_without_anything_has_no_points() -> None:
    picture = picture_of(volume_of(), 20.0)
    assert len(picture.cloud.points_m) == 0
    assert "Depth: nothing seen" in depth_drawing(picture.image)
    assert not lit(projection_drawing(picture.image))
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
