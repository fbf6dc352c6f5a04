"""What lies beside frames: alignment.json, cached pictures in the antenna frame."""

import json

import maroon_files as files
import numpy as np
import pytest
from comparisons import refusal

from clradar.errors import MeasurementError
from measurement_io import read_alignment, read_depth_map

EXACT = {"rtol": 1e-12, "atol": 1e-12}
"""A product or inverse of two 4 x 4 matrices, some 20 roundings of 1e-16, times their condition
(metres against millimetres: 1e3)."""

PHOTO = files.rigid((10, 170, 35), (0.02, -0.03, 0.4))
KINECT = files.rigid((3, -8, 1), (0.1, 0.05, -0.02)) @ np.diag([1e-3, 1e-3, 1e-3, 1.0])
ZED = files.rigid((-5, 4, 90), (-0.2, 0.0, 0.01)) @ np.diag([1e-3, 1e-3, 1e-3, 1.0])
GIVEN = {"photogrammetry2radar": PHOTO, "kinect2radar": KINECT, "zed2radar": ZED}


def test_given_transforms_keep_every_bit(tmp_path):
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN))
    for key, matrix in GIVEN.items():
        assert np.array_equal(alignment.transform(*key.split("2")), matrix)
    assert np.array_equal(alignment.transform("zed", "zed"), np.eye(4))
    multiplied = files.write_alignment(tmp_path, {"zed2radar": changed(3, 0, 1e-10)})
    np.testing.assert_array_equal(read_alignment(multiplied).transform("zed", "radar"), PHOTO)


def test_missing_ones_go_through_the_radar(tmp_path):
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN))
    point = np.array([120.0, -80.0, 900.0, 1.0])  # kinect, millimetres
    there = alignment.transform("kinect", "photogrammetry") @ point
    in_radar = KINECT @ point
    # Solved for, not inverted: the photogrammetric point whose place in radar space is that.
    np.testing.assert_allclose(there, np.linalg.solve(PHOTO, in_radar), **EXACT)
    back = alignment.transform("radar", "kinect") @ in_radar
    np.testing.assert_allclose(back, point, rtol=1e-12, atol=1e-9)
    wide = alignment.transform("kinect", "zed") @ point
    np.testing.assert_allclose(ZED @ wide, in_radar, **EXACT)


def test_the_antenna_frame_is_the_radar_space_mirrored_in_x(tmp_path):
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN))
    point = np.array([0.01, 0.02, 0.03, 1.0])
    x, y, z, _ = PHOTO @ point
    np.testing.assert_array_equal(alignment.to_antenna("photogrammetry") @ point, [-x, y, z, 1.0])
    np.testing.assert_array_equal(alignment.to_antenna("radar"), np.diag([-1.0, 1, 1, 1]))


def test_transforms_may_be_given_by_their_inverse(tmp_path):
    inverted = {"radar2photogrammetry": np.linalg.inv(PHOTO), "radar2kinect": np.linalg.inv(KINECT)}
    path = files.write_alignment(tmp_path, inverted | {"zed2realsense": np.eye(4)})
    alignment = read_alignment(path)
    np.testing.assert_allclose(alignment.transform("photogrammetry", "radar"), PHOTO, **EXACT)
    wanted = np.linalg.solve(PHOTO, KINECT)
    np.testing.assert_allclose(alignment.transform("kinect", "photogrammetry"), wanted, **EXACT)
    assert np.array_equal(alignment.transform("realsense", "zed"), np.eye(4))
    with pytest.raises(MeasurementError, match=r"from 'zed' to 'radar'.*zed2realsense"):
        alignment.transform("zed", "radar")


def changed(row, column, value):
    matrix: list[list[object]] = PHOTO.tolist()
    matrix[row][column] = value
    return matrix


@pytest.mark.parametrize(
    ("value", "found"),
    [
        (PHOTO[:3], "four rows of four numbers"),
        (changed(1, 1, "0.5"), 'got "0.5"'),
        (changed(1, 1, float("nan")), "NaN"),
        (changed(3, 0, 0.01), "last row"),
        (np.diag([1.0, 1.0, 0.0, 1.0]), "singular"),
    ],
)
def test_bad_matrices(tmp_path, value, found):
    path = files.write_alignment(tmp_path, GIVEN | {"photogrammetry2radar": value})
    message = refusal(read_alignment, path)
    assert "photogrammetry2radar" in message
    assert found in message


TARGETS = [(0.092, 0.024, 0.30, 900.0), (-0.06, -0.054, 0.28, 600.0), (0.02, 0.037, 0.32, 400.0)]
"""x, y, z of radar space on voxels of the scene, and amplitude: no two share |x|, |y| or z."""

EXACT_M = 1e-12
"""Axes are a few float64 operations on numbers below 1 m."""

HALF_MM_M = 0.5e-3 + EXACT_M
"""Rounding to whole millimetres."""

N_FREQ = 2


@pytest.fixture(scope="module")
def scene():
    return files.scene(TARGETS)


@pytest.fixture
def radar(tmp_path, scene):
    folder = tmp_path / "30" / f"radar_72.0_82.0_{N_FREQ}"
    files.write_products(folder, 0, scene)
    return folder


def change_entry(radar, change):
    content = json.loads((radar / "calibration.json").read_text())
    change(content["000000"])
    (radar / "calibration.json").write_text(json.dumps(content))


def nearest(axis, value):
    return int(np.abs(axis - value).argmin())


# ---- where things land


def test_depth_map_lands_in_the_antenna_frame(radar, scene):
    depth = read_depth_map(radar, 0)
    np.testing.assert_allclose(depth.x_m, -scene.x_m[::-1], rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(depth.y_m, scene.y_m, rtol=0, atol=EXACT_M)
    for x, y, z, strength in TARGETS:
        i, j = nearest(depth.y_m, y), nearest(depth.x_m, -x)
        assert abs(depth.depth_m[i, j] - z) <= HALF_MM_M
        assert depth.amplitude[i, j] == int(strength + 2)  # the floor of the scene; cut off
        # Every mirror image of a target is empty.
        for dx, dy in ((x, y), (-x, -y), (x, -y)):
            assert np.isnan(depth.depth_m[nearest(depth.y_m, dy), nearest(depth.x_m, dx)])
    _, expected = scene.strongest()
    np.testing.assert_allclose(depth.depth_m, expected[::-1].T, rtol=0, atol=HALF_MM_M)
    assert depth.dynamic_range_db == files.DEPTH_CUT_DB


def test_older_depth_maps_are_rotated_in_memory(radar, scene):
    expected = read_depth_map(radar, 0)
    path = radar / "depth" / "000000.png"
    path.write_bytes(files.png(files.png_pixels(path.read_bytes())[::-1]))
    assert not np.array_equal(read_depth_map(radar, 0).depth_m, expected.depth_m, equal_nan=True)

    def older(entry):
        entry["depth"] = {"transform": np.eye(4).tolist()}

    before = path.read_bytes()
    change_entry(radar, older)
    turned = read_depth_map(radar, 0)
    assert np.array_equal(turned.depth_m, expected.depth_m, equal_nan=True)
    assert np.array_equal(turned.amplitude, expected.amplitude)  # maxproj is not turned
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("threshold", "expected"), [(14, 14.0), (-14, 14.0), (-0.5, 0.5), (0, 15.0), (None, 15.0)]
)
def test_threshold_of_a_depth_map(radar, threshold, expected):
    amplitude = {"amplitude_filter_kernel_size": 1, "amplitude_filter_threshold_dB": threshold}
    change_entry(radar, lambda entry: entry.update(amplitude=amplitude))
    assert read_depth_map(radar, 0).dynamic_range_db == expected


@pytest.mark.parametrize("where", ["depth box", "depth box in 3-D", "intrinsics", "its inverse"])
def test_pixels_are_placed_by_what_there_is(radar, where):
    expected = read_depth_map(radar, 0)

    def change(entry):
        box = {k: v for k, v in entry.pop("volume").items() if "amp" not in k and "abs" not in k}
        if where == "depth box":
            entry["depth"] = {k: v[:2] for k, v in box.items()}
        elif where == "depth box in 3-D":
            entry["depth"] = box
        elif where == "its inverse":
            entry["depth"]["intrinsics"] = np.linalg.inv(entry["depth"]["intrinsics"]).tolist()

    change_entry(radar, change)
    depth = read_depth_map(radar, 0)
    assert np.array_equal(depth.depth_m, expected.depth_m, equal_nan=True)
    np.testing.assert_allclose(depth.x_m, expected.x_m, rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(depth.y_m, expected.y_m, rtol=0, atol=EXACT_M)


# ---- what is missing or contradicts itself


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("bb_min", [0, 0], "as many numbers as"),
        ("bb_min", [0, 0, 1e9], "bb_min: expected metres, at most"),
        ("bb_min", [0, 0, True], "bb_min[2]: expected a valid number, got true"),
        ("grid_size", [31, 21, 9.5], "whole numbers"),
        ("grid_size", [1, 21, 9], "one point"),
        ("grid_size", [21, 31, 9], "31 rows of 21 pixels"),
    ],
)
def test_invalid_entries(radar, key, value, found):
    change_entry(radar, lambda entry: entry["volume"].update({key: value}))
    assert found in refusal(read_depth_map, radar, 0)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(4).tolist(),
        [[1, 2]] * 4,
        "no matrix",
    ],
)
def test_matrices_that_place_no_pixels(radar, matrix):
    def change(entry):
        del entry["volume"]
        entry["depth"]["intrinsics"] = np.asarray(matrix).tolist()

    change_entry(radar, change)
    assert "intrinsics" in refusal(read_depth_map, radar, 0)
