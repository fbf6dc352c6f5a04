"""Records of another kind, and single ones in place of several: the error names the argument."""

import numpy as np
import pytest

import calibration
import clradar
from clradar import hand, plot, report
from clradar.errors import ClradarError

ARRAY = clradar.AntennaArray(np.zeros((1, 3)), np.ones((1, 3)))
BAND = clradar.Waveform([76e9, 77e9])
GRID = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (2, 2, 2))
CAPTURE = clradar.Capture(np.ones((1, 1, 2)), ARRAY, BAND)
VOLUME = clradar.Volume(np.ones(GRID.shape), GRID)
SCENE = clradar.Scene(np.eye(3) + 0.3, [[0, 1, 2]])
PLATE = calibration.FlatPlate(0.3)

CALLS = {
    "simulate: scene: expected a Scene": lambda: clradar.simulate("a.ply", ARRAY, BAND),
    "trace: array: expected an AntennaArray": lambda: clradar.trace(SCENE, BAND),
    "spread: scene": lambda: clradar.spread("a.ply", ARRAY, BAND, GRID),
    "draw_channels: dead_tx": lambda: clradar.draw_channels(ARRAY, BAND, dead_tx=3),
    "room_capture: walls": lambda: clradar.room_capture(ARRAY, BAND, 3),
    "MovingScene.bodies": lambda: clradar.MovingScene(SCENE),
    "MovingHand.poses": lambda: clradar.MovingHand([0.0], 3),
    "time_s": lambda: clradar.RigidMotion([0.0], [(0, 0, 0)]).at(float("nan")),
    "time_s: expected a finite": lambda: clradar.MovingHand([0.0], "F").pose(float("nan")),
    "response: target: expected a FlatPlate or Sphere or CornerReflector": (
        lambda: calibration.response(0.3, ARRAY, BAND)
    ),
    "response: array": lambda: calibration.response(PLATE, BAND, ARRAY),
    "response: waveform": lambda: calibration.response(PLATE, ARRAY, 77e9),
    "register: mesh": lambda: calibration.register(VOLUME, "a.ply"),
    "average_frames: captures": lambda: calibration.average_frames(CAPTURE),
    "random_pose: rng": lambda: hand.random_pose(0),
    "random_shape: rng": lambda: hand.random_shape(0),
    "pose_around: rng": lambda: hand.pose_around(hand.pose_by_name("F"), 0),
    "write_pose: pose": lambda: hand.write_pose("a.toml", "F"),
    "plane_of: volume": lambda: plot.plane_of(CAPTURE, "z"),
    "plane_of: at_m": lambda: plot.plane_of(VOLUME, "z", float("nan")),
    "recording_figure: captures": lambda: plot.recording_figure(CAPTURE, [0]),
    "comparison_figure: simulated": lambda: plot.comparison_figure(VOLUME, [VOLUME]),
    "html_report: images: expected a ReportImage": lambda: report.html_report(VOLUME, [VOLUME]),
    "image_report: image": lambda: report.image_report(VOLUME),
}


@pytest.mark.parametrize("words", CALLS)
def test_a_wrong_argument_is_named(words):
    with pytest.raises(ClradarError, match=f"^{words}"):
        CALLS[words]()


def test_titles_are_text_whatever_they_are():
    assert plot.capture_figure(CAPTURE, 3).get_suptitle() == "3"


def test_skeletons_take_the_names_of_poses():
    named, given = (hand.posed_skeleton(pose) for pose in ("f", hand.pose_by_name("F")))
    assert (named.joints_m == given.joints_m).all()
