"""Data sets of moving hands: consecutive samples are the frames of a sequence."""

import json
from pathlib import Path

import numpy as np
import pytest
from dataset_plans import DEVICE, tiny

import clradar
from clradar.dataset import make_sample, open_dataset, recipe, run
from clradar.dataset.check import check_dataset
from clradar.dataset.plan.plan import plan_from, plan_record
from clradar.dataset.plan.recipe import SamplePlan, read_recipe
from clradar.dataset.sample import moving_hand, scene_of
from clradar.hand import JOINT_NAMES

MOVEMENT = {"frames": 3, "rate_hz": 10, "z_mm": 30, "rotation_y_deg": {"uniform": [10, 20]}}


def plan(*, step_us=2.5, products=("capture",), **tables):
    noiseless = {} if "capture" in products else {"impairments": None}
    given = {
        "samples": 6,
        "movement": {**MOVEMENT, "step_us": step_us},
        "output": {"shard_size": 4, "products": list(products)},
    }
    return plan_from(tiny(**{**given, **noiseless, **tables}), "plan.toml", Path())


def test_frames_share_the_draws_of_their_sequence():
    found = plan()
    assert plan_from(plan_record(found), "manifest", Path()) == found
    frames = [SamplePlan(found, i) for i in range(6)]
    assert [frame.number for frame in frames] == [0, 0, 0, 1, 1, 1]
    assert [frame.start_s for frame in frames[3:]] == [0.0, 0.1, 0.2]
    for frame in frames:
        assert read_recipe(json.dumps(frame.record)).record == frame.record
    assert found.pose_names == ()  # each is between two
    assert plan(movement={**MOVEMENT, "poses": "stay"}).pose_names == ("A", "B", "F")
    recipes = [recipe(found, i) for i in range(6)]
    for key in ("hands", "placement", "alpha", "simulation"):
        assert recipes[3][key] == recipes[5][key] != recipes[0][key]
    hand = moving_hand(frames[4])
    moved_m = hand.transform(0.2)[:3, 3] - hand.transform(0.0)[:3, 3]
    assert moved_m[2] == pytest.approx(0.03, abs=0.03)
    about = (*frames[4].plan.placement.metres, 1.0)
    assert hand.motion.at(0.2) @ about == pytest.approx(np.add(about, (0, 0, 0.03, 0)))
    # The label is the pose in the middle of the sweep.
    slots = 12 * 16
    middle_s = 0.1 + 0.5 * (slots - 1) * 2.5e-6
    wanted, labelled = hand.pose(middle_s), frames[4].pose
    for joint in JOINT_NAMES:
        assert labelled.angles(joint).degrees() == pytest.approx(wanted.angles(joint).degrees())


@pytest.mark.usefixtures("quick_runs")
def test_frames_are_read_along_an_axis_of_their_own(tmp_path):
    run(plan(products=["joints", "mesh"]), tmp_path / "moving", device=DEVICE)
    assert check_dataset(tmp_path / "moving").problems == ()
    flat = open_dataset(tmp_path / "moving")
    assert flat.frame.values.tolist() == [0, 1, 2, 0, 1, 2]
    view = flat.set_index(sample=["sequence", "frame"]).unstack("sample")  # as the docs say
    assert (view.sizes["sequence"], view.sizes["frame"]) == (2, 3)
    wrist_m = view.joints.sel(joint="wrist", coordinate="z")
    assert (wrist_m.sel(frame=2) - wrist_m.sel(frame=0)).min() > 0.01
    assert np.array_equal(view.joints.sel(sequence=1, frame=2), flat.joints[5])


def test_a_frame_is_the_moving_hand_at_its_time():
    few = plan(radar={"every": 24, "steps": 4}, products=["capture"], impairments=None, step_us=20)
    frame = SamplePlan(few, 1)
    made = make_sample(frame.record, DEVICE).arrays["capture"]
    scene = clradar.MovingScene([moving_hand(frame, DEVICE)], lambda own: scene_of(own, frame))
    again = clradar.simulate_moving(
        scene, few.radar.antennas, few.radar.waveform,
        timing=clradar.SweepTiming.in_order(4, 4, step_s=20e-6), start_s=0.1, device=DEVICE,
        seed=frame.plan.simulation.seed, estimator="expected", samples_per_mm2=0.05,
        rays_per_sample=160,
    )  # fmt: skip
    assert np.array_equal(made, again.data)
