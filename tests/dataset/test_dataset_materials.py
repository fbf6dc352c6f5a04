"""Data sets of the physical estimator, whose hands have materials, and of hands that move."""

import json
from pathlib import Path

import numpy as np
import pytest
from dataset_plans import DEVICE, plan_of, tiny

import clradar
from clradar.dataset import PlanError, make_sample, open_dataset, recipe, run
from clradar.dataset.folder import check_dataset
from clradar.dataset.plan.plan import plan_from, plan_record
from clradar.dataset.sample import SamplePlan, moving_hand, placed_hand, read_recipe, scene_of
from clradar.hand import JOINT_NAMES, PART_NAMES

MATERIAL = {
    "palm": {
        "of": "palm",
        "roughness_rms_mm": {"uniform": [0.1, 0.3]},
        "correlation_length_mm": {"choice": [2.0, 3.0]},
        "coating_thickness_mm": {"uniform": [0.05, 0.2]},
    },
    "thumb": "metal",
    "others": {"of": "skin", "roughness_rms_mm": {"uniform": [0.03, 0.08]}},
}


def physical(**tables):
    given = {
        "samples": 2,
        "alpha": None,
        "radar": {"every": 24, "steps": 4},
        "material": MATERIAL,
        "simulation": {"estimator": "physical", "samples_per_mm2": 0.5},
        "output": {"products": ["capture", "max_projection"]},
    }
    return {**given, **tables}


PLAN = plan_of(**physical())


def test_lengths_are_drawn_from_streams_of_their_own():
    first, second = (SamplePlan(PLAN, i).plan.material.of_parts for i in (0, 1))
    assert "alpha" not in recipe(PLAN, 0)
    assert tuple(first) == PART_NAMES
    assert first["palm"] != second["palm"]
    for palm in (first["palm"], second["palm"]):
        assert 0.1e-3 <= palm.roughness_rms_m <= 0.3e-3
        assert palm.correlation_length_m in (2e-3, 3e-3)
        assert 0.05e-3 <= palm.coating.thickness_m <= 0.2e-3
        assert palm.permittivity == clradar.material("palm").permittivity
    assert first["thumb"] == clradar.material("metal")
    assert first["index"] == first["pinky"] != second["index"]


def test_a_plan_of_materials_comes_back_from_its_record(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text('[resin]\npermittivity = "2.9 - 0.04j"')
    wax = {"name": "wax", "permittivity": 2.2, "roughness_rms_m": 1e-4}
    wax["correlation_length_m"] = 1e-3
    fixed = {"of": "palm", "roughness_rms_mm": 0.2}
    given = (MATERIAL, "skin", fixed, {"palm": f"{own}:resin"}, {"of": wax})
    plans = [plan_of(**physical(material=one)) for one in given]
    own.unlink()  # it is not needed again
    for plan in plans:
        record = json.loads(json.dumps(plan_record(plan), allow_nan=False))
        assert "alpha" not in record
        assert plan_from(record, "manifest", tmp_path) == plan
    # Without `material` hands are all palm; without the physical estimator there is none.
    bare = {name: table for name, table in physical().items() if name != "material"}
    assert plan_of(**bare).material.others.of == clradar.material("palm")
    assert "material" not in plan_record(plan_of())


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"material": "rubber"}, "material: expected one of .metal., .skin.*got .rubber."),
        ({"material": 3}, "material: expected the name of a material"),
        ({"material": "gone.toml:resin"}, "material: .*gone.toml"),
        ({"material": {"plam": "skin", "palm": "palm"}}, "did you mean 'palm'"),
        ({"material": {"of": "skin", "coating_thickness_mm": 0.1}}, "a material with a coating"),
        ({"material": {"of": "metal", "roughness_rms_mm": 0.1}}, "correlation_length_m"),
        ({"material": {"roughness_rms_mm": {"normal": [0.1, 0.1]}}}, "roughness_rms_mm: expected"),
        ({"material": {"of": {"name": "x", "permittivity": "2+3j"}}}, "gain"),
        ({"alpha": 0.3}, "alpha: expected material in its place"),
        ({"simulation": {"estimator": "expected"}}, "material: expected simulation.estimator"),
        ({"simulation": {"rays_per_sample": 3}}, "rays_per_sample: expected the default"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line_each(tables, words):
    given = physical()
    for name, value in tables.items():
        given[name] = {**given[name], **value} if name == "simulation" else value
    with pytest.raises(PlanError, match=words) as raised:
        plan_of(**given)
    assert len(raised.value.mistakes) == 1


@pytest.mark.filterwarnings("ignore::clradar.ClradarWarning")  # of few samples
def test_a_data_set_of_materials_is_made_and_checked(tmp_path):
    folder = tmp_path / "hands"
    run(PLAN, folder, device=DEVICE)
    assert not check_dataset(folder).problems
    view = open_dataset(folder)
    assert "alpha" not in view
    for sample in (0, 1):
        palm = SamplePlan(PLAN, sample).plan.material.of_parts["palm"]
        one = view.sel(sample=sample)
        assert one.roughness_rms_m.sel(part="palm") == palm.roughness_rms_m
        assert one.correlation_length_m.sel(part="palm") == palm.correlation_length_m
        assert one.coating_thickness_m.sel(part="palm") == palm.coating.thickness_m
        assert np.isnan(one.coating_thickness_m.sel(part="thumb"))
    # Of what the stored recipe has, which is made again to the bit.
    stored = json.loads(view.recipe.values[1])
    drawn = read_recipe(stored)
    scene = scene_of(placed_hand(drawn, DEVICE), drawn)
    assert {m.name for m in scene.materials} == {"palm", "metal", "skin"}
    assert scene.texture_m is not None
    with_noise = make_sample(stored, DEVICE).arrays["capture"]
    assert with_noise.tobytes() == view.capture.values[1].tobytes()


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
