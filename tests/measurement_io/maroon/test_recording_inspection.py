"""`describe` and `check_file` of a recording: content, missing parts, contradictions."""

import json

import maroon_files as files
import numpy as np
import pytest

from measurement_io import check_file, describe

PHOTO = files.rigid((4, 172, 20), (0.01, 0.0, 0.3))
KINECT = files.rigid((0, 5, 0), (0.1, 0.0, 0.0)) @ np.diag([1e-3, 1e-3, 1e-3, 1.0])
BOX = {"xmin": -0.06, "xmax": 0.08, "ymin": -0.07, "ymax": 0.07, "zmin": 0.25, "zmax": 0.35}
PLATE = (
    np.array([[-0.03, -0.02, 0.0], [0.03, -0.02, 0.0], [0.03, 0.02, 0.0], [-0.03, 0.02, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
MESHES = ("mesh", "mesh_masked", "mesh_masked_smoothed", "mesh_smoothed", "mesh_synthetic")


def whole_recording(distance, n_frames=3):
    """Write a recording in which everything is there and agrees; return its radar folder."""
    radar = files.write_recording(distance, n_frames)
    for i in range(n_frames):
        files.write_products(radar, i, files.scene([(0.02, 0.0, 0.3, 1000.0)], (7, 6, 5)))
    files.write_json(
        distance / "metadata.json",
        {"distance_meters": 0.3, "labels": ["plate"], "mask_bb": BOX, "empty_measurement": "e"},
    )
    files.write_alignment(distance, {"photogrammetry2radar": PHOTO, "kinect2radar": KINECT})
    for name in MESHES:
        files.write_mesh(distance, name, *PLATE)
    return radar


def test_a_whole_recording(tmp_path):
    radar = whole_recording(tmp_path / "plate" / "30")
    description = describe(radar.parent)
    assert description.problems == ()
    assert description.missing == ()
    values = json.loads(json.dumps(description.to_dict(), allow_nan=False))["facts"]
    assert values["raw_frames"] == {"count": 3, "numbers": [0, 1, 2]}
    assert values["emptyfiltered_frames"]["count"] == 3
    for name in ("depth", "maxproj", "volume", "xyz"):
        assert values[f"cached_{name}"]["numbers"] == [0, 1, 2]
    assert values["calibration.json"]["frames"] == [0, 1, 2]
    assert values["metadata.json"]["mask_bb"] == BOX
    transforms = values["alignment.json"]["transforms"]
    assert np.array_equal(transforms["photogrammetry2radar"], PHOTO)
    assert values["meshes"] == list(MESHES)
    assert values["frequencies"] == {"count": 2, "low_hz": 72e9, "high_hz": 82e9}
    assert values["provenance"]["number_of_measurements"] == 3
    assert "kinect2radar: scale 0.001 x 0.001 x 0.001" in str(description)
    report = check_file(radar.parent)
    assert report.ok, report.problems
    assert "time stamps of raw frames ascend, 125 ms apart" in str(report)
    assert "3 of 3 cached depth read" in str(report)


def test_a_bare_recording_lists_what_is_missing(tmp_path):
    radar = files.write_recording(tmp_path / "30", n_frames=2)
    (radar / "calibrated_data" / "000001_emptyfiltered.npy").unlink()
    (radar / "calibrated_data" / "mean.npy").write_bytes(b"")
    description = describe(radar)
    assert description.problems == ()
    missing = "; ".join(description.missing)
    for part in (
        *("emptyfiltered of the frames 1", "depth", "maxproj", "volume", "xyz"),
        *("metadata.json", "alignment.json", "photogrammetry/*.obj"),
    ):
        assert part in missing
    assert f"missing: {missing}" in str(description)
    assert description.words["metadata.json"] == "none"
    assert description.values["metadata.json"] is None
    assert description.values["ignored_in_calibrated_data"] == ["mean.npy"]
    assert check_file(radar).ok


@pytest.mark.parametrize(
    ("number", "changes", "problem"),
    [
        (0, {"number_of_measurements": 9}, "frame 0 names 9 frames for the recording, 4"),
        (3, {"xr": np.zeros((96, 96, 2), "c8")}, "raw frames that are zero everywhere: 3"),
    ],
)
def test_odd_frames(tmp_path, number, changes, problem):
    radar = files.write_recording(tmp_path / "30", n_frames=4)
    stamp = np.array([FIRST + number * STEP])
    frame = files.random_frame() | {"number_of_measurements": 4, "timestamp_us": stamp} | changes
    files.write_frame(radar / "calibrated_data" / f"{number:06d}.npy", frame)
    (found,) = check_file(radar).problems
    assert problem in found


def edit(path, **changes):
    files.write_json(path, json.loads(path.read_text()) | changes)


CONTRADICTIONS = {
    "gap": (
        lambda radar: (radar / "calibrated_data" / "000001.npy").unlink(),
        ["without a gap: 0, 2", "emptyfiltered frames without a raw frame: 1", " 3 "],
    ),
    "no frames": (
        lambda radar: [p.unlink() for p in (radar / "calibrated_data").iterdir()],
        ["no frame in calibrated_data"],
    ),
    "distance": (
        lambda radar: edit(radar.parent / "metadata.json", distance_meters=0.5),
        ["metadata.json has a distance of 0.5 m, the folder's name 30 cm"],
    ),
    "metadata": (
        lambda radar: edit(radar.parent / "metadata.json", distance_meters="near"),
        ["metadata.json has a distance of near m"],
    ),
    "alignment": (
        lambda radar: edit(radar.parent / "alignment.json", kinect2radar=[[1]]),
        ["alignment.json: kinect2radar: expected four rows"],
    ),
    "no placement": (
        lambda radar: files.write_alignment(radar.parent, {"kinect2radar": KINECT}),
        ["a transform from 'photogrammetry' to 'radar'"],
    ),
    "calibration": (
        lambda radar: edit(radar / "calibration.json", frequency_points=128),
        ["calibration.json has 72.0 to 82.0 GHz in 128 points"],
    ),
    "entries": (
        lambda radar: edit(radar / "calibration.json", **{"000007": {}}),
        ["calibration.json names frames that are not there: 7"],
    ),
    "products": (
        lambda radar: (radar / "depth" / "000002.png").rename(radar / "depth" / "000009.png"),
        [
            "depth without a raw frame: 9",
            "calibration.json lacks its pixels for depth of the frames 9",
        ],
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_contradictions(tmp_path, name):
    radar = whole_recording(tmp_path / "30")
    change, parts = CONTRADICTIONS[name]
    change(radar)
    description = describe(radar.parent)
    for problems in (description.problems, check_file(radar.parent).problems):
        for part in parts:
            assert any(part in problem for problem in problems), problems
    assert "\n" not in "".join(description.problems)
    json.dumps(description.to_dict(), allow_nan=False)


def restamp(radar, number, stamp, variant=""):
    frame = files.random_frame(seed=number) | {"number_of_measurements": 6, "timestamp_us": [stamp]}
    if stamp is None:
        del frame["timestamp_us"]
    files.write_frame(radar / "calibrated_data" / f"{number:06d}{variant}.npy", frame)


FIRST, STEP = 1_700_000_000_000_123, files.FRAME_INTERVAL_US


@pytest.mark.parametrize(
    ("number", "stamp", "found"),
    [
        (3, FIRST + 2 * STEP, "not after that of the frame before: 3"),
        (5, FIRST + 6 * STEP, "come late, where 125 ms are usual: 5"),
        (3, None, "1 of 6 raw frames have no time stamp"),
        (3, FIRST + 3 * STEP + 1, "another time stamp than the raw one: 3"),
    ],
)
def test_time_stamps(tmp_path, number, stamp, found):
    radar = files.write_recording(tmp_path / "30", n_frames=6)
    assert check_file(radar).ok
    restamp(radar, number, stamp)
    assert describe(radar).problems == ()  # which does not read them
    assert any(found in problem for problem in check_file(radar).problems)


def test_every_depth_map_is_read(tmp_path):
    radar = whole_recording(tmp_path / "30")
    path = radar / "depth" / "000001.png"
    path.write_bytes(path.read_bytes()[:-5])
    assert describe(radar).problems == ()
    report = check_file(radar)
    assert len(report.problems) == 1
    assert "000001.png" in report.problems[0]
    assert "2 of 3 cached depth read" in report.checked


def test_numbers_that_are_not_finite_are_strict_json(tmp_path):
    radar = files.write_recording(tmp_path / "30")
    files.write_json(radar.parent / "metadata.json", {"note": [float("nan"), {"a": 1e400}]})
    text = json.dumps(describe(radar).to_dict(), allow_nan=False)
    assert '"note": ["nan", {"a": "inf"}]' in text
