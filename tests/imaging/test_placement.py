"""Grids placed around the object, and warnings of grids that do not fit it."""

import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from comparisons import warnings_of
from nightly import nightly

import clradar
from clradar import AntennaArray, Capture, ClradarWarning, VoxelGrid, Wall, Waveform
from clradar.cli.options.measured import GridOptions
from clradar.imaging import echo_location, grid_check, placement
from clradar.imaging.object_box import MOST_VOXELS, PAPER_GRID
from clradar.imaging.placement import place_grid
from clradar.opencl import open_device

QAR50 = clradar.arrays.qar50()
ARRAY = AntennaArray(QAR50.tx_m[::6], QAR50.rx_m[::6])
"""16 x 16 of the imager's antennas."""

DENSE = AntennaArray(QAR50.tx_m[::3], QAR50.rx_m[::3])
"""32 x 32, where the side lobes of fewer would count."""

SWEEP = Waveform.sfcw(72e9, 82e9, 128)
HAND_BOX = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 4e-3)
AT_HAND, AT_WALL = [0.01, -0.02, 0.3], [0.1, 0.05, 1.5]
OUTSIDE, CUT, ALIAS = "strongest echo", "cuts the object off", "unambiguous range"


def echoes_of(
    *points_m: Any,
    amplitudes: Any = None,
    array: AntennaArray = ARRAY,
    waveform: Waveform = SWEEP,
    walls: Any = (),
) -> Capture:
    return clradar.room_capture(
        array, waveform, walls, points_m=list(points_m), point_amplitudes=amplitudes
    )


def object_of(centre_m: Any, size_m: Any, count: int = 20, array: AntennaArray = ARRAY) -> Capture:
    """Points of equal strength throughout a box, with those at its eight corners."""
    rng = np.random.default_rng(1)
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    places = np.vstack([corners, rng.uniform(-0.5, 0.5, (count, 3))]) * size_m + centre_m
    return echoes_of(*places, array=array)


def with_noise(capture: Capture, level: float) -> Capture:
    noise = np.random.default_rng(0).normal(size=(*capture.data.shape, 2)) @ [1.0, 1j]
    return replace(capture, data=capture.data + level * noise)


NOTHING = Capture(np.zeros((16, 16, 128)), ARRAY, SWEEP)


def box_of(grid: VoxelGrid) -> np.ndarray:
    return np.array([[axis[0], axis[-1]] for axis in (grid.x_m, grid.y_m, grid.z_m)])


imaged = partial(warnings_of, clradar.backproject)


def warned(capture: Capture, grid: VoxelGrid, **options: Any) -> list[str]:
    """What the image warns of, by the words that tell the warnings apart."""
    texts = imaged(capture, grid, **options)
    kinds = [next(kind for kind in (ALIAS, OUTSIDE, CUT) if kind in text) for text in texts]
    assert len(kinds) == len(texts)
    return kinds


@pytest.mark.parametrize(
    ("at_m", "array"),
    [
        ([0, 0, 0.15], ARRAY),
        *nightly([([0.8, 0.0, 1.0], ARRAY), ([0.3, 0.2, 1.5], DENSE), ([0.15, 0, 0.3], DENSE)]),
    ],
)
def test_the_grid_is_placed_around_an_echo_anywhere(at_m, array):
    capture = with_noise(echoes_of(at_m, array=array), 1.0)
    grid = place_grid(capture)
    low, high = box_of(grid).T
    # In the middle, within the rounding of the ends and a voxel of the coarse image.
    assert (np.abs((low + high) / 2 - at_m)[:2] < 0.02).all()
    assert (low < at_m).all()
    assert (np.array(at_m) < high).all()
    assert np.prod(grid.counts) <= MOST_VOXELS
    coarse = VoxelGrid.from_extent(*box_of(grid), (high - low) / 20)
    peak = np.abs(clradar.backproject(capture, coarse, method="range").data).max()
    assert peak > 0.1  # somewhere within a voxel that is much larger than the resolution


WALL = Wall([0, 0, 1.5], [0, 0, 1], 3.0)
OF_A_HAND = {
    "a hand": lambda: object_of([0, 0, 0.3], [0.16, 0.18, 0.03]),
    "a wall that is 10 dB stronger": lambda: echoes_of(AT_HAND, walls=[WALL]),
    "a stronger echo": lambda: echoes_of(AT_HAND, AT_WALL, amplitudes=[0.3, 1.0]),
    "much noise": lambda: with_noise(echoes_of(AT_HAND), 3.0),
    "coupling": lambda: clradar.impair(echoes_of(AT_HAND), coupling_db=30.0, seed=0),
    "nothing": lambda: NOTHING,
}


@pytest.mark.parametrize(
    "name", [*[*OF_A_HAND][2:], *nightly(["a hand", "a wall that is 10 dB stronger"])]
)
def test_the_hand_s_grid_is_that_of_the_paper_and_its_image_warns_of_nothing(name):
    capture = OF_A_HAND[name]()
    assert place_grid(capture) is PAPER_GRID
    assert warned(capture, HAND_BOX) == []


def test_where_no_echo_is_found_the_grid_is_that_of_the_paper_with_a_warning():
    noise = with_noise(NOTHING, 1.0)
    few = echoes_of([0, 0, 0.5], waveform=Waveform.sfcw(72e9, 82e9, 4))
    one = echoes_of([0, 0, 0.5], waveform=Waveform([77e9]))
    whys = ("no echo stands out", "4 frequencies are too few", "1 frequency is too few")
    for capture, why in zip((noise, few, one), whys, strict=True):
        with pytest.warns(ClradarWarning, match=why):
            assert place_grid(capture) is PAPER_GRID
    assert warned(noise, HAND_BOX) == []
    assert GridOptions().grid().same_voxels(PAPER_GRID, tolerance_m=0.0)


def line_m(length_m: float, count: int, axis: int) -> np.ndarray:
    places = np.zeros((count, 3))
    places[:, axis] = np.linspace(-length_m / 2, length_m / 2, count)
    return places


@pytest.mark.parametrize(
    ("side_m", "count", "sweep", "range_m", "slope"),
    [
        (0.094, 16, Waveform.sfcw(23e9, 26e9, 200), 7.0, 0.1),
        (0.025, 12, Waveform.sfcw(135e9, 145e9, 128), 0.3, 0.0),
        *nightly([(0.045, 12, Waveform.sfcw(76e9, 81e9, 256), 3.0, -0.2)]),
    ],
)
def test_grids_of_other_radars_hold_the_target_at_half_the_resolution(
    side_m, count, sweep, range_m, slope
):
    array = AntennaArray(line_m(side_m, count, 0), line_m(side_m, count, 1))
    at_m = range_m * np.array([slope, -slope / 2, 1]) / np.hypot(1, np.hypot(slope, slope / 2))
    capture = with_noise(clradar.room_capture(array, sweep, [], points_m=[at_m]), 0.1)
    grid = place_grid(capture)
    low, high = box_of(grid).T
    assert (low < at_m).all()
    assert (at_m < high).all()
    # lambda R / D of an aperture that only Tx or Rx have, and c / 2B.
    cells_m = np.array(
        [*[2.998e8 / sweep.center_hz * range_m / side_m] * 2, sweep.range_resolution_m]
    )
    assert (grid.spacing_m <= cells_m / 2).all()
    assert (high - low >= 2 * cells_m).all()


def test_bodies_apart_are_in_one_grid_or_named():
    places = [[0, 0, 1.0], [0.1, 0.1, 1.6], [-0.3, 0.0, 1.0]]  # two of one range
    weak = [0.1, -0.1, 1.3]  # -18 dB
    capture = echoes_of(*places, weak, amplitudes=[1.0, 1.0, 1.0, 0.12])
    found = placement.placement(capture, clradar.open_device())
    low, high = box_of(found.grid).T
    assert ((low < places) & (places < high)).all()
    assert (2 * found.grid.spacing_m <= [0.0139, 0.0139, 0.015]).all()
    assert [len(found.shown), len(found.left_out)] == [2, 1]
    two = echoes_of(AT_HAND, [0, 0, 0.8])
    found = placement.placement(two, clradar.open_device())
    assert found.grid is PAPER_GRID
    np.testing.assert_allclose([e.position_m for e in found.left_out], [[0, 0, 0.8]], atol=5e-3)
    assert "not in it: x 0, y 0, z 800 mm (" in placement.placement_words(two, found)
    low, high = box_of(place_grid(two, everything=True)).T
    assert low[2] < 0.3
    assert high[2] > 0.8


def test_an_array_on_a_line_gets_one_plane():
    array = AntennaArray(line_m(0.03, 4, 0), line_m(0.03, 8, 0))
    sweep = Waveform.sfcw(76e9, 77e9, 256)
    capture = clradar.room_capture(array, sweep, [], points_m=[[0.5, 0, 5.0]])
    grid = place_grid(capture)
    assert grid.counts[1] == 1
    assert grid.y_m[0] == 0
    low, high = box_of(grid).T
    assert (low <= [0.5, 0, 5.0]).all()
    assert (high >= [0.5, 0, 5.0]).all()


def test_neither_direct_coupling_nor_the_scale_of_samples_place_anything():
    coupled = clradar.impair(echoes_of([0, 0, 1.0]), coupling_db=40.0, seed=0)
    loud = replace(coupled, data=coupled.data * np.float32(1e25))
    low, high = box_of(place_grid(loud)).T
    assert 0.8 < low[2] < 1.0 < high[2]


def test_an_object_nearer_than_the_antennas_are_apart_is_no_coupling():
    z_m = 0.05
    size_m = np.array([0.08, 0.12, 0.01])
    near = object_of([0.01, -0.02, z_m], size_m)
    coupled = clradar.impair(near, coupling_db=20.0, coupling_delay_s=5e-12, seed=0)
    low, high = box_of(place_grid(coupled)).T
    assert (low <= np.array([0.01, -0.02, z_m]) - size_m / 2).all()
    assert (high >= np.array([0.01, -0.02, z_m]) + size_m / 2).all()
    assert high[2] < z_m + 0.1
    assert warned(near, HAND_BOX) == [OUTSIDE]


def test_what_cannot_be_told_from_coupling_is_said():
    # Longer by 2 cells c / span than the distances say, so that its removal leaves it.
    faults: dict[str, Any] = {"coupling_db": 40.0, "coupling_delay_s": 2e-10, "seed": 0}
    with pytest.warns(ClradarWarning, match=r"1\d\d mm, and may be direct coupling; give a grid"):
        place_grid(clradar.impair(with_noise(NOTHING, 1.0), **faults))
    assert place_grid(clradar.impair(echoes_of(AT_HAND), **faults)) is PAPER_GRID


def test_the_hand_s_grid_is_extended_to_what_it_would_cut():
    palm = object_of([0, 0, 0.31], [0.08, 0.18, 0.01], 10)
    thumb = echoes_of([0, -0.03, 0.25], amplitudes=[3.0])
    capture = Capture(palm.data + thumb.data, ARRAY, SWEEP)
    assert warned(capture, HAND_BOX) == [CUT]
    found = placement.placement(capture, clradar.open_device())
    grid = found.grid
    assert grid.spacing_m.tolist() == PAPER_GRID.spacing_m.tolist()
    assert grid.z_m[0] <= 0.24
    assert grid.z_m[-1] == pytest.approx(0.34)
    assert warned(capture, VoxelGrid.from_extent(*box_of(grid), 2e-3)) == []
    assert placement.placement_words(capture, found).startswith("that of a hand at 0.3 m, extended")


def test_an_ambiguous_echo_is_placed_where_it_focuses():
    few = Waveform.sfcw(72e9, 82e9, 16)  # repeats every 0.225 m
    low, high = box_of(place_grid(echoes_of([0, 0, 0.5], waveform=few))).T
    assert low[2] < 0.5 < high[2]
    assert place_grid(echoes_of(AT_HAND, waveform=few)) is PAPER_GRID


@pytest.mark.parametrize("at_m", [[0, 0, 1.5], [0, -0.2, 0.3]])
def test_an_echo_beside_the_grid_is_reported(at_m):
    (text,) = imaged(with_noise(echoes_of(at_m), 1.0), HAND_BOX, window="hann")
    assert OUTSIDE in text
    if at_m[2] == 1.5:
        assert re.search(r"strongest echo, at x -?0\.00\d, y -?0\.00\d, z 1\.500 m, ", text)
    assert " clradar.place_grid " in text


@pytest.mark.parametrize(
    ("extents", "side"),
    [
        (((0.02, 0.1), (-0.1, 0.1), (0.26, 0.34)), "x = 20 mm"),
        *nightly([(((-0.1, 0.1), (-0.1, 0.0), (0.26, 0.34)), "y = 0 mm")]),
    ],
)
def test_a_grid_that_cuts_the_object_is_reported(extents, side):
    capture = object_of([0, 0, 0.3], [0.08, 0.08, 0.005], array=DENSE)
    grid = VoxelGrid.from_extent(*extents, 2e-3)
    (text,) = imaged(capture, grid)
    assert f"cuts the object off at {side}: it goes on beyond" in text


SILENT = [
    ((-0.014, 0.034), (-0.044, 0.004), (0.28, 0.32)),  # a part of the grid around the object
    # A voxel, and less than the object's blur.
    *nightly([((0.01, 0.01), (-0.02, -0.02), (0.3, 0.3))]),
    *nightly([((0.006, 0.014), (-0.024, -0.016), (0.292, 0.308))]),
]


@pytest.mark.parametrize(("x_m", "y_m", "z_m"), SILENT)
def test_grids_and_slices_through_the_object_are_silent(x_m, y_m, z_m):
    grid = VoxelGrid.from_extent(x_m, y_m, z_m, 2e-3)
    assert warned(with_noise(echoes_of(AT_HAND), 1.0), grid, window="hann") == []


def test_slices_beside_the_brightest_point_are_silent_but_beside_the_object():
    large = object_of([0, 0, 0.3], [0.12, 0.16, 0.03])
    for capture, y_m, found in ((large, 0.06, []), (echoes_of(AT_HAND), 0.14, [OUTSIDE])):
        grid = VoxelGrid.from_extent((-0.1, 0.1), (y_m, y_m), (0.26, 0.34), 2e-3)
        assert warned(capture, grid) == found


@pytest.mark.parametrize("pose", nightly(["A", "S"]))
def test_a_rough_fist_is_found_where_it_is(pose):
    moved = np.eye(4) + np.outer([0.01, -0.04, 0.004, 0], [0, 0, 0, 1])
    fist = clradar.Scene.from_mesh(clradar.hand.hand_mesh(pose, 4e-3), material="palm")
    capture = clradar.simulate(fist.transformed(moved), DENSE, SWEEP, seed=0)
    assert place_grid(capture).y_m[0] > -0.15  # it reaches down to -0.11


def test_a_grid_beyond_the_unambiguous_range_is_reported():
    across = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (1.4, 2.1), 2e-2)
    (text,) = imaged(echoes_of([0, 0, 1.5]), across, method="range")
    assert re.search(r"to 2\.107 m, beyond .* \(2 df\) of 1\.904 m", text)
    beyond = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (2.0, 2.1), 1e-2)
    assert warned(echoes_of([0, 0, 0.3]), beyond) == [ALIAS, OUTSIDE]


def test_wavefronts_tell_aliases_apart_in_the_near_field_alone():
    few = Waveform.sfcw(72e9, 82e9, 16)  # repeats every 0.225 m
    assert warned(echoes_of(AT_HAND, waveform=few), HAND_BOX) == []
    far = VoxelGrid.from_extent((-0.2, 0.2), (-0.2, 0.2), (3.96, 4.04), 1e-2)
    assert warned(echoes_of([0, 0, 4.0], waveform=few), far) == [ALIAS]


@pytest.mark.parametrize(("aside", "reported"), [(0.7, []), (1.5, [OUTSIDE])])
def test_an_echo_is_outside_from_one_resolution_beside_the_grid_on(aside, reported):
    """Where the grid shows nothing of it; closer by it may be an echo on the face."""
    grid = VoxelGrid.from_extent((-0.05, 0.05), (-0.05, 0.05), (0.28, 0.32), 2e-3)
    edge_m = grid.x_m[-1] + 1e-3
    cell_m = echo_location.resolution_m(echoes_of(AT_HAND), np.array([edge_m, 0, 0.3]))[0]
    capture = echoes_of([edge_m + aside * cell_m, 0, 0.3])
    dark = np.zeros(grid.shape, np.complex64)
    dark[10, 25, 25] = 1e-6
    given = (capture, grid, dark, np.ones(128), open_device("pocl"))
    found = warnings_of(grid_check.warn_of_grid, *given)
    assert [OUTSIDE for text in found if OUTSIDE in text] == reported


@pytest.mark.parametrize(("band_hz", "fits"), [(3.7e9, False), (3.8e9, True)])
def test_the_paper_s_grid_fits_where_it_is_twice_as_long_as_the_resolution(band_hz, fits):
    """80 mm along z: c / 2B of 40 mm is that of 3.75 GHz."""
    sweep = Waveform.sfcw(77e9 - band_hz / 2, 77e9 + band_hz / 2, 16)
    assert placement.paper_grid_fits(echoes_of(AT_HAND, waveform=sweep)) == fits


def test_the_check_can_be_turned_off():
    assert warned(echoes_of([0, 0, 1.5]), HAND_BOX, check_grid=False) == []


@pytest.mark.parametrize("thickness_m", [0.0, 1e-17, 2e-6])
def test_a_box_whose_ends_differ_by_rounding_is_a_slice(thickness_m):
    at_m = np.array([1.3e-3, -1.7e-3, 0.3])  # 0.46 and 0.4 voxels beside the nearest one
    low_m = np.array([-0.02, -0.02, 0.3])
    high_m = low_m + np.array([0.04, 0.04, thickness_m])
    found = echo_location.coarse_image(echoes_of(at_m), low_m, high_m, clradar.open_device())
    assert found.grid.counts[2] == 1
    assert np.linalg.norm(found.brightest().position_m - at_m) < 0.1 * found.grid.spacing_m[0]
