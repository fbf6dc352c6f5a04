"""alignment.json and metadata.json: what is read, what is refused, what contradicts itself."""

from __future__ import annotations

import json
from pathlib import Path

import maroon_files as files
import numpy as np
import pytest

from clradar.errors import MeasurementError, ModelError
from measurement_io import (
    MaskBox,
    RecordingMetadata,
    SensorAlignment,
    read_alignment,
    read_metadata,
)

EXACT = 1e-12
"""Relative: a product or inverse of two 4 x 4 matrices, some 20 roundings of 1e-16, times their
condition (metres against millimetres: 1e3)."""

PHOTO = files.rigid((10, 170, 35), (0.02, -0.03, 0.4))
KINECT = files.rigid((3, -8, 1), (0.1, 0.05, -0.02)) @ np.diag([1e-3, 1e-3, 1e-3, 1.0])
ZED = files.rigid((-5, 4, 90), (-0.2, 0.0, 0.01)) @ np.diag([1e-3, 1e-3, 1e-3, 1.0])
GIVEN = {"photogrammetry2radar": PHOTO, "kinect2radar": KINECT, "zed2radar": ZED}


def refused(path: Path, read=read_alignment) -> str:
    with pytest.raises(MeasurementError) as caught:
        read(path)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    return message


def test_given_transforms_keep_every_bit(tmp_path):
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN))
    assert alignment.sensors == ("kinect", "photogrammetry", "radar", "zed")
    for key, matrix in GIVEN.items():
        assert np.array_equal(alignment.transform(*key.split("2")), matrix)
    assert alignment.problems() == []
    assert alignment.unknown_keys == ()
    assert np.array_equal(alignment.transform("zed", "zed"), np.eye(4))


def test_missing_ones_go_through_the_radar(tmp_path):
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN))
    point = np.array([120.0, -80.0, 900.0, 1.0])  # kinect, millimetres
    there = alignment.transform("kinect", "photogrammetry") @ point
    in_radar = KINECT @ point
    # Solved for, not inverted: the photogrammetric point whose place in radar space is that.
    np.testing.assert_allclose(there, np.linalg.solve(PHOTO, in_radar), rtol=EXACT, atol=EXACT)
    back = alignment.transform("radar", "kinect") @ in_radar
    np.testing.assert_allclose(back, point, rtol=EXACT, atol=EXACT * 1e3)
    wide = alignment.transform("kinect", "zed") @ point
    np.testing.assert_allclose(ZED @ wide, in_radar, rtol=EXACT, atol=EXACT)


def test_the_antenna_frame_is_the_radar_space_mirrored_in_x(tmp_path):
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN))
    point = np.array([0.01, 0.02, 0.03, 1.0])
    x, y, z, _ = PHOTO @ point
    np.testing.assert_array_equal(alignment.to_antenna("photogrammetry") @ point, [-x, y, z, 1.0])
    np.testing.assert_array_equal(alignment.to_antenna("radar"), np.diag([-1.0, 1, 1, 1]))
    assert np.linalg.det(alignment.to_antenna("photogrammetry")) < 0


def test_transforms_may_be_given_by_their_inverse(tmp_path):
    inverted = {
        "radar2photogrammetry": np.linalg.inv(PHOTO),
        "radar2kinect": np.linalg.inv(KINECT),
        "zed2realsense": np.eye(4),
    }
    alignment = read_alignment(files.write_alignment(tmp_path, inverted))
    np.testing.assert_allclose(
        alignment.transform("photogrammetry", "radar"), PHOTO, rtol=EXACT, atol=EXACT
    )
    np.testing.assert_allclose(
        alignment.transform("kinect", "photogrammetry"),
        np.linalg.solve(PHOTO, KINECT),
        rtol=EXACT,
        atol=EXACT,
    )
    assert np.array_equal(alignment.transform("realsense", "zed"), np.eye(4))
    with pytest.raises(MeasurementError, match=r"from 'zed' to 'radar'.*zed2realsense"):
        alignment.transform("zed", "radar")
    with pytest.raises(ModelError, match="source"):
        alignment.transform(3, "radar")  # type: ignore[arg-type]


def test_a_given_transform_is_used_even_if_it_contradicts(tmp_path):
    shift_mm = 5.0
    off = np.linalg.inv(ZED) @ KINECT
    off[0, 3] += shift_mm
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN | {"kinect2zed": off}))
    assert np.array_equal(alignment.transform("kinect", "zed"), off)
    (problem,) = alignment.problems()
    assert "kinect2zed" in problem
    assert f"{shift_mm:g} mm" in problem  # 5 mm in the sensor's frame are 5 mm in the radar's


def test_a_contradicting_inverse_is_named_with_its_size(tmp_path):
    back = np.linalg.inv(PHOTO)
    back[1, 3] += 0.002
    more = {"radar2photogrammetry": back, "zed2zed": np.diag([1.0, 1.0, 1.1, 1.0])}
    problems = read_alignment(files.write_alignment(tmp_path, GIVEN | more)).problems()
    assert len(problems) == 2
    assert "photogrammetry2radar and radar2photogrammetry differ, by up to 2 mm" in problems[0]
    assert "zed2zed" in problems[1]


def test_rounded_matrices_do_not_contradict_themselves(tmp_path):
    more = {"radar2photogrammetry": np.round(np.linalg.inv(PHOTO), 5)}
    assert read_alignment(files.write_alignment(tmp_path, GIVEN | more)).problems() == []


def test_unknown_keys_are_listed(tmp_path):
    more = {"date": "2024-12-02", "note2": 1, "2radar": 5, "a2b2c": [1], "kinect2zed": None}
    alignment = read_alignment(files.write_alignment(tmp_path, GIVEN | more))
    assert alignment.unknown_keys == tuple(more)
    assert len(alignment.given) == len(GIVEN)


def test_names_with_a_2(tmp_path):
    alignment = read_alignment(
        files.write_alignment(tmp_path, {"cam2b2radar": KINECT, "radar2cam2a": np.linalg.inv(ZED)})
    )
    assert alignment.sensors == ("cam2a", "cam2b", "radar")


def changed(row: int, column: int, value: object) -> list[list[object]]:
    matrix: list[list[object]] = PHOTO.tolist()
    matrix[row][column] = value
    return matrix


@pytest.mark.parametrize(
    ("value", "found"),
    [
        (PHOTO.ravel().tolist(), "rows of numbers"),
        (PHOTO[:3], "shape (3, 4)"),
        (PHOTO[:, :3], "shape (4, 3)"),
        (5, "int"),
        ("identity", "str"),
        ([1, 2, 3, 4], "rows of numbers"),
        (changed(1, 1, "0.5"), 'got "0.5"'),
        (changed(1, 1, True), "True"),
        (changed(1, 1, None), "None"),
        (changed(1, 1, float("nan")), "NaN"),
        (changed(0, 3, float("inf")), "got inf"),
        (changed(0, 3, 10**400), "a huge number"),
        (changed(3, 0, 0.01), "last row"),
        (changed(3, 3, 0.999), "last row"),
        (PHOTO.T, "last row"),
        (np.diag([1.0, 1.0, 0.0, 1.0]), "singular"),
    ],
)
def test_bad_matrices(tmp_path, value, found):
    path = files.write_alignment(tmp_path, GIVEN | {"photogrammetry2radar": value})
    message = refused(path)
    assert "photogrammetry2radar" in message
    assert found in message


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"{", b"\xff\xfe", b'{"a": 1, "a": 2}', b'{"a": ' * 100 + b"1" + b"}" * 100],
)
@pytest.mark.parametrize("read", [read_alignment, read_metadata])
def test_bad_files(tmp_path, content, read):
    path = tmp_path / "alignment.json"
    path.write_bytes(content)
    refused(path, read)
    refused(tmp_path / "nothing.json", read)


def test_a_record_made_by_hand_is_checked_too():
    with pytest.raises(ModelError, match="a2b"):
        SensorAlignment("mine", {("a", "b"): np.zeros((4, 4))})


# ---- metadata


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
    assert metadata == RecordingMetadata(
        "20240101_c",
        "20240101_f",
        0.3,
        5,
        ("hand", "left"),
        MaskBox(-0.1, 0.04, -0.2, None, 0.6, 0.2),
        "empty_30",
        {"operator": {"name": "x"}},
    )
    assert metadata.mask_bb_antenna == MaskBox(-0.04, 0.1, -0.2, None, 0.6, 0.2)
    assert metadata.mask_bb_antenna.reversed_axes == ("z",)


def test_empty_metadata(tmp_path):
    metadata = read_metadata(files.write_json(tmp_path / "metadata.json", {}))
    assert metadata == RecordingMetadata()
    assert metadata.mask_bb_antenna is None
    assert metadata.distance_problem("30") is None


def test_unknown_keys_of_the_box_are_kept(tmp_path):
    content = {"mask_bb": {"xmin": 1, "xMax": 2}}
    metadata = read_metadata(files.write_json(tmp_path / "metadata.json", content))
    assert metadata.mask_bb == MaskBox(x_min_m=1.0)
    assert metadata.mask_bb_antenna == MaskBox(x_max_m=-1.0)
    assert metadata.other == {"mask_bb": {"xMax": 2}}


def test_the_box_holds_the_points_between_its_bounds():
    box = MaskBox(-0.1, 0.04, -0.2, None, 0.6, 0.2)
    points = np.array([[0, 0, 0.3], [0.05, 0, 0.3], [0, 9, 0.3], [0, -1, 0.3], [0, 0, 0.7]])
    assert box.contains(points).tolist() == [True, False, True, False, False]
    mirrored = box.mirrored().contains(points * [-1, 1, 1])
    assert mirrored.tolist() == box.contains(points).tolist()
    assert box.mirrored().mirrored() == box


@pytest.mark.parametrize(
    ("metres", "name", "contradicts"),
    [
        (0.3, "30", False),
        (0.31, "30", False),
        (0.4, "30", True),
        (0.3, "50", True),
        (300.0, "30", True),
        (0.4, "object", False),
    ],
)
def test_distance_against_the_name_of_the_folder(metres, name, contradicts):
    problem = RecordingMetadata(distance_meters=metres).distance_problem(name)
    assert (problem is not None) == contradicts
    if problem is not None:
        assert f"{metres:g} m" in problem
        assert f"{name} cm" in problem


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"distance_meters": "0.3"}, 'got "0.3"'),
        ({"distance_meters": -0.3}, "-0.3"),
        ({"distance_meters": True}, "True"),
        ({"distance_meters": float("nan")}, "nan"),
        ({"mask_bb": [1, 2]}, "list"),
        ({"mask_bb": {"xmin": "left"}}, "mask_bb.xmin"),
        ({"mask_bb": {"zmax": float("inf")}}, "mask_bb.zmax"),
        ({"empty_measurement": 7}, "empty_measurement"),
    ],
)
def test_bad_metadata(tmp_path, change, found):
    path = tmp_path / "metadata.json"
    path.write_text(json.dumps(FULL | change))
    assert found in refused(path, read_metadata)
