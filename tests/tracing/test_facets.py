"""Faces that are too coarse for the curved surface that they stand for."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh

import clradar
from clradar import ClradarWarning, Scene, SimulationSettings
from clradar.geometry.normals import corner_normals
from clradar.hand import hand_mesh
from clradar.tracing.facets import facet_sagitta_m, warn_of_coarse_facets

HIGHEST_HZ = 82e9
WAVELENGTH_M = 299_792_458 / HIGHEST_HZ


def remarks(mesh: trimesh.Trimesh | Scene, hz: float = HIGHEST_HZ, **fields: object) -> list[str]:
    scene = mesh if isinstance(mesh, Scene) else Scene.from_mesh(mesh)
    settings = SimulationSettings(**fields).resolved()  # type: ignore[arg-type]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_coarse_facets("simulate", scene, settings, hz)
    assert all(issubclass(one.category, ClradarWarning) for one in caught)
    return [str(one.message) for one in caught]


def cylinder(radius_m: float, sections: int) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius_m, 0.1, sections=sections)


def test_sagitta_of_a_sphere_is_that_of_its_chords() -> None:
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


@pytest.mark.parametrize("radius_m", [0.02, 0.05, 0.1])
def test_the_limit_is_an_eighth_of_the_wavelength(radius_m: float) -> None:
    """Cylinders: flat along the axis, chords of R (1 - cos(pi / n)) around it."""
    sections = np.arange(13, 100)  # fewer have edges of more than crease_deg
    sagitta_m = radius_m * (1 - np.cos(np.pi / sections))
    enough = int(sections[np.argmax(sagitta_m < 0.9 * WAVELENGTH_M / 8)])
    assert remarks(cylinder(radius_m, enough)) == []
    if enough > 14:
        too_few = int(sections[np.argmax(sagitta_m < 1.1 * WAVELENGTH_M / 8) - 1])
        (remark,) = remarks(cylinder(radius_m, too_few))
        assert "times shorter, or normals='face'" in remark
        assert remarks(cylinder(radius_m, too_few), hz=HIGHEST_HZ / 4) == []


def test_flat_sides_are_not_coarse_however_large() -> None:
    assert remarks(trimesh.creation.box([0.2, 0.3, 0.02])) == []
    corners = [[-0.1, -0.1, 0.3], [0.1, -0.1, 0.3], [0.1, 0.1, 0.3], [-0.1, 0.1, 0.3]]
    assert remarks(Scene(corners, [[0, 1, 2], [0, 2, 3]], 0.5)) == []
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.05)
    assert remarks(ball, normals="face") == []
    (remark,) = remarks(ball)
    assert remark.startswith("simulate: 100 % of the surface are faces too coarse")


@pytest.mark.parametrize("pose", ["F", "flat"])
def test_the_embedded_hand_is_fine_enough(pose: str) -> None:
    assert remarks(Scene.from_mesh(hand_mesh(pose, edge_length_m=4e-3))) == []


def test_a_hand_of_a_thousand_vertices_is_not() -> None:
    """Vertices of one cell merged into one, as decimation leaves them."""
    mesh = hand_mesh("F", edge_length_m=4e-3)
    _, cell = np.unique(np.floor(mesh.vertices_m / 7e-3).astype(int), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    vertices = np.stack([np.bincount(cell, weights=axis) for axis in mesh.vertices_m.T], axis=1)
    faces = cell[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    hand = Scene(vertices / np.bincount(cell)[:, None], faces, 0.5)
    assert 900 < hand.vertices_m.shape[0] < 1300
    assert len(remarks(hand)) == 1


def test_simulations_warn_at_their_highest_frequency() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
    scene = Scene.from_mesh(mesh.apply_translation([0, 0, 0.3]), alpha=0.5)
    imager = clradar.arrays.qar50()
    array = clradar.AntennaArray(imager.tx_m[::30], imager.rx_m[::30])
    few = {"samples_per_mm2": 0.01, "estimator": "expected", "device": "pocl"}
    with pytest.warns(ClradarWarning, match=r"^simulate: 100 % .*at 82 GHz") as caught:
        clradar.simulate(scene, array, clradar.Waveform.sfcw(72e9, 82e9, 4), **few)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    clradar.simulate(scene, array, clradar.Waveform.sfcw(5e9, 6e9, 4), **few)
