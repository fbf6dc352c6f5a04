"""``clradar record-hand``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import two_devices
from command_line import DENSITY, EDGE_MM, Run, one_error_line

import clradar
from clradar.hand import hand_mesh, hand_movement, read_pose
from measurement_io import open_recording

SMALL = ("--frames", "2", "--edge-mm", EDGE_MM, "--samples-per-mm2", DENSITY, "--band", "72:82:8",
         "--estimator", "expected")  # fmt: skip


def test_a_recording_with_its_truth(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "hand"
    options = ("--alpha", "0.3", "--alpha", "palm=0.6", "--seed", "3", "--shift-mm", 0, 0, 10)
    outcome = run("record-hand", "S", "flat", "-o", folder, *SMALL, *options)
    assert (outcome.status, outcome.err) == (0, "")
    recording = open_recording(folder)
    assert recording.timestamps_us == (0, 125_000)
    truth = json.loads((folder / "truth/truth.json").read_text())
    movement = hand_movement(["S", "flat"], 2, shift_m=(0.0, 0.0, 0.01))
    assert (truth["handedness"], truth["shape"]["girth"]) == ("right", 1.0)
    for i, frame in enumerate(truth["frames"]):
        assert np.array_equal(frame["transform"], movement.transforms[i])
        mesh = movement.placed(i, hand_mesh(movement.poses[i], float(EDGE_MM) / 1e3))
        assert np.array_equal(list(frame["joints_m"].values()), mesh.joints_m)
        read = read_pose(folder / "truth" / frame["pose"])
        assert read.joints.keys() == movement.poses[i].joints.keys()
        # The samples: the same surface in all frames, and noise of 20 dB that differs.
        alphas = {name: 0.6 if name == "palm" else 0.3 for name in mesh.part_names}
        scene = clradar.Scene.from_mesh(mesh, alpha=alphas)
        waveform = clradar.Waveform.sfcw(72e9, 82e9, 8)
        clean = clradar.simulate(
            scene, clradar.arrays.qar50(), waveform,
            estimator="expected", samples_per_mm2=float(DENSITY), seed=3, device="pocl",
        )  # fmt: skip
        again = clradar.impair(clean, seed=3, frame=i, snr_db=20.0)
        assert np.array_equal(recording[i].data, again.data)
    record = json.loads(recording[1].meta["provenance"])
    assert (record["command"], record["options"]["frames"]) == ("record-hand", 2)


@pytest.mark.slow  # as other commands divide their work, see test_clusters.py
def test_devices_make_the_same_recording(run: Run, tmp_path: Path) -> None:
    command = ["record-hand", "S", "flat", *map(str, SMALL), "--device"]
    # In a process of its own, which sees the CPU as two devices.
    done = subprocess.run(
        [sys.executable, "-m", "clradar", *command, "all", "-o", str(tmp_path / "two")],
        env={**os.environ, **two_devices.ENVIRONMENT}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert run(*command, "pocl", "-o", tmp_path / "one").status == 0
    one, two = (open_recording(tmp_path / name) for name in ("one", "two"))
    for i in range(2):
        assert np.array_equal(one[i].data, two[i].data)
    truths = [json.loads((tmp_path / f"{name}/truth/truth.json").read_text())["frames"]
              for name in ("one", "two")]  # fmt: skip
    assert truths[0] == truths[1]


def test_a_recording_is_replaced_by_force_alone(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "hand"
    (folder / "truth").mkdir(parents=True)
    (folder / "truth/old").touch()
    one_error_line(run("record-hand", "A", "-o", folder, *SMALL), "--force")
    outcome = run("record-hand", "A", "-o", folder, *SMALL, "--snr-db", "inf", "--force")
    assert outcome.status == 0, outcome.err
    names = {path.name for path in (folder / "truth").iterdir()}
    assert names == {"truth.json", "000000.toml", "000001.toml"}
    still = open_recording(folder)
    assert np.array_equal(still[0].data, still[1].data)  # one surface, no noise
    (folder / "mine").touch()
    one_error_line(run("record-hand", "A", "-o", folder, *SMALL, "--force"), "mine")


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("elbow",), "elbow"),
        (("none.toml",), "none.toml"),
        (("A", "--frames", "1"), "n_frames"),
        (("A", "--alpha", "thumbs=0.3"), "thumbs"),
        (("A", "--length-mm", "30"), "length_m"),
    ],
)
def test_one_line_says_what_is_wrong(
    run: Run, tmp_path: Path, arguments: tuple[str, ...], part: str
) -> None:
    one_error_line(run("record-hand", *arguments, "-o", tmp_path / "x", "--edge-mm", EDGE_MM), part)
    assert not list(tmp_path.iterdir())


def test_options_that_do_not_go_together(run: Run, tmp_path: Path) -> None:
    for options in (("--theta", "t.json"), ("--rig", "r.glb", "--left")):
        outcome = run("record-hand", "A", "-o", tmp_path / "x", *options)
        assert outcome.status == 2
        assert options[-1] in outcome.err or options[0] in outcome.err
