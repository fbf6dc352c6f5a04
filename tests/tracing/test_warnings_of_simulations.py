"""Simulations that are probably not as intended say so and no others; faces that are too coarse."""

import re
from typing import Any

import numpy as np
import pytest
import trimesh
from comparisons import warnings_of

import clradar
from clradar import AntennaArray, ClradarWarning, Scene, SimulationSettings, Waveform, reference
from clradar.arrays import qar50
from clradar.errors import ModelError
from clradar.geometry.normals import corner_normals
from clradar.hand import hand_mesh
from clradar.simulation import simulate_alphas
from clradar.tracing.facets import curved_error_m, facet_sagitta_m, warn_of_coarse_facets
from clradar.tracing.placement import doubtful
from clradar.tracing.settings import resolve_settings
from clradar.tracing.starvation import warn_if_starved

IMAGER = qar50()
ARRAY = AntennaArray(IMAGER.tx_m[::12], IMAGER.rx_m[::12])
WAVEFORM = Waveform([5e9])
"""For which the faces of the balls are fine enough."""


def ball(radius_m: float, away_m: float, alpha: float) -> Scene:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_m)
    return Scene.from_mesh(mesh.apply_translation([0, 0, away_m]), alpha=alpha)


def simulated(scene: Scene, device: Any, **settings: Any) -> np.ndarray:
    """With the radius of 77 GHz, unless another is given: that of 5 GHz would be 40 mm."""
    settings = {"reception_radius_m": 0.01, **settings}
    return clradar.simulate(scene, ARRAY, WAVEFORM, device=device, **settings).data


def front_of_ball(radius_m: float, away_m: float) -> Scene:
    """What the antennas see of it."""
    whole = ball(radius_m, away_m, 0.3)
    seen = whole.triangles_m[:, :, 2].max(axis=1) < away_m
    return Scene(whole.vertices_m, whole.faces[seen], 0.3)


FAR = front_of_ball(0.9, 7.9)
"""About as large and as far away as a car at 7 m."""

SPARSE = {"samples_per_mm2": 0.02, "estimator": "stochastic"}


@pytest.fixture(scope="module")
def starved(device: clradar.Device) -> tuple[np.ndarray, str]:
    """A starved capture, and what the warning says."""
    with pytest.warns(ClradarWarning) as caught:
        data = simulated(FAR, device, **SPARSE)
    assert caught[0].filename == __file__
    assert len(caught) == 1
    return data, str(caught[0].message)


def test_a_starved_simulation_says_how_much_of_it_is_zero(starved):
    data, text = starved
    zeros = float(np.mean(data == 0))
    assert 0.7 < zeros < 0.97
    assert text.startswith(f"{100 * zeros:.0f} % of the {data.size} pairs of antennas received no")
    assert "samples_per_mm2=" in text
    assert "estimator='expected'" in text
    assert "reception_radius_m=0.05 (now 0.01), which at 7.4 m has the phase error of" in text


def advised(text: str) -> list[dict[str, float]]:
    """The settings of each alternative in a warning."""
    found = [dict(re.findall(r"(\w+)=([\d.e+]+)", part)) for part in text.split(", or ")]
    return [{field: float(value) for field, value in one.items()} for one in found if one]


def test_a_larger_radius_or_the_expected_estimator_ends_it(starved, device):
    denser, larger = advised(starved[1])
    assert larger["samples_per_mm2"] < 0.1 * denser["samples_per_mm2"]
    for changed in (larger, {"estimator": "expected", "samples_per_mm2": 2e-3}):
        assert np.mean(simulated(FAR, device, **{**SPARSE, **changed}) == 0) < 0.1


def test_few_samples_of_a_mirror_are_few_however_many_rays_they_have(device):
    with pytest.warns(ClradarWarning, match="received no ray") as caught:
        simulated(ball(0.02, 0.3, 0.0), device, samples_per_mm2=0.5, rays_per_sample=64)
    assert "expected" not in str(caught[0].message)  # there is nothing random in its directions


@pytest.mark.parametrize("estimator", ["stochastic", "expected"])
def test_receivers_that_a_small_mirror_does_not_reach_are_no_shortage(estimator, device):
    mesh = trimesh.creation.box(extents=(0.02, 0.02, 0.001)).apply_translation([0, 0, 0.3])
    data = simulated(Scene.from_mesh(mesh, alpha=0.0), device, estimator=estimator)
    assert np.mean(data == 0) > 0.5


@pytest.mark.parametrize(
    ("empty", "each", "warned"), [(9, 2, False), (11, 2, True), (11, 19, True), (11, 21, False)]
)
def test_a_tenth_of_the_pairs_may_be_empty_or_the_others_have_twenty_paths(empty, each, warned):
    paths = np.full(100, each)
    paths[:empty] = 0
    settings = resolve_settings(estimator="stochastic", rays_per_sample=1)
    found = warnings_of(warn_if_starved, paths, ball(0.02, 0.3, 0.5), ARRAY, settings)
    assert len(found) == warned


def test_more_rays_per_face_are_advised_unless_more_samples_do_not_help():
    settings = resolve_settings(estimator="stochastic", rays_per_face=1)
    near, across = (ball(0.04, away_m, 0.3) for away_m in (0.3, 0.0))
    (text,) = warnings_of(warn_if_starved, np.arange(100) // 50, near, ARRAY, settings)
    # Of what reaches behind the aperture that is said.
    assert not warnings_of(warn_if_starved, np.arange(100) // 50, across, ARRAY, settings)
    assert [list(one) for one in advised(text)] == [["rays_per_face"]]


def test_vertices_without_a_face_are_nowhere(device):
    scene = ball(0.02, 0.3, 1.0)
    with_stray = np.concatenate([scene.vertices_m, [[1e308, 0, -1e308]]])
    clradar.trace(Scene(with_stray, scene.faces, 1.0), ARRAY, samples_per_mm2=1, device=device)


def test_a_capture_without_any_path_says_so(device):
    with pytest.warns(ClradarWarning, match="no ray reached a receiver"):
        data = simulated(ball(0.02, 0.3, 0.5), device, samples_per_mm2=1e-308)
    assert not data.any()


@pytest.mark.parametrize(("away_m", "word"), [(-0.3, "lies"), (0.0, "reaches")])
def test_a_scene_behind_the_antennas_is_warned_of(away_m, word, device):
    scene = ball(0.02, away_m, 1.0)
    for call in (
        lambda: clradar.trace(scene, ARRAY, samples_per_mm2=5, device=device),
        lambda: simulated(scene, device, samples_per_mm2=5),
        lambda: simulate_alphas(scene, ARRAY, WAVEFORM, [1.0], device=device),
    ):
        with pytest.warns(ClradarWarning, match=f"the scene {word} behind the aperture"):
            call()


def test_antennas_around_a_scene_have_no_side_behind_them(device):
    around = AntennaArray([[0, 0, -0.3], [0, 0, 0.3]], [[0, 0.01, -0.3], [0, 0.01, 0.3]])
    clradar.trace(ball(0.02, 0.0, 1.0), around, samples_per_mm2=1, device=device)


@pytest.mark.parametrize(
    ("scale", "away_m", "text"),
    [
        (1e3, 300.0, r"a size of at most 20 m, got 40 m; did you mean 40 mm \(0.04 m\)"),
        (1.0, 300.0, r"farthest point .* 300.02 m; did you mean 300.02 mm"),
    ],
)
def test_a_scene_in_millimetres_is_refused(scale, away_m, text, device):
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    scene = Scene(mesh.vertices * scale + [0, 0, away_m], mesh.faces)
    with pytest.raises(ModelError, match=text):
        simulated(scene, device)


@pytest.mark.parametrize(
    ("size_m", "away_m", "text"),
    [
        (0.021, 0.03, "21 mm large and 30.* 210 mm at 30. mm if in cm, not mm"),
        (0.0072, 0.0118, "7.2 mm large and 1.* 183 mm at 3.. mm if in inch, not mm"),
        (7.3, 11.8, "7.3 m large and 11.8 m .* 185 mm at 300 mm if in inch, not m,"),
        (4e-5, 3e-4, "0.04 mm large and .* if in m, not mm"),
        (0.186, 0.094, None),
        (4.5, 7.0, None),
    ],
)
def test_a_scene_in_another_unit_is_warned_of_with_what_it_would_be(size_m, away_m, text):
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=size_m / 2)
    doubt = doubtful(Scene(mesh.vertices + np.array([0, 0, away_m]), mesh.faces), ARRAY)
    assert (doubt is None) == (text is None)
    assert doubt is None or (re.search(text, doubt) and len(doubt) < 300)


@pytest.mark.parametrize(("open_deg", "warned"), [(90.0, True), (120.0, False)], ids=str)
def test_corners_are_warned_of_by_the_estimator_of_one_reflection(open_deg, warned, device):
    """Two squares of 30 mm at an angle: two reflections lead back from a right one alone."""
    half = np.radians(open_deg / 2)
    x, z = 0.03 * np.sin(half), 0.03 * np.cos(half)
    corners = [[s * x, y, 0.3 - abs(s) * z] for s in (0, -1, 1) for y in (-0.015, 0.015)]
    scene = Scene(corners, [[0, 1, 2], [1, 3, 2], [0, 4, 1], [1, 4, 5]])
    settings = {"reception_radius_m": None, "estimator": "physical"}
    found = warnings_of(simulated, scene, device, **settings)
    assert ["face each other" in text for text in found] == [True] * warned


HIGHEST_HZ = 82e9
WAVELENGTH_M = 299_792_458 / HIGHEST_HZ


def remarks(mesh: trimesh.Trimesh | Scene, hz: float = HIGHEST_HZ, **fields: object) -> list[str]:
    scene = mesh if isinstance(mesh, Scene) else Scene.from_mesh(mesh)
    settings = SimulationSettings(**fields).resolved()
    return warnings_of(warn_of_coarse_facets, "simulate", scene, settings, hz)


def cylinder(radius_m: float, sections: int) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius_m, 0.1, sections=sections)


def test_sagitta_of_a_sphere_is_that_of_its_chords():
    radius_m = 0.04
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius_m)
    exact = mesh.triangles / radius_m
    longest = np.linalg.norm(np.roll(mesh.triangles, -1, axis=1) - mesh.triangles, axis=2).max(1)
    expected = longest**2 / (8 * radius_m)  # e^2 / R of normals p / R
    np.testing.assert_allclose(facet_sagitta_m(mesh.triangles, exact), expected, rtol=1e-12)
    # An arc of that chord: R - sqrt(R^2 - e^2 / 4).
    arc = radius_m - np.sqrt(radius_m**2 - longest**2 / 4)
    np.testing.assert_allclose(expected, arc, rtol=0.01)
    found, _ = corner_normals(Scene.from_mesh(mesh), "smooth", 30.0)
    np.testing.assert_allclose(facet_sagitta_m(mesh.triangles, found), expected, rtol=0.1)


def test_balls_are_warned_of_where_curved_points_are_off_by_an_eighth_of_the_wavelength():
    """Icospheres of 80 faces whose edges are 0.58 radii: 0.6 % of the radius is left."""
    for radius_m, expected in ((0.12, 0), (0.24, 1)):
        ball = trimesh.creation.icosphere(subdivisions=1, radius=radius_m)
        scene = Scene.from_mesh(ball)
        normals, _ = corner_normals(scene, "smooth", 30.0)
        off_m = curved_error_m(scene.triangles_m, normals)
        assert (off_m.max() > WAVELENGTH_M / 8) == bool(expected)
        assert len(remarks(ball)) == expected
        weight = np.full((scene.n_faces, 3), [0.5, 0.5, 0.0])
        middle = reference.curved_points(scene.triangles_m, normals, weight)
        left_m = np.abs(np.linalg.norm(middle, axis=1) - radius_m).max()
        assert 0.7 * left_m < off_m.max() < left_m


def test_flat_sides_are_not_coarse_however_large():
    assert remarks(trimesh.creation.box([0.2, 0.3, 0.02])) == []
    corners = [[-0.1, -0.1, 0.3], [0.1, -0.1, 0.3], [0.1, 0.1, 0.3], [-0.1, 0.1, 0.3]]
    assert remarks(Scene(corners, [[0, 1, 2], [0, 2, 3]], 0.5)) == []
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.05)
    assert remarks(ball) == []
    (remark,) = remarks(ball, facets="flat")
    assert remark.startswith("simulate: 100 % of the surface are faces too coarse")


def test_the_embedded_hand_is_fine_enough():
    hand = Scene.from_mesh(hand_mesh("V", edge_length_m=4e-3))
    for facets in ("curved", "flat"):
        assert remarks(hand, facets=facets) == []


def test_edges_of_a_coarse_round_body_that_stay_sharp_are_remarked():
    """An icosahedron's, of 42 degrees."""
    coarse = trimesh.creation.icosphere(subdivisions=0, radius=0.02)
    (remark,) = remarks(coarse)
    assert "edges of less than 70 degrees that stay sharp, beyond crease_deg=30" in remark
    assert "take crease_deg=180 or a finer mesh" in remark
    (remark,) = remarks(coarse, crease_deg=180.0, facets="flat")
    assert "faces too coarse for the curve that they stand for" in remark
    assert remarks(coarse, normals="face") == []


def test_simulations_warn_at_their_highest_frequency():
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
    scene = Scene.from_mesh(mesh.apply_translation([0, 0, 0.3]), alpha=0.5)
    few = {"samples_per_mm2": 0.01, "estimator": "expected", "facets": "flat"}
    high, low = Waveform.sfcw(72e9, 82e9, 4), Waveform.sfcw(5e9, 6e9, 4)
    _, remark = warnings_of(clradar.simulate, scene, ARRAY, high, **few)  # and of its lobes
    assert re.match("simulate: 100 % .*at 82 GHz", remark)
    assert warnings_of(clradar.simulate, scene, ARRAY, low, **few) == []
