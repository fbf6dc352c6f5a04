"""Faces that are too coarse for the curved surface that they stand for."""

import warnings
from functools import cache

import numpy as np
import pytest
import trimesh

import clradar
from clradar import ClradarWarning, Scene, SimulationSettings, reference
from clradar.geometry.normals import corner_normals
from clradar.hand import HandMesh, hand_mesh
from clradar.tracing.facets import curved_error_m, facet_sagitta_m, warn_of_coarse_facets

HIGHEST_HZ = 82e9
WAVELENGTH_M = 299_792_458 / HIGHEST_HZ


def remarks(mesh: trimesh.Trimesh | Scene, hz: float = HIGHEST_HZ, **fields: object) -> list[str]:
    scene = mesh if isinstance(mesh, Scene) else Scene.from_mesh(mesh)
    settings = SimulationSettings(**fields).resolved()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_coarse_facets("simulate", scene, settings, hz)
    assert all(issubclass(one.category, ClradarWarning) for one in caught)
    return [str(one.message) for one in caught]


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


@cache
def hand() -> HandMesh:
    return hand_mesh("V", edge_length_m=4e-3)


def test_the_embedded_hand_is_fine_enough():
    for facets in ("curved", "flat"):
        assert remarks(Scene.from_mesh(hand()), facets=facets) == []


def merged_hand(cell_m: float) -> Scene:
    """Vertices of one cell merged into one, as decimation leaves them."""
    mesh = hand()
    _, cell = np.unique(np.floor(mesh.vertices_m / cell_m).astype(int), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    vertices = np.stack([np.bincount(cell, weights=axis) for axis in mesh.vertices_m.T], axis=1)
    faces = cell[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return Scene(vertices / np.bincount(cell)[:, None], faces, 0.5)


def test_a_hand_of_a_thousand_vertices_is_not():
    coarse = merged_hand(7e-3)
    assert 1500 < coarse.n_faces < 2500
    assert len(remarks(coarse, facets="flat", crease_deg=180.0)) == 1
    (remark,) = remarks(coarse)
    assert "edges of less than 70 degrees that stay sharp, beyond crease_deg=30" in remark
    assert "take crease_deg=180 or a finer mesh" in remark
    assert remarks(merged_hand(6e-3), crease_deg=180.0) == []
    assert remarks(coarse, normals="face") == []


def test_simulations_warn_at_their_highest_frequency():
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
    scene = Scene.from_mesh(mesh.apply_translation([0, 0, 0.3]), alpha=0.5)
    imager = clradar.arrays.qar50()
    array = clradar.AntennaArray(imager.tx_m[::30], imager.rx_m[::30])
    few = {"samples_per_mm2": 0.01, "estimator": "expected", "device": "pocl", "facets": "flat"}
    with pytest.warns(ClradarWarning, match=r"^simulate: 100 % .*at 82 GHz") as caught:
        clradar.simulate(scene, array, clradar.Waveform.sfcw(72e9, 82e9, 4), **few)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    clradar.simulate(scene, array, clradar.Waveform.sfcw(5e9, 6e9, 4), **few)
