"""Roughness in millimetres: statistics, their likelihood, and estimates of known roughness."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure
from nightly import nightly
from recorded_targets import edge_array, two_plates
from scipy import stats
from shapes import plate

import calibration
import clradar
from calibration import Regions, RoughnessEstimate, sweep_roughness
from calibration.roughness import figures, roughness_sweep as module
from calibration.roughness.emulator import Emulator, Fit, Interval, at_ends, logarithms, terms
from calibration.roughness.estimates import estimate_roughness
from calibration.roughness.meters import SurfacePoints, TextureMeter, surface_points
from clradar.errors import CompareError, ModelError
from measurement_io import save_capture

# The smallest lengths are too steep for Kirchhoff; `test_...` expects what matters.
pytestmark = pytest.mark.filterwarnings("ignore:material:clradar.ClradarWarning")


ARRAY = edge_array(12)
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 8)
K = 2 * np.pi * 77e9 / 299_792_458.0
HEIGHTS_M = np.array([0.1e-3, 0.2e-3, 0.3e-3, 0.45e-3, 0.6e-3])
LENGTHS_M = np.array([1.5e-3, 3e-3, 6e-3])
SEEDS = 2
HELD_OUT = 1000
GAIN = 5.0


def rough(height_m: float, length_m: float = 3e-3) -> clradar.Material:
    return clradar.Material(
        "rough", conductor=True, roughness_rms_m=height_m, correlation_length_m=length_m
    )


def measured_of(scene: clradar.Scene, seed: int, gain: float = GAIN) -> clradar.Capture:
    """A noisy measurement of another seed than any simulation's."""
    clean = clradar.simulate(
        scene, ARRAY, WAVEFORM, seed=HELD_OUT + seed, estimator="physical", device="pocl"
    )
    noisy = clradar.impair(clean, snr_db=20.0, seed=seed)
    return clradar.Capture(gain * noisy.data, ARRAY, WAVEFORM)


SCENE = two_plates(4)


@pytest.fixture(scope="module")
def store() -> dict:
    """Images of all simulations of SCENE."""
    return {}


def swept(capture, store, **options):
    return sweep_roughness(
        capture, SCENE, HEIGHTS_M, LENGTHS_M, seeds=SEEDS, store=store, device="pocl",
        samples_per_mm2=2.0, **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def apart(store):
    """Left and right of different roughness, and what the sweep finds."""
    truth = {"left": (0.2e-3, 2e-3), "right": (0.4e-3, 4e-3)}
    scene = SCENE.with_material({name: rough(*pair) for name, pair in truth.items()})
    found = swept(measured_of(scene, 0), store, regions=Regions.of_parts(SCENE))
    return truth, found


# --- points and images


def test_a_hidden_region_is_an_error(device):
    hidden = clradar.Scene(*plate(0.01, 0.33, 1))
    behind = clradar.Scene.combine([clradar.Scene(*plate(0.1, 0.3, 4)), hidden])
    labels = np.repeat([0, 1], [behind.n_faces - hidden.n_faces, hidden.n_faces])
    with pytest.raises(CompareError, match="region '1' is not visible"):
        surface_points(behind, Regions.of_labels(labels), np.zeros(3), device)


# --- statistics


@pytest.fixture(scope="module")
def meter() -> tuple[TextureMeter, np.ndarray]:
    """1000 points in patches of ten, tilts of 0 to 20 degrees, and a smooth image."""
    rng = np.random.default_rng(5)
    n = 1000
    points = SurfacePoints(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, int), np.arange(n) // 10)
    smooth = (1.0 + rng.uniform(size=(4, n))) * np.exp(2j * np.pi * rng.uniform(size=(4, n)))
    tilts = np.radians(np.tile(np.linspace(0.0, 20.0, n), (4, 1)))
    return TextureMeter(points, 0, tilts, smooth, calibrated=True), smooth


def named(meter: TextureMeter, images: np.ndarray) -> dict[str, float]:
    return dict(zip(meter.names, meter.measure(images), strict=True))


def test_a_scaled_smooth_image_is_all_coherent(meter):
    own, smooth = meter
    phases = np.exp(1j * np.repeat(np.arange(100), 10))  # patch by patch
    found = named(own, 0.5 * phases * smooth)
    assert found["coherent"] == pytest.approx(2 * math.log(0.5), abs=1e-9)
    assert found["rest at 0 to 4 deg"] < -60


def test_speckle_has_the_contrast_of_an_exponential_law_and_no_correlation(meter):
    """The mean logarithm of an exponential variable is below that of its mean by Euler's constant.

    0.5772, with a standard deviation of pi / sqrt(6 n) = 0.02 for 4000 of them.
    """
    own, smooth = meter
    rng = np.random.default_rng(6)
    speckle = rng.normal(size=smooth.shape) + 1j * rng.normal(size=smooth.shape)
    found = named(own, speckle)
    assert found["contrast"] == pytest.approx(-0.5772, abs=0.06)
    assert abs(found["apertures alike"]) < 3 / math.sqrt(6 * 1000)
    # One of ten degrees of freedom of a patch goes into its factor.
    level = np.mean(np.abs(smooth) ** 2)
    assert found["rest at 4 to 8 deg"] == pytest.approx(math.log(2 * 0.9 / level), abs=0.1)


# --- the likelihood


def made_up(rng: np.random.Generator, height_m, length_m, gain: float = 0.0) -> np.ndarray:
    """Statistics like those of a plate: coherent, rest at two tilts, contrast."""
    g = (2 * K * height_m) ** 2
    scattered = np.log(1 - np.exp(-g)) + 2 * np.log(length_m / 3e-3) - 2
    steep = scattered - 0.02 * length_m**2 / height_m**2
    mean = np.stack([-g + gain, scattered + gain, steep + gain, -0.6 + 0 * g], axis=-1)
    return mean + rng.normal(size=mean.shape) * [0.1, 0.15, 0.2, 0.05]


STATISTICS = (
    "coherent", "rest at 0 to 4 deg", "rest at 8 to 12 deg", "contrast",
)  # fmt: skip


def grid_of_pairs() -> tuple[np.ndarray, np.ndarray]:
    pairs = np.array([(h, length) for h in HEIGHTS_M for length in LENGTHS_M] * 2)
    return pairs[:, 0], pairs[:, 1]


def emulator_of(height_m: np.ndarray, length_m: np.ndarray, statistics: np.ndarray) -> Emulator:
    powers = terms(len(HEIGHTS_M), len(LENGTHS_M))
    return Emulator.fitted(logarithms(height_m, length_m), powers, statistics)


def test_the_likelihood_is_students():
    """Of one statistic: the t density with the residuals' degrees of freedom, to a constant."""
    rng = np.random.default_rng(1)
    height_m, length_m = grid_of_pairs()
    simulated = made_up(rng, height_m, length_m)[:, :1]
    emulator = emulator_of(height_m, length_m, simulated)
    at = logarithms(0.3e-3, np.full(5, 3e-3))
    mean, spread = emulator.at(at)
    found = []
    values = np.linspace(-2.0, 2.0, 5)
    for value in values:
        log, chi2 = emulator.log_likelihood(mean[0] + value * spread[0], at)
        found.append(log[0])
        assert chi2[0] == pytest.approx(value**2)
    expected = stats.t.logpdf(values, emulator.freedom)
    assert np.allclose(np.diff(found), np.diff(expected))


def test_the_variance_of_residuals_counts_what_the_fit_took():
    """Of 400 columns of noise the mean is 1 to sqrt(2 / 400 / n), whatever the polynomial."""
    rng = np.random.default_rng(5)
    height_m, length_m = grid_of_pairs()
    noise = rng.standard_normal((len(height_m), 400))
    emulator = emulator_of(height_m, length_m, noise)
    terms = len(emulator.powers)
    assert emulator.freedom == len(height_m) - terms
    assert terms > 0.2 * len(height_m)
    assert np.diag(emulator.covariance).mean() == pytest.approx(1.0, abs=0.05)


def test_an_interval_of_equal_probabilities_is_that_of_an_even_distribution():
    found = Interval.of(np.linspace(0.0, 1.0, 51), np.full(51, 1 / 51))
    # 51 cells, whose outer two end half a cell beyond 0 and 1.
    limits = 1.02 * np.array([0.025, 0.16, 0.5, 0.84, 0.975]) - 0.01
    got = found.low95, found.low, found.median, found.high, found.high95
    assert got == pytest.approx(limits, abs=1e-12)


@pytest.mark.parametrize(("share", "bounded"), [(0.09, False), (0.11, True)])
def test_a_tenth_of_the_highest_probability_at_an_end_is_bounded_by_it(share, bounded):
    probability = np.array([share, 0.5, 1.0, 0.0])
    assert at_ends(probability) == (bounded, False)
    assert at_ends(probability[::-1]) == (False, bounded)


@pytest.mark.parametrize("calibrated", [True, *nightly([False])])
def test_intervals_contain_the_truth_as_often_as_they_say(calibrated):
    """Of 30 drawn surfaces 68 % in theory: 20, with a standard deviation of 2.6.

    Truths are drawn as the estimate expects them beforehand, so in theory the share is exact. The
    mean is no polynomial: it may be three deviations off.
    """
    rng = np.random.default_rng(2)
    inside = []
    for _ in range(30):
        height_m, length_m = grid_of_pairs()
        truth = 0.1e-3 * 6 ** rng.uniform(), 1.5e-3 * 4 ** rng.uniform()
        gain = 0.0 if calibrated else rng.normal(scale=3.0)
        seen = made_up(rng, *map(np.array, truth), gain)
        rows, names = made_up(rng, height_m, length_m), STATISTICS
        if not calibrated:  # relative to the coherent power
            names, gained = names[1:], np.array([1.0, 1.0, 0.0])
            seen, rows = (s[..., 1:] - s[..., :1] * gained for s in (seen, rows))
        one = estimate_roughness("all", names, seen, height_m, length_m, rows, 100)
        inside.append(one.roughness_m.low <= truth[0] <= one.roughness_m.high)
        assert one.probability.sum() == pytest.approx(1.0)
    assert abs(sum(inside) - 20) < 8


SHARP, WIDE = Interval(3e-4, 2.8e-4, 3.2e-4, 2e-4, 4e-4), Interval(3e-4, 1e-4, 6e-4, 1e-4, 6e-4)
SMOOTH = Interval(1e-4, 1e-4, 1.1e-4, 1e-4, 1.2e-4, bounded_below=True)
LENGTH, ANY_LENGTH = Interval(3e-3, 2.5e-3, 3.5e-3, 2e-3, 4e-3), Interval(3e-3, 1e-3, 6e-3, 1, 1)
SLOPE, ANY_SLOPE = Interval(0.1, 0.09, 0.11, 0.08, 0.12), Interval(0.1, 0.01, 0.5, 0, 1)


@pytest.mark.parametrize(
    ("found", "text"),
    [
        ((SHARP, LENGTH, SLOPE), "l = 3.0 ± 0.5 mm"),
        ((SHARP, ANY_LENGTH, SLOPE), "l is not observable, slope 0.10 ± 0.01"),
        ((SHARP, ANY_LENGTH, ANY_SLOPE), "h = 0.30 ± 0.02 mm, l is not observable"),
        ((WIDE, ANY_LENGTH, SLOPE), "h between 0.1 and 0.6 mm (95 %), l is not"),
        ((WIDE, ANY_LENGTH, ANY_SLOPE), "slope is not observable"),
        ((SMOOTH, ANY_LENGTH, ANY_SLOPE), "h below 0.12 mm (95 %), too smooth for more"),
    ],
)
def test_what_is_told_and_what_is_not(found, text):
    empty, ends_m = np.ones(0), np.array([1e-4, 6e-4])
    unlikely = Fit((), empty, empty, empty, 1e-6, 5)
    one = RoughnessEstimate("x", *found, ends_m, 10 * ends_m, empty, unlikely)
    assert text in one.text()
    given = replace(one, lengths_m=ends_m[:1])
    assert ("as given" in given.text()) == (found[0] is not SMOOTH)
    # No simulation has such statistics, which a smooth surface needs not.
    assert [r.count("no simulation") for r in one.remarks()] == [1] * (found[0] is not SMOOTH)


# --- sweeps


def test_two_regions_of_different_roughness_are_told_apart(apart):
    """Within three standard deviations: 0.3 % of right estimates are not."""
    truth, found = apart
    assert [one.name for one in found.estimates] == ["left", "right"]
    for one in found.estimates:
        height_m, length_m = truth[one.name]
        assert abs(one.roughness_m.median - height_m) < 3 * one.roughness_m.std
        assert one.roughness_m.std < 0.3 * height_m
        slope = math.sqrt(2) * height_m / length_m
        assert abs(one.slope.median - slope) < 3 * one.slope.std
        assert one.fit.probability > 1e-3


def test_a_calibrated_measurement_needs_no_gain_and_the_store_no_simulation(
    apart, store, monkeypatch
):
    scene = SCENE.with_material(rough(0.3e-3, 2e-3))
    capture = measured_of(scene, 2, gain=1.0)
    monkeypatch.setattr(module, "simulate", lambda *_, **__: pytest.fail("simulated again"))
    free, fixed = (swept(capture, dict(store), calibrated=c) for c in (False, True))
    assert fixed.estimates[0].roughness_m.std < free.estimates[0].roughness_m.std
    for found in (free, fixed):
        height = found.estimates[0].roughness_m
        assert abs(height.median - 0.3e-3) < 3 * height.std


SMOOTH_SCENE = SCENE.with_material(clradar.Material("smooth", conductor=True))


def test_a_smooth_surface_is_said_to_be_smooth(apart, store):
    found = swept(measured_of(SMOOTH_SCENE, 3), dict(store))
    assert found.estimates[0].is_smooth
    assert "too smooth" in found.report()


@pytest.mark.filterwarnings("ignore:sweep. roughness:clradar.ClradarWarning")
def test_another_pose_is_warned_of(apart, store):
    """A smooth surface that is turned by 6 degrees, which no roughness looks like."""
    turned = trimesh.transformations.rotation_matrix(0.1, [0, 1, 0], [0, 0, 0.3])
    capture = measured_of(SMOOTH_SCENE.transformed(turned), 5)
    with pytest.warns(clradar.ClradarWarning, match="no simulation has the statistics"):
        swept(capture, dict(store))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"roughness_m": [1e-4, 2e-4]}, "at least three"),
        ({"roughness_m": [0.1, 0.2, 0.3]}, "roughness_m"),
        ({"correlation_m": 0.0}, "correlation_m"),
        ({"seeds": 1}, "at least 30 simulations"),
        ({"measured": None}, "measured"),
        ({"estimator": "expected"}, "physical"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(change, words, monkeypatch):
    monkeypatch.setattr(module, "simulate", lambda *_, **__: pytest.fail("work"))
    empty = clradar.Capture(np.zeros((12, 12, 8)), ARRAY, WAVEFORM)
    given = {
        "measured": empty, "scene": SCENE, "roughness_m": HEIGHTS_M, "correlation_m": LENGTHS_M,
    }  # fmt: skip
    with pytest.raises(ModelError, match=words):
        sweep_roughness(**{**given, **change}, device="pocl")


# --- the command


COMMAND = (
    "sweep measured.h5 mesh.ply --roughness-mm 0.1:0.5:0.1 --correlation-mm 2,3 --calibrated "
    "--material palm --seed 7 -o out --x-mm -60:60:5 --y-mm -30:30:5 --z-mm 290:310:5 --seeds"
)


def test_the_command_passes_its_options_and_writes_what_is_found(cli, apart, monkeypatch):
    save_capture("measured.h5", clradar.Capture(np.ones((12, 12, 8)), ARRAY, WAVEFORM))
    trimesh.Trimesh(SCENE.vertices_m, SCENE.faces, process=False).export("mesh.ply")
    given = {}

    def swept_before(capture, scene, heights_m, lengths_m, **options):
        given.update(options, heights_m=heights_m, lengths_m=lengths_m, scene=scene)
        assert isinstance(capture, clradar.Capture)
        return apart[1]

    monkeypatch.setattr(calibration, "sweep_roughness", swept_before)
    # Not drawn, which would take most of the time.
    own_figure, drawn = figures.roughness_figure, []
    monkeypatch.setattr(figures, "roughness_figure", lambda f: drawn.append(f) or Figure())
    said = " ".join(cli.ok(f"{COMMAND} 4").out.split())
    assert np.allclose(given["heights_m"], np.arange(1, 6) * 1e-4)
    assert np.allclose(given["lengths_m"], [2e-3, 3e-3])
    assert (given["seeds"], given["settings"].seed, given["calibrated"]) == (4, 7, True)
    assert given["settings"].estimator == "physical"
    assert [m.name for m in given["scene"].materials] == ["palm"]
    record = json.loads(Path("out/sweep.json").read_text())
    for name, one in record["estimates"].items():
        assert f"roughness of {name}: {one['text']}" in said
    assert record["options"]["roughness_mm"] == [0.1, 0.2, 0.3, 0.4, 0.5]
    lines = Path("out/sweep.csv").read_text().splitlines()
    assert lines[0].startswith("region,roughness_m_median,")
    assert len(lines) == 3
    assert Path("out/sweep.png").is_file()
    axes = own_figure(*drawn).axes
    assert [one.get_title().split(":")[0] for one in axes[::3]] == ["left", "right"]
    assert "nothing to do" in cli.ok(f"{COMMAND} 4").out
    cli.fails(f"{COMMAND} 5", "begun with other settings")
