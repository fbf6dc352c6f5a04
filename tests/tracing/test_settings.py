"""The settings record of a simulation: what it refuses, and how functions take it."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import plate

import clradar
from clradar import AntennaArray, Scene, SimulationSettings, Waveform
from clradar.errors import ModelError
from clradar.simulation import simulate_alphas
from clradar.tracing.settings import resolve_settings

SCENE = Scene(*plate(0.05, 0.3), 0.5)
SMALL = Scene(*plate(0.01, 0.3), 0.5)
ARRAY = AntennaArray([[0.0, 0.0, 0.0]], [[0.01, 0.0, 0.0]])
WAVEFORM = Waveform([77e9])


@pytest.mark.filterwarnings("ignore:no ray reached a receiver")
def test_a_keyword_goes_before_the_record(device):
    settings = SimulationSettings(rays_per_face=5, seed=3)
    capture = clradar.simulate(SCENE, ARRAY, WAVEFORM, settings=settings, seed=4, device=device)
    same = clradar.simulate(SCENE, ARRAY, WAVEFORM, rays_per_face=5, seed=4, device=device)
    assert capture.meta == same.meta
    np.testing.assert_array_equal(capture.data, same.data)
    assert capture.meta["settings"]["seed"] == 4
    assert settings.seed == 3


def test_densities_of_a_resolved_record_stay_when_a_field_is_replaced():
    resolved = SimulationSettings(estimator="expected").resolved()
    assert (resolved.samples_per_mm2, resolved.rays_per_sample) == (1.0, 40)
    assert resolved.resolved() == resolved
    of_rays = resolve_settings()
    assert (of_rays.samples_per_mm2, of_rays.rays_per_sample) == (10.0, 4)
    drawn = resolve_settings(resolved, estimator="stochastic")
    assert (drawn.samples_per_mm2, drawn.rays_per_sample) == (1.0, 40)
    with pytest.raises(ModelError, match="one of the two"):
        replace(resolved, rays_per_face=3)
    assert replace(resolved, samples_per_mm2=None, rays_per_face=3).rays_per_sample == 40


@pytest.mark.parametrize(
    ("estimator", "of_paths", "of_alphas"),
    [("expected", "'stochastic'", "'stochastic'"), ("physical", "simulate", "with_material")],
)
def test_only_simulate_takes_estimators_without_rays(estimator, of_paths, of_alphas, device):
    with pytest.raises(ModelError, match=rf"trace: estimator: .*{of_paths}"):
        clradar.trace(SCENE, ARRAY, estimator=estimator, device=device)
    with pytest.raises(ModelError, match=rf"simulate_alphas: estimator: .*{of_alphas}"):
        simulate_alphas(SCENE, ARRAY, WAVEFORM, [0.5], estimator=estimator, device=device)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples_per_mm2": 1.0, "rays_per_face": 1}, "one of the two"),
        ({"samples_per_mm2": 0.0}, "samples_per_mm2"),
        ({"rays_per_face": 0}, "rays_per_face"),
        ({"rays_per_sample": 1.5}, "rays_per_sample"),
        ({"reception_radius_m": 10}, r"a radius from 0.0001 to 1 m, got 10 m; .*10 mm \(0.01 m\)"),
        ({"reception_radius_m": 1e-320}, "a radius from 0.0001 to 1 m"),
        ({"amplitude": "spreading", "pattern_exponent": 1e308}, "at most 10000"),
        ({"max_bounces": 256}, "max_bounces"),
        ({"max_bounces": 2, "estimator": "expected"}, "max_bounces"),
        ({"normals": "round"}, "normals"),
        ({"crease_deg": -1.0}, "crease_deg"),
        ({"amplitude": "loud"}, "amplitude"),
        ({"pattern_exponent": 1.0}, "pattern_exponent"),
        ({"pattern_exponent": -1.0, "amplitude": "spreading"}, "pattern_exponent"),
        ({"seed": 2**64}, "seed"),
        ({"estimator": "mean"}, "estimator"),
        *(
            ({"estimator": "physical", name: value}, f"{name}: .*estimator='physical'")
            for name, value in (
                *[("rays_per_face", 2), ("max_bounces", 2)],
                *[("amplitude", "spreading"), ("rays_per_sample", 4)],
            )
        ),
    ],
)
def test_invalid_settings_are_refused(arguments, message, device):
    with pytest.raises(ModelError, match=message):
        clradar.simulate(SCENE, ARRAY, WAVEFORM, device=device, **arguments)


SKIN, MIRROR = SMALL.with_material("skin"), SMALL.with_alpha([1.0, 0.0])


@pytest.mark.parametrize(
    ("scene", "arguments", "estimator"),
    [
        (SMALL, {}, "expected"),
        (SMALL, {"samples_per_mm2": 0.5, "seed": 3, "reception_radius_m": 0.02}, "expected"),
        # Where random rays are asked for, or samples would be too few for so narrow a lobe.
        (SMALL, {"rays_per_sample": 1}, "stochastic"),
        (SMALL, {"rays_per_face": 4000}, "stochastic"),
        (SMALL, {"max_bounces": 2}, "stochastic"),
        (SMALL.with_alpha([1.0, 0.12]), {}, "expected"),
        (SMALL.with_alpha([1.0, 0.11]), {}, "stochastic"),
        (MIRROR, {}, "stochastic"),
        (SKIN, {}, "physical"),
        (SKIN, {"estimator": "expected"}, "expected"),
        (SKIN, {"max_bounces": 2}, "stochastic"),
        (SMALL.with_material("metal"), {}, "physical"),  # of a conductor anyway
    ],
)
def test_scene_and_settings_choose_the_estimator(scene, arguments, estimator):
    capture = clradar.simulate(scene, ARRAY, WAVEFORM, **arguments)
    assert capture.meta["settings"]["estimator"] == estimator


@pytest.mark.parametrize(
    ("distance_m", "ghz", "radius_m"),
    # 10 mm sqrt(range / 0.3 m * 77 GHz / f): 10, 17.9, 48, 73 and 6.0 mm.
    [(0.3, 77, 0.01), (0.3, 24, 0.02), (7, 77, 0.04), (5, 24, 0.08), (0.2, 140, 0.005)],
)  # fmt: skip
def test_the_radius_keeps_the_phase_error_at_any_range(distance_m, ghz, radius_m):
    at_range = Scene(*plate(0.05, distance_m), 0.5)
    band = clradar.Waveform.sfcw((ghz - 1) * 1e9, (ghz + 1) * 1e9, 3)
    chosen = SimulationSettings(rays_per_sample=1).for_scene(at_range, ARRAY, band)
    assert chosen.radius_m == pytest.approx(radius_m)
    given = SimulationSettings(estimator="stochastic", reception_radius_m=0.003)
    assert given.for_scene(at_range, ARRAY, band).radius_m == 0.003
    # Where the lobe is 3.6 radii wide both have the noise that they have at 0.12 and 0.3 m.
    least = 0.12 if radius_m == 0.01 else 3.6 * radius_m / distance_m
    for alpha, estimator in ((0.99 * least, None), (1.01 * least, "expected")):
        scene = at_range.with_alpha(alpha)
        assert SimulationSettings().for_scene(scene, ARRAY, band).estimator == estimator


def test_samples_of_large_scenes_are_as_many_as_can_be_paid_for():
    wide = SCENE.transformed(np.diag([100.0, 100.0, 100.0, 1.0]))
    imager = clradar.arrays.qar50()
    found = SimulationSettings().for_scene(wide, imager, WAVEFORM).resolved()
    assert found.estimator == "expected"
    area_mm2 = 5000.0**2
    assert found.samples_per_mm2 * area_mm2 * 94 * 94 == pytest.approx(2e10, rel=0.05)
    assert found.samples_per_mm2 * found.rays_per_sample == pytest.approx(40)  # the same scale
    few = SimulationSettings(estimator="expected", samples_per_mm2=1.0)
    assert few.for_scene(wide, imager, WAVEFORM) == few
