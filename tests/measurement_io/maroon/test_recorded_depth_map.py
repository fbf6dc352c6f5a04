"""Cached products: where each pixel lands, in both directions, and what damaged files end in."""

import json

import maroon_products as made
import numpy as np
import pytest
from comparisons import refusal

from measurement_io import read_depth_map

TARGETS = [(0.092, 0.024, 0.30, 900.0), (-0.06, -0.054, 0.28, 600.0), (0.02, 0.037, 0.32, 400.0)]
"""x, y, z of radar space on voxels of the scene, and amplitude: no two share |x|, |y| or z."""

EXACT_M = 1e-12
"""Axes are a few float64 operations on numbers below 1 m."""

HALF_MM_M = 0.5e-3 + EXACT_M
"""Rounding to whole millimetres."""

N_FREQ = 2


@pytest.fixture(scope="module")
def scene():
    return made.scene(TARGETS)


@pytest.fixture
def radar(tmp_path, scene):
    folder = tmp_path / "30" / f"radar_72.0_82.0_{N_FREQ}"
    made.write_products(folder, 0, scene)
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
    assert depth.dynamic_range_db == made.DEPTH_CUT_DB


def test_older_depth_maps_are_rotated_in_memory(radar, scene):
    expected = read_depth_map(radar, 0)
    path = radar / "depth" / "000000.png"
    path.write_bytes(made.png(made.png_pixels(path.read_bytes())[::-1]))
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
        ("bb_min", [0, 0, True], "bb_min[2]: expected a finite number, got true"),
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
        np.diag([1, -1, 1000, 1]) + np.eye(4)[::-1],
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
