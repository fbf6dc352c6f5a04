"""`clradar simulate --motion`: a capture or a recording of a scene that moves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import Run, one_error_line
from rig_files import RigMaker

import clradar
from measurement_io import open_capture, open_recording

MOTION = """
sweep.step_us = 20
[[body]]
velocity_mm_per_s = [0, 0, 50]
[[hand]]
edge_mm = 4
pose = [{ time_s = 0, pose = "S" }, { time_s = 1, pose = "flat" }]
center_mm = [0, 0, 400]
"""


def test_a_moving_scene_becomes_a_recording_with_its_truth(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    ball.apply_translation([0, 0, 0.2]).export(tmp_path / "ball.ply")
    (tmp_path / "motion.toml").write_text(MOTION)
    options = "--band 72:82:2 --samples-per-mm2 0.02 --estimator expected"
    command = f"simulate ball.ply --motion motion.toml {options} -o"
    made = run(*command.split(), "moving", "--frames", 2, "--rate-hz", 1)
    assert made.status == 0, made.err
    recording = open_recording("moving")
    assert "2 frames, sweeps of 3.74 ms, samples right to -" in made.out
    assert recording.timestamps_us == (0, 1_000_000)
    assert recording[0].data.shape == (94, 94, 2)
    truth = json.loads(Path("moving/truth/truth.json").read_text())["frames"]
    middle_s = truth[1]["middle_s"]
    assert middle_s == pytest.approx(1.00187)
    assert truth[1]["bodies"][""][2][3] == pytest.approx(0.05 * middle_s)
    assert truth[1]["hands"][0]["pose"] == "flat"
    assert len(truth[0]["hands"][0]["joints_m"]) == 25
    made = run(*command.split(), "one.h5")
    assert made.status == 0
    one = open_capture("one.h5")
    assert f"samples right to {one.meta['movement']['sample_error_db']:.0f} dB" in made.out
    assert np.array_equal(one.data, recording[0].data)
    assert one.meta["movement"]["instants"] >= 2
    assert clradar.read_motion("motion.toml").hands[0].edge_length_m == 4e-3


def test_frames_of_another_radar_and_clusters_one_after_the_other(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    ball.apply_translation([0, 0, 0.3]).export("ball.ply")
    Path("motion.toml").write_text("body = [{ velocity_mm_per_s = [0, 0, 500] }]")
    rules = (
        "[[tx]]\nline = { first_m = [0, 0, 0], last_m = [0.01, 0, 0], n = 3 }\n"
        "[[rx]]\nline = { first_m = [0, 0, 0], last_m = [0, 0.01, 0], n = 2 }\n"
    )
    Path("radar.toml").write_text(rules)
    poses = "[[pose]]\npoints_m = [[0, 0, 0], [0.03, 0, 0]]"
    Path("wall.toml").write_text(f'pairs = "cluster"\n{rules}{poses}')
    options = "--motion motion.toml --band 60:60.2:3 --estimator expected"
    command = f"simulate ball.ply {options} --frames 2 --array".split()
    assert run(*command, "radar.toml", "-o", "frames").status == 0
    recording = open_recording("frames")
    assert recording.timestamps_us == (0, 125_000)
    assert recording[1].array.same_positions(clradar.arrays.read_array("radar.toml"))
    one_error_line(run(*command, "radar.toml", "-o", "frames"), "holds files already")
    assert run(*command, "wall.toml", "-o", "wall").status == 0
    first, second = (open_recording(f"wall/cluster_00{i}") for i in (1, 2))
    np.testing.assert_array_equal(first[1].data, recording[1].data)
    # The second cluster begins when 3 Tx had 3 frequencies of 2.5 us each.
    moving = clradar.MovingScene(
        [clradar.MovingBody(clradar.Scene.from_mesh("ball.ply"),
                            clradar.read_motion("motion.toml").bodies[""])]
    )  # fmt: skip
    own, band = clradar.arrays.read_clusters("wall.toml")[1], clradar.Waveform.sfcw(60e9, 60.2e9, 3)
    want = clradar.simulate_moving(moving, own, band, start_s=0.125 + 22.5e-6, estimator="expected")
    np.testing.assert_allclose(second[1].data, want.data, rtol=1e-5)
    for missing in ("none.ply", "ball.ply:0.5 none.ply"):
        outcome = run("simulate", *missing.split(), *options.split(), "-o", "no.h5")
        one_error_line(outcome, "none.ply: no such file; expected a mesh file")
    outcome = run("simulate", "ball.ply", *options.split(), "--array", "wall.toml", "-o", "one")
    assert outcome.status == 0, outcome.err
    names = sorted(path.name for path in Path("one").iterdir())
    assert names == ["cluster_001.h5", "cluster_002.h5"]


def test_a_hand_goes_from_pose_to_pose_as_a_motion(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    way = ["hand", "--from", "A", "--to", "bent.toml", "--edge-mm", "4", "--left"]
    way += ["--length-mm", "180"]
    bent = 'name = "bent"\n[joints.index-finger-phalanx-intermediate]\nflexion_deg = 80'
    (tmp_path / "bent.toml").write_text(bent)
    (tmp_path / "in").mkdir()
    assert run(*way, "-o", "in/motion.toml", "--duration-s", 0.5, "--turn-deg", 20).status == 0
    motion = clradar.read_motion("in/motion.toml")
    hand = motion.hands[0]
    assert hand.handedness == "left"
    assert hand.shape.length_m == pytest.approx(0.18)
    assert hand.pose(0.5).name == "bent"
    assert hand.times_s.tolist() == [0, 0.5]
    assert hand.transform(0.2)[:3, :3] @ (1, 0, 0) == pytest.approx(
        (np.cos(np.radians(20)), 0, -np.sin(np.radians(20)))
    )
    assert run("hand", "A", *way[1:], "-o", "in/other.toml").status == 2
    one_error_line(run(*way, "-o", "way.ply"), "expected a name that ends in .toml")


def test_a_rig_goes_from_pose_to_pose_in_a_motion(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    RigMaker(units=100.0).save(tmp_path / "hand.glb")
    way = ["hand", "--from", "flat", "--to", "A", "--rig", "hand.glb", "--rig-unit", "cm"]
    outcome = run(*way, "--duration-s", 0.5, "-o", "in/motion.toml")
    assert outcome.status == 0, outcome.err
    motion = clradar.read_motion("in/motion.toml")
    assert [path.name for path in motion.files] == ["motion.toml", "hand.glb"]
    hand = motion.hands[0]
    assert hand.joints_m(0.25) == pytest.approx(hand.mesh(0.25).joints_m, nan_ok=True)
    command = "simulate --motion in/motion.toml --band 72:72.1:2 --samples-per-mm2 0.05"
    outcome = run(*command.split(), "--estimator", "expected", "--frames", 1, "-o", "moving")
    assert outcome.status == 0, outcome.err
    text = Path("in/motion.toml").read_text()
    Path("in/motion.toml").write_text(text + "\n[[hand]]\nrig = 'x.glb'\nedge_mm = 2\npose = []")
    one_error_line(run(*command.split(), "-o", "x.h5"), "motion.toml")
