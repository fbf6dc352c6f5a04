"""alignment.json and metadata.json: what is read, what is refused, what contradicts itself."""

import maroon_files as files
import numpy as np
import pytest
from comparisons import refusal

from clradar.errors import MeasurementError
from measurement_io import MaskBox, RecordingMetadata, read_alignment, read_metadata

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
    assert alignment.unknown_keys == ()
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
        (PHOTO[:3], "shape (3, 4)"),
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


FULL = {
    "calibration": "20240101_c",
    "calibration_fine": "20240101_f",
    "distance_meters": 0.3,
    "mask_erosion": 5,
    "labels": ["hand", "left"],
    "mask_bb": {"xmin": -0.1, "xmax": 0.04, "ymin": -0.2, "zmin": 0.6, "zmax": 0.2},
    "empty_measurement": "empty_30",
    "operator": {"name": "x"},
}


def test_metadata(tmp_path):
    metadata = read_metadata(files.write_json(tmp_path / "metadata.json", FULL))
    assert (metadata.distance_meters, metadata.labels) == (0.3, ["hand", "left"])
    box = MaskBox(x_min_m=-0.1, x_max_m=0.04, y_min_m=-0.2, z_min_m=0.6, z_max_m=0.2)
    assert metadata.mask_bb == box
    assert metadata.model_extra == {"operator": {"name": "x"}}
    mirrored = MaskBox(x_min_m=-0.04, x_max_m=0.1, y_min_m=-0.2, z_min_m=0.6, z_max_m=0.2)
    assert metadata.mask_bb_antenna == mirrored
    assert metadata.distance_problem("30") is None
    assert "0.3 m, the folder's name 40 cm" in metadata.distance_problem("40")
    empty = read_metadata(files.write_json(tmp_path / "metadata.json", {}))
    assert empty == RecordingMetadata()
    assert (empty.mask_bb_antenna, empty.distance_problem("30")) == (None, None)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"distance_meters": "0.3"}, 'got "0.3"'),
        ({"distance_meters": -0.3}, "-0.3"),
        ({"mask_bb": [1, 2]}, "list"),
        ({"mask_bb": {"xmin": "left"}}, "mask_bb.xmin"),
        ({"empty_measurement": 7}, "empty_measurement"),
    ],
)
def test_bad_metadata(tmp_path, change, found):
    path = files.write_json(tmp_path / "metadata.json", FULL | change)
    assert found in refusal(read_metadata, path)
