"""``clradar hand``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from command_line import EDGE_MM, Run, one_error_line

import clradar


def test_hand_lists_its_poses(run: Run) -> None:
    outcome = run("hand", "--list")
    assert outcome.status == 0
    assert {"A", "F", "Y", "0", "9", "flat"} <= set(outcome.out.split())
    assert "Fist with the thumb across the front of the fingers." in outcome.out


def test_a_hand_of_a_pose_file_and_of_another_size(run: Run, made: Path, tmp_path: Path) -> None:
    from clradar.hand import HandPose, pose_by_name, write_pose

    pose = tmp_path / "mine.toml"
    write_pose(pose, HandPose("mine", pose_by_name("F").joints))
    whole, small = tmp_path / "whole.ply", tmp_path / "small.ply"
    outcome = run("hand", pose, "-o", whole, "--edge-mm", EDGE_MM)
    assert outcome.status == 0, outcome.err
    assert "hand 'mine'" in outcome.out
    same = clradar.Scene.from_mesh(made / "hand.ply")
    assert clradar.Scene.from_mesh(whole).digest() == same.digest()
    outcome = run("hand", "F", "-o", small, "--edge-mm", EDGE_MM, "--length-mm", "165",
                  "--breadth-mm", "75", "--girth", "0.95",
                  "--finger-lengths", "1", "1", "1.02", "1", "0.98")  # fmt: skip
    assert outcome.status == 0, outcome.err
    extents = [np.ptp(clradar.Scene.from_mesh(path).vertices_m, axis=0) for path in (whole, small)]
    # Length and breadth are 0.88 of the default's; the hand is a stub of forearm longer.
    assert (extents[1][:2] / extents[0][:2] < 0.92).all()
    one_error_line(run("hand", "F", "-o", tmp_path / "x.ply", "--length-mm", "30"), "length_m")
    pose.write_text('name = "x"\n[joints.elbow]\nflexion_deg = 1', encoding="utf-8")
    one_error_line(run("hand", pose, "-o", tmp_path / "x.ply"), "mine.toml", "elbow")


def test_a_turned_hand(run: Run, made: Path, tmp_path: Path) -> None:
    target = tmp_path / "turned.ply"
    outcome = run("hand", "F", "-o", target, "--turn-deg", "90", "--edge-mm", EDGE_MM)
    assert outcome.status == 0, outcome.err
    ours = clradar.Scene.from_mesh(target).vertices_m
    straight = clradar.Scene.from_mesh(made / "hand.ply").vertices_m
    # A quarter turn about x = 0, z = 0.3: +x comes to smaller z.
    expected = np.stack([straight[:, 2] - 0.3, straight[:, 1], 0.3 - straight[:, 0]], axis=1)
    # Both files hold float32: half an ulp each of coordinates below 0.5 m.
    assert np.allclose(ours, expected, rtol=0, atol=2 * 2.0**-25)


def test_a_glb_keeps_the_parts_apart(made: Path) -> None:
    parts = clradar.Scene.from_mesh(made / "parts.glb")
    whole = clradar.Scene.from_mesh(made / "hand.ply")
    assert set(parts.part_names) == {"palm", "thumb", "index", "middle", "ring", "pinky"}
    assert parts.n_faces == whole.n_faces


def test_a_ply_keeps_parts_and_texture(made: Path) -> None:
    """So that the roughness of a simulation from the file is that of the hand in memory."""
    from clradar.hand import hand_mesh

    hand = hand_mesh("F", float(EDGE_MM) / 1e3)
    scene = clradar.Scene.from_mesh(made / "hand.ply")
    assert scene.part_names == hand.part_names
    assert np.array_equal(scene.part, hand.part)
    # The file holds float32: half an ulp of coordinates below 0.25 m.
    np.testing.assert_allclose(scene.texture_m, hand.texture_m, rtol=0, atol=2.0**-27)
