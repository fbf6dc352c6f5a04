"""Sweeps over alpha: estimates, shared random numbers, and the same bits after an interruption."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import group_of
from comparisons import tree
from interrupted import interrupted_at
from matplotlib.figure import Figure
from recorded_targets import edge_array, two_plates
from shapes import plate, sphere

import clradar
from calibration import Regions, Sweep, sweep
from calibration.roughness.estimates import AlphaEstimate, estimate_alpha
from calibration.roughness.figures import sweep_figure
from calibration.roughness.meters import BrightnessMeter, surface_points
from clradar.cli.commands import sweep as command
from clradar.cli.commands.sweep import SweptOptions
from clradar.errors import ClradarWarning, CompareError, ModelError
from clradar.hand.flesh import PART_NAMES
from clradar.plot import plane_of
from clradar.simulation import simulate_alphas
from measurement_io import save_capture

# Two alphas in one measurement, few rays and short ranges of alpha give reasons for doubt, here on
# purpose; `test_doubts_are_warnings` expects them.
pytestmark = pytest.mark.filterwarnings("ignore:sweep. :clradar.ClradarWarning")

ARRAY = edge_array(20)
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 16)
GRID = clradar.VoxelGrid.from_extent((-0.06, 0.06), (-0.03, 0.03), (0.285, 0.315), 3e-3)
ALPHAS = np.linspace(0.0, 1.0, 6)
# A sphere of 25 mm around a receiver: six times as many receptions, so that few rays are enough.
# The glints of flat faces of 4 mm are the texture by which so few rays tell alpha.
RAYS = {
    "samples_per_mm2": 3.0, "rays_per_sample": 4, "reception_radius_m": 0.025, "facets": "flat",
    "estimator": "stochastic",
}  # fmt: skip
FEW = {
    "samples_per_mm2": 0.3, "rays_per_sample": 2, "reception_radius_m": 0.025,
    "estimator": "stochastic",
}  # fmt: skip
RADAR = {"array": ARRAY, "waveform": WAVEFORM, "device": "pocl"}

TWO_SIGMA = 2.0
"""Estimates are within two standard deviations, as those of docs/sweep-method.md are."""

COMPLEX64_SUM = 4 * 2.0**-24
"""Two captures and their sum are rounded to float32 each, real and imaginary part."""


SCENE = two_plates(12, wavy_m=3e-3)


def image_of(scene: clradar.Scene, seed: int, **rays) -> clradar.Volume:
    capture = clradar.simulate(scene, ARRAY, WAVEFORM, seed=seed, device="pocl", **rays)
    return clradar.backproject(capture, GRID, device="pocl")


@pytest.fixture(scope="module")
def measured() -> clradar.Volume:
    """Left 0.2 and right 0.6, with a seed that no sweep here has."""
    return image_of(SCENE.with_alpha({"left": 0.2, "right": 0.6}), 9, **RAYS)


@pytest.fixture(scope="module")
def regional(measured) -> Sweep:
    halves = Regions.of_parts(SCENE)
    return sweep(measured, SCENE, ALPHAS, seeds=2, regions=halves, **RADAR, **RAYS)


# --- estimates


def test_regions_have_their_own_alphas(regional):
    left, right = regional.regions
    assert (left.name, right.name) == ("left", "right")
    assert abs(left.alpha - 0.2) <= TWO_SIGMA * left.uncertainty
    assert abs(right.alpha - 0.6) <= TWO_SIGMA * right.uncertainty
    assert right.alpha - left.alpha > 0.2
    assert left.uncertainty < 0.15  # a standard deviation of no knowledge at all is 0.29
    assert f"alpha of left: {left.text()}" in regional.report()
    json.dumps(regional.to_dict(), allow_nan=False)


def made_up(rng: np.random.Generator, alpha, n_seeds: int) -> np.ndarray:
    """Statistics [seed][alpha] that are smooth in alpha, with a scatter that grows with it."""
    alpha = np.atleast_1d(alpha)
    mean = np.stack([np.exp(-3 * alpha), np.sin(alpha), -1 + 0.5 * alpha**2], axis=-1)
    return mean + (0.1 + 0.2 * alpha)[:, None] * rng.normal(size=(n_seeds, *mean.shape))


TENTHS = np.linspace(0.0, 1.0, 11)


def estimated(seen, alphas, simulated, displaced=0.0) -> AlphaEstimate:
    rows = simulated.reshape(-1, 3)
    made = np.tile(alphas, len(simulated))
    variance = np.full(rows.shape, displaced)
    return estimate_alpha("all", ("a", "b", "c"), seen, made, rows, variance, 100)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 200 draws 95 % in theory: 190, with a standard deviation of 3."""
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(200):
        simulated, truth = made_up(rng, TENTHS, 3), rng.uniform()
        found = estimated(made_up(rng, truth, 1)[0, 0], TENTHS, simulated)
        inside.append(found.interval.low95 <= truth <= found.interval.high95)
    assert np.count_nonzero(inside) >= 190 - 3 * 3


def test_a_statistic_that_all_simulations_share_counts_for_nothing():
    """As that all of a plate is bright: the interval is that of the others."""
    rng = np.random.default_rng(1)
    simulated, seen = made_up(rng, TENTHS, 3), made_up(rng, 0.5, 1)[0, 0]
    simulated[..., 2], seen[2] = 5.0, 5.0
    found = estimated(seen, TENTHS, simulated)
    assert found.interval.low95 < 0.5 < found.interval.high95


def test_a_mesh_out_of_place_and_few_alphas_widen_the_interval():
    rng = np.random.default_rng(7)
    statistics = made_up(rng, TENTHS, 3)
    seen = made_up(rng, 0.45, 1)[0, 0]
    plain = estimated(seen, TENTHS, statistics).uncertainty
    assert estimated(seen, TENTHS, statistics, 0.3**2).uncertainty > 1.2 * plain
    kinks = statistics.copy()
    kinks[:, 5] += 1.0  # what is no polynomial is uncertain
    assert estimated(seen, TENTHS, kinks).uncertainty > 1.2 * plain


@pytest.mark.parametrize(
    ("alphas", "truth", "doubtful"),
    [
        (TENTHS, 0.0, False), (TENTHS, 1.0, False),  # beyond these there is nothing
        (TENTHS[2:], 0.05, True), (TENTHS[:8], 0.9, True), (TENTHS[1:10], 0.5, False),
    ],
)  # fmt: skip
def test_an_end_of_the_range_is_doubtful_unless_there_is_nothing_beyond(alphas, truth, doubtful):
    rng = np.random.default_rng(6)
    statistics = np.mean([made_up(rng, alphas, 3) for _ in range(50)], axis=0)
    seen = np.mean([made_up(rng, truth, 1)[0, 0] for _ in range(50)], axis=0)
    found = estimated(seen, alphas, statistics)
    assert ("take a wider range" in " ".join(found.remarks())) == doubtful


def test_what_no_simulation_looks_like_is_said():
    rng = np.random.default_rng(8)
    found = estimated(np.array([9.0, -9.0, 9.0]), TENTHS, made_up(rng, TENTHS, 3))
    assert "no simulation has the statistics" in found.remarks()[0]


def test_brightness_is_relative_and_read_at_the_points_of_the_surface():
    """Of an image whose power falls with the tilt of a ball: the means of the bins, and no gain."""
    centre_m, radius_m = np.array([0.0, 0.0, 0.3]), 0.04
    scene = clradar.Scene(*sphere(tuple(centre_m), radius_m, 5))
    device = clradar.open_device("pocl")
    points = surface_points(scene, None, np.zeros(3), device)
    one = clradar.AntennaArray([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
    meter = BrightnessMeter(points, None, one)
    axis_m = np.arange(-50, 51) * 1e-3
    x, y = np.meshgrid(axis_m, axis_m)
    sine = np.sqrt(np.minimum(x**2 + y**2, 0.99 * radius_m**2)) / radius_m
    to_deg = np.degrees(np.arcsin(sine))  # of the normal from z, a little less than the tilt

    def image(gain: float) -> clradar.DepthMap:
        amplitude = gain * np.exp(-0.5 * to_deg / 10)
        return clradar.DepthMap(np.full(x.shape, 0.3), amplitude, axis_m, axis_m, 60.0)

    found = dict(zip(meter.names, meter.measure(image(1.0)), strict=True))
    first, second = found["power at 12 to 17 deg"], found["power at 23 to 30 deg"]
    # A tilt of t is t / (1 + 40 mm / 260 mm) from z.
    assert first - second == pytest.approx((26.5 - 14.5) / 1.154 / 10, rel=0.15)
    np.testing.assert_allclose(meter.measure(image(7.0)), meter.measure(image(1.0)), rtol=1e-6)
    assert meter.sees(image(1.0))
    assert not meter.sees(image(0.0))
    # Moved by a step, as the image moved the other way.
    moved = clradar.DepthMap(
        np.full(x.shape, 0.3), np.roll(image(1.0).amplitude, -1, axis=1), axis_m, axis_m, 60.0
    )
    np.testing.assert_allclose(
        meter.measure(image(1.0), (1e-3, 0.0)), meter.measure(moved), rtol=1e-6, atol=1e-6
    )
    assert (meter.displaced(image(1.0)) > 0).all()


def test_another_estimator_in_place_of_a_measurement_is_warned_of():
    expected = image_of(SCENE.with_alpha(0.3), 9, **{**FEW, "estimator": "expected"})
    with pytest.warns(ClradarWarning, match="a simulation by the expected estimator"):
        sweep(expected, SCENE, [0.1, 0.4], seeds=2, **RADAR, **FEW)


# --- rays and random numbers are shared


def test_shared_visibility_gives_the_bits_of_simulate(device):
    rays = {**FEW, "max_bounces": 2, "seed": 5}
    made = [c for (c,) in simulate_alphas(SCENE, ARRAY, WAVEFORM, ALPHAS, device=device, **rays)]
    for alpha, capture in zip(ALPHAS, made, strict=True):
        alone = clradar.simulate(SCENE.with_alpha(alpha), ARRAY, WAVEFORM, device=device, **rays)
        assert np.array_equal(capture.data, alone.data)
        assert capture.meta == alone.meta


def test_captures_of_regions_add_up(device):
    labels = (SCENE.triangles_m.mean(axis=1)[:, 0] > 0).astype(int)
    rays = {**FEW, "seed": 5}
    (parts,) = simulate_alphas(SCENE, ARRAY, WAVEFORM, [0.3], region=labels, device=device, **rays)
    alone = clradar.simulate(SCENE.with_alpha(0.3), ARRAY, WAVEFORM, device=device, **rays)
    error = np.abs(parts[0].data + parts[1].data - alone.data).max()
    assert error <= COMPLEX64_SUM * np.abs(alone.data).max()
    assert sum(part.meta["region"]["paths"] for part in parts) == alone.meta["rays"]["paths"]


# --- resuming


COMMAND = (
    "sweep measured.h5 plates.ply --alpha 0.2,0.4 --seeds 2 --samples-per-mm2 0.3 "
    "--rays-per-sample 2 --reception-radius-mm 25 --x-mm=-60:60:3 --y-mm=-30:30:3 "
    "--z-mm 285:315:3 -o"
)


def test_an_interrupted_command_resumes_to_the_same_files(cli, monkeypatch):
    scene = SCENE.with_alpha(0.3)
    save_capture("measured.h5", clradar.simulate(scene, ARRAY, WAVEFORM, seed=9, **FEW))
    trimesh.Trimesh(SCENE.vertices_m, SCENE.faces, process=False).export("plates.ply")
    # The figure is most of the time otherwise.
    monkeypatch.setattr("calibration.roughness.figures.sweep_figure", lambda _: Figure())
    with interrupted_at(np, "savez", 3, lambda file: file.write(b"half of it")):
        assert cli(f"{COMMAND} interrupted").status == 130
    assert len(list(Path("interrupted", command.WORK).iterdir())) == 2
    assert "resumes with 2 images" in cli.ok(f"{COMMAND} interrupted").out
    assert "alpha: " in cli.ok(f"{COMMAND} whole").out
    resumed, whole = (tree(name) for name in ("interrupted", "whole"))
    assert set(whole) == {command.KEY, *command.RESULTS}
    assert all(resumed[name] == whole[name] for name in command.RESULTS)
    assert not Path("interrupted", command.WORK).exists()
    record = json.loads(Path("whole", command.RESULT).read_text())
    assert record["alphas"] == [0.2, 0.4]
    lines = Path("whole", command.TABLE).read_text().splitlines()
    assert lines[0].startswith("alpha,seed,overlap,")
    assert len(lines) == 1 + 2 * 2
    # Other settings are refused by name.
    other = f"{COMMAND} whole --rays-per-sample 3 --seed 4"
    cli.fails(other, "rays_per_sample 2, now 3", "seed 0, now 4")
    assert tree("whole") == whole


# --- wrong input


def somewhere() -> clradar.Volume:
    return clradar.Volume(np.random.default_rng(0).standard_normal(GRID.shape), GRID)


EMPTY = clradar.Volume(np.zeros(GRID.shape), GRID)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"measured": EMPTY}, CompareError, "measured"),
        ({"measured": plane_of(somewhere(), "y", 0.0)}, CompareError, "11 x 11 pixels"),
        ({"scene": SCENE.transformed(np.diag([1e3, 1e3, 1e3, 1]))}, CompareError, "unit"),
        ({"alphas": [0.5]}, ModelError, "at least two"),
        ({"alphas": [0.5, 1.5]}, ModelError, r"\[0, 1\]"),
        ({"alphas": ALPHAS[::-1]}, ModelError, "ascending"),
        ({"alphas": ALPHAS[:4], "seeds": 1}, ModelError, "5 alphas"),
        ({"regions": Regions.of_parts(SCENE), "max_bounces": 2}, ModelError, "max_bounces"),
        ({"regions": Regions.of_labels([0, 1])}, ModelError, "faces"),
        ({"waveform": 77e9}, ModelError, "waveform"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(change, error, words):
    given = {"measured": somewhere(), "scene": SCENE, "alphas": ALPHAS, **change}
    with pytest.raises(error, match=words):
        sweep(**given, device="pocl", progress=lambda *_: pytest.fail("work"))


@pytest.mark.filterwarnings("ignore:no ray reached:clradar.ClradarWarning")
def test_a_mesh_that_no_ray_comes_back_from_is_an_error():
    """A mirror that faces away: every simulation is zero."""
    turned = np.eye(4)
    turned[:3, :3] = [[0.17, 0, 0.98], [0, 1, 0], [-0.98, 0, 0.17]]
    turned[:3, 3] = [-0.3, 0, 0.25]
    flat = clradar.Scene(*plate(0.05, 0.3, 2)).transformed(turned)
    with pytest.raises(CompareError, match=r"no ray reaches|not visible|too small"):
        sweep(somewhere(), flat, [0.0, 0.01], seeds=2, **RADAR, **FEW)


def test_alphas_are_rounded_as_typed():
    assert SweptOptions().alpha == tuple(round(i / 10, 1) for i in range(11))
    assert group_of(SweptOptions, alpha="0.1,0.25,1").alpha == (0.1, 0.25, 1.0)


# --- regions


def test_fingers_are_all_but_the_palm():
    part = np.array([0, 1, 5, 0, 2, 3, 4])
    faces = np.array([[0, 1, 2]] * 7)
    hand = clradar.Scene(np.eye(3), faces, 0.5, part, PART_NAMES)
    found = Regions.of_fingers(hand)
    assert found.names == ("palm", "fingers")
    assert found.face.tolist() == [0, 1, 1, 0, 1, 1, 1]
    some = clradar.Scene(np.eye(3), faces, 0.5, np.where(part == 5, 1, part), PART_NAMES)
    assert Regions.of_parts(some).names == tuple(PART_NAMES[:5])
    with pytest.raises(ModelError, match="a hand with the parts"):
        Regions.of_fingers(SCENE)


def test_parts_of_a_mesh_in_groups():
    flipped = Regions.of_parts(SCENE, {"one": ["right"], "two": ["left"]})
    assert flipped.names == ("one", "two")
    assert np.array_equal(flipped.face, SCENE.part ^ 1)
    for groups in ({"one": ["left"]}, {"one": ["left", "right"]}):
        with pytest.raises(ModelError, match="regions"):
            Regions.of_parts(SCENE, groups)


def test_the_figure_shows_images_and_probabilities(regional):
    titles = [axes.get_title() for axes in sweep_figure(regional).axes]
    shown = [f"\N{GREEK SMALL LETTER ALPHA} = {a:g}" for a in ALPHAS]
    assert titles[:7] == ["Measurement", *shown]
    assert any(title.startswith("probability") for title in titles)
