"""Plans of data sets: values, the mistakes that are found, and the recipes that follow."""

import json
import pickle
import re
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from command_line import exit_status
from dataset_plans import TINY, plan_of, tiny

from clradar.dataset import PlanError, read_plan, recipe
from clradar.dataset.plan.draws import fixed, stream
from clradar.dataset.plan.plan import plan_from, plan_record
from clradar.dataset.sample import SamplePlan, read_recipe
from clradar.files.toml_file import read_toml
from clradar.hand import (
    JOINT_NAMES,
    LETTERS,
    POSES,
    HandPose,
    HandShape,
    interpolate_poses,
    write_pose,
)

ROOT = Path(__file__).resolve().parents[2]
HERE = Path()


def test_the_least_plan_has_defaults():
    plan = plan_from({"samples": 1, "poses": {"names": "letters"}}, "plan", HERE)
    assert tuple(pose.name for pose in plan.poses.resolved) == LETTERS
    assert plan.placement.z_mm == fixed(300.0)
    assert plan.simulation.estimator == "expected"
    assert (plan.simulation.samples_per_mm2, plan.simulation.rays_per_sample) == (0.25, 160)
    assert plan.output.products == ("max_projection", "depth_map", "joints")
    assert not plan.impairments.any


def test_a_plan_comes_back_from_its_record():
    for plan in (
        plan_of(),
        plan_of(poses={"kind": "interpolation", "share": {"uniform": [0.2, 0.8]}}),
        plan_of(poses={"kind": "sampler", "names": None}, alpha=0.25),
        plan_of(poses={"kind": "around", "spread_deg": 7.5}),
        *(plan_of(simulation={"reception_radius_mm": mm}) for mm in (7.3, 12.345678)),
        plan_of(
            impairments={
                "coupling_db": 20,
                "coupling_delay_ps": 30,
                "adc_bits": 12,
                "channels": {"gain_db": 2, "dead_tx": [1, 3]},
                "walls": [{"point_mm": [0, 0, 1200], "normal": [0, 0, -1], "amplitude": 40}],
            },
            hands={"shape": None, "shapes": [{"length_mm": 189.3}, {"girth": 1.1}]},
        ),
    ):
        record = json.loads(json.dumps(plan_record(plan), allow_nan=False))
        assert plan_from(record, "manifest", HERE) == plan
        assert plan_record(plan_from(record, "manifest", HERE)) == plan_record(plan)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        ("sampels", 3, "unknown key; .*did you mean 'samples'?"),
        ("samples", 0, "a whole number from 1"),
        ("seed", 1e3, "got the decimal number 1000.0; write 1000"),
        ("poses.names", ["A", "J"], r"\[1\]: .*got 'J'"),
        ("poses.names", "leters", "did you mean 'letters'?"),
        ("poses.names", ["A", "A"], "A more often"),
        ("poses.names", [1], r"\[0\]: expected the name of a pose, or .*, got 1$"),
        ("poses.kind", "sampler", "got 3 poses"),
        ("poses", {"kind": "interpolation", "names": ["A"]}, ".names: expected at least two"),
        ("poses.share", {"uniform": [0, 1]}, 'none unless kind = "interpolation"'),
        ("poses.spread_deg", 5, 'kind = "around"'),
        ("poses", {"kind": "around", "names": ["A"], "spread_deg": 46}, ".spread_deg: .*from 0 to"),
        ("poses.files", ["none.toml"], r"\[0\]: .*none.toml"),
        ("poses.resolved", ["pose.toml"], r"\[0\]: expected .* joints_rad, got .pose.toml"),
        ("hands.handedness", "rihgt", "did you mean 'right'?"),
        ("hands", {"shape": "list"}, '.shapes: expected a list of .* got "list" and 0'),
        ("hands", {"shapes": [{"length_mm": 400}]}, r"\[0\].length_mm: .*120 to 260, got 400"),
        ("hands", {"shapes": [{"length_mm": 180, "length_m": 0.2}]}, r"\[0\].length_m: .*got both"),
        ("hands", {"rigs": ["none.glb"]}, r".rigs\[0\]: .*none.glb"),
        ("placement.x_mm", {"unifrom": [0, 1]}, "did you mean 'uniform'?"),
        ("placement.x_mm", {"uniform": [1, 0]}, ".uniform: .*low <= high"),
        ("placement.x_mm", {"uniform": [0]}, ".uniform: expected two numbers"),
        ("placement.x_mm", {"normal": [0, -1]}, ".normal: .*not negative"),
        ("placement.x_mm", "5", 'got "5"'),
        ("placement.x_mm", date(2026, 5, 27), 'got "2026-05-27"$'),
        ("placement.x_mm", float("nan"), "got NaN"),
        ("placement.z_mm", {"normal": [300, 50]}, r"\[0, 600\] within 6"),
        ("placement.z_mm", 400, "image.z_mm is 250 to 350"),
        ("material", "skin", ': .*estimator = "physical" with it, got "expected"'),
        ("alpha", 1.5, ": expected values from 0 to 1, got 1.5"),
        ("alpha", {"normal": [0.5, 0.1]}, r": .*\[-0.1, 1.1\] within 6"),
        ("alpha", {"tumb": 0.5}, ".tumb: unknown key; .*did you mean 'thumb'?"),
        ("material", {"roughness_rms_m": 1e-4}, ".roughness_rms_m: .*mean 'roughness_rms_mm'?"),
        ("x]", 3, "unknown key; expected one of seed"),
        ("impairments.coupling_delay_ps", 3, "coupling_db"),
        ("impairments.channels", {"dead_tx": [12]}, ".dead_tx: .*0 to 11"),
        ("impairments.channels", {"dead_tx": [1, 1]}, ".dead_tx: .* of them once, got 1 more"),
        ("impairments.walls", [{"normal": [0, 0, 0]}], r"\[0\].normal: expected a direction"),
        ("radar.array", "few.toml", "few.toml"),
        ("radar.array", "qar5", "did you mean 'qar50'?.*got .qar5"),
        ("radar.stop_ghz", 70, "start_ghz < stop_ghz"),
        ("simulation.max_bounces", 2, "^plan.toml: simulation: .*max_bounces"),
        ("simulation.rays_per_face", 2, "^plan.toml: simulation: .*got both"),
        ("image.x_mm", [10, -10], "first <= last"),
        ("image.x_mm", [-10, 7], "^plan.toml: image: .*whole number of steps"),
        ("image", {"method": "exact", "tolerance_db": -50}, ".tolerance_db: expected none unless"),
        ("output.products", [], "at least one"),
        ("output.products", ["joints"], "^plan.toml: impairments: .* product that they change"),
        ("output", 5, "expected a table or object, got 5"),
        ("movement", {"frames": 3}, "^plan.toml: samples: .*a multiple of movement.frames, 3, got"),
    ],
)
def test_a_mistake_is_one_line_with_its_key(place, value, words):
    table, dot, key = place.partition(".")
    content = tiny(**{table: {key: value}}) if dot else {**TINY, table: value}
    with pytest.raises(PlanError) as caught:
        plan_from(content, "plan.toml", HERE)
    (line,) = caught.value.mistakes
    assert line.startswith("plan.toml: " if words[0] == "^" else f"plan.toml: {place}")
    assert re.search(words, line), line
    assert "\n" not in line


def test_all_mistakes_are_found_at_once_and_counted(tmp_path):
    (tmp_path / "pose.toml").write_text("nam = 'fist'\n")  # three mistakes
    wrong = {"seed": -1, "hands": {"handedness": "lft", "edge_mm": 9}, "alpha": 7}
    content = tiny(**wrong, poses={"files": ["pose.toml"]}, **{f"key{i}": 1 for i in range(40)})
    with pytest.raises(PlanError) as caught:
        plan_from(content, "plan.toml", tmp_path)
    again = pickle.loads(pickle.dumps(caught.value))  # as a worker sends it
    keys = {line.split(": ")[1] for line in again.mistakes}
    assert keys > {"seed", "hands.handedness", "hands.edge_mm", "alpha", "key0", "key39"}
    assert sum("pose.toml: " in line for line in again.mistakes) == 3
    lines = str(again).splitlines()
    assert (lines[0], lines[-1]) == ("47 mistakes, one per line:", "and 27 more")
    assert (len(lines), len(again.mistakes)) == (22, 47)


def test_the_command_prints_every_mistake_and_makes_nothing(tmp_path, capsys):
    path = tmp_path / "plan.toml"
    path.write_text("samples = 0\n[poses]\nnames = 'letters'\n[radar]\nevry = 2\n")
    assert exit_status("dataset", path, "-o", tmp_path / "out") == 1
    count, first, second = capsys.readouterr().err.splitlines()
    assert count == "clradar: error: 2 mistakes, one per line:"
    assert first.startswith(f"clradar: error: {path}: samples: ")
    assert second.startswith(f"clradar: error: {path}: radar.evry: unknown key")
    assert not (tmp_path / "out").exists()


def test_poses_and_antennas_of_files_beside_it_are_in_the_plan_and_in_every_recipe(tmp_path):
    mine = HandPose("mine", POSES["L"].joints)
    write_pose(tmp_path / "mine.toml", mine)
    (tmp_path / "few.toml").write_text("""[[tx]]
points_m = [[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]]
gain = [[1, 0], [1.1, 0], [1, 0]]
[[rx]]
points_m = [[0, 0.03, 0]]
""")
    text = "samples = 1\noutput.products = ['capture']\nradar = { array = 'few.toml', every = 2 }\n"
    (tmp_path / "plan.toml").write_text(text + "poses.files = ['mine.toml']\n")
    plan = read_plan(tmp_path / "plan.toml")
    assert plan.poses.resolved == (mine,)
    for name in ("few.toml", "mine.toml"):
        (tmp_path / name).unlink()
    assert plan_from(json.loads(json.dumps(plan_record(plan))), "manifest", tmp_path) == plan
    array = read_recipe(json.dumps(recipe(plan, 0))).plan.radar.antennas
    assert array.tx_m.tolist() == [[0, 0, 0], [0.02, 0, 0]]
    assert array.tx_gain.tolist() == [1, 1]
    assert array is plan.radar.antennas


def test_recipes_are_json_and_depend_on_their_number_alone():
    plan = plan_of()
    other = plan_of(samples=50, output={"shard_size": 7})
    for sample in range(plan.samples):
        found = recipe(plan, sample)
        assert json.loads(json.dumps(found, allow_nan=False)) == found
        more = {"samples": 50, "output": {**found["output"], "shard_size": 7}}
        assert recipe(other, sample) == found | more
        assert read_recipe(found).record == found  # there is nothing more to draw
    assert recipe(other, 1) != recipe(other, 4)  # of the same pose


def test_another_quantity_leaves_the_draws_as_they_are():
    plain = recipe(plan_of(impairments=None, alpha=0.5), 2)
    more = recipe(
        plan_of(
            placement={"y_mm": {"normal": [0, 1]}},
            alpha={"thumb": {"uniform": [0, 1]}},
            impairments={"iq_gain_db": {"uniform": [0, 1]}, "channels": {}},
        ),
        2,
    )
    for key in ("poses", "hands", "simulation", "radar", "image"):
        assert more[key] == plain[key]
    assert more["placement"] == plain["placement"] | {"y_mm": more["placement"]["y_mm"]}
    assert more["placement"]["y_mm"] != 0.0


def test_streams_of_samples_quantities_and_seeds_differ():
    first = {stream(*key).random() for key in [(1, 2, "a"), (1, 2, "b"), (1, 3, "a"), (2, 2, "a")]}
    assert (len(first), stream(1, 2, "a").random() in first) == (4, True)


def test_poses_come_in_cycles_at_random_between_or_sampled():
    names = ["A", "B", "F"]
    cycle = plan_of(samples=7)
    assert [SamplePlan(cycle, i).pose.name for i in range(7)] == [names[i % 3] for i in range(7)]
    random = plan_of(samples=9, poses={"order": "random"})
    found = [SamplePlan(random, i).pose.name for i in range(9)]
    assert (set(found), found[:6] != names * 2) == (set(names), True)
    between = plan_of(poses={"kind": "interpolation", "share": {"choice": [0.25]}})
    poses = dict(zip(names, between.poses.resolved, strict=True))
    for i in range(2):
        made = SamplePlan(between, i).pose
        ends = [p for n, p in poses.items() if n != names[i % 3]]
        assert made in [interpolate_poses(poses[names[i % 3]], end, 0.25) for end in ends]
    near = plan_of(poses={"kind": "around", "spread_deg": 3})
    for i in range(2):
        made = SamplePlan(near, i).pose
        letter = poses[names[i % 3]]
        assert made.name == letter.name
        assert made != letter
        off_deg = np.subtract(
            [made.angles(joint).degrees() for joint in JOINT_NAMES],
            [letter.angles(joint).degrees() for joint in JOINT_NAMES],
        )
        assert np.abs(off_deg).max() < 6 * 3  # the plan's bound of normal draws
    sampled = plan_of(poses={"kind": "sampler", "names": None})
    assert len({json.dumps(recipe(sampled, i)["poses"]) for i in range(2)}) == 2


def test_hands_and_alphas_are_those_that_are_listed():
    plan = plan_of(
        samples=40,
        hands={"shape": None, "shapes": [{"length_mm": 170}, {"length_mm": 200, "girth": 1.1}]},
        poses={"names": ["A"]},
    )
    found = [SamplePlan(plan, i).plan for i in range(40)]
    assert {one.hands.shapes[0].shape.length_m for one in found} == {0.17, 0.2}
    assert {one.hands.handedness for one in found} == {"right", "left"}
    alphas = [one.alpha.of_parts for one in found]
    assert {own["palm"] for own in alphas} == {0.2, 0.8}
    for own in alphas:
        (others,) = {own[name] for name in ("thumb", "index", "middle", "ring", "pinky")}
        assert 0.3 <= others <= 0.7
    assert SamplePlan(plan_of(hands={"shape": None}), 0).plan.hands.shapes[0].shape == HandShape()


def test_one_instrument_or_one_per_sample():
    for per, count in (("dataset", 1), ("sample", 5)):
        plan = plan_of(impairments={"channels": {"per": per}})
        seeds = {recipe(plan, i)["impairments"]["channels"]["seed"] for i in range(5)}
        assert len(seeds) == count
    noise = {recipe(plan_of(), i)["impairments"]["seed"] for i in range(5)}
    assert len(noise) == 5


def test_examples_are_plans_whose_keys_the_schema_has(capsys):
    assert exit_status("dataset", "--schema") == 0
    schema = json.loads(capsys.readouterr().out)
    for name, kind in (("Alpha", "number"), ("RigFile", "string"), ("PartMaterial", "string")):
        alone = schema["$defs"][name]["anyOf"][0]  # in place of the table
        assert kind in (alone.get("type"), alone.get("anyOf", [{}])[0].get("type"))
    files = list((ROOT / "examples" / "plans").glob("*.toml"))
    assert files
    for file in files:
        assert read_plan(file).samples > 0
        assert read_toml(file, "a plan").keys() <= schema["properties"].keys()
