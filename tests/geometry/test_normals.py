"""Normals at the corners of faces against a plain implementation and closed forms."""

import numpy as np
import pytest
from shapes import bowl, box, dihedral, plate, sphere, with_degenerate

from clradar import Scene, reference
from clradar.geometry.normals import corner_normals

ROUNDING = 1e-12
"""Float64 sums of a dozen unit vectors times angles, with arcs taken by two different formulas
whose own rounding near 0 and pi is 1e-8 at worst for needles; these meshes have none."""

MESHES = {
    "waves": plate(0.2, 0.3, 7, wavy_m=0.02),
    "box": box((0, 0, 0.3), (0.1, 0.2, 0.1)),
    "bowl": bowl(),
    "dihedral": dihedral(0.2, 0.4),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("crease_deg", [0.0, 60.0, 180.0])
def test_smooth_normals_are_those_of_the_reference(name, crease_deg):
    scene = Scene(*MESHES[name])
    got, faces = corner_normals(scene, "smooth", crease_deg)
    expected = reference.smooth_normals(scene, crease_deg)
    np.testing.assert_allclose(got, expected, rtol=0, atol=ROUNDING)
    e = scene.triangles_m - scene.triangles_m[:, :1]
    cross = np.cross(e[:, 1], e[:, 2])
    expected = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    np.testing.assert_allclose(faces, expected, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(("fold_deg", "smooth"), [(29.9, True), (30.1, False)])
def test_the_crease_angle_decides(fold_deg, smooth):
    a = np.radians(fold_deg)
    vertices = [[0, 0, 0], [0, 1, 0], [-1, 0, 0], [np.cos(a), 0, np.sin(a)]]
    corners, faces = corner_normals(Scene(vertices, [[0, 1, 2], [0, 3, 1]]))
    assert np.degrees(np.arccos(faces[0] @ faces[1])) == pytest.approx(fold_deg)
    if smooth:
        middle = (faces[0] + faces[1]) / np.linalg.norm(faces[0] + faces[1])
        np.testing.assert_allclose(corners[0, :2], [middle, middle], atol=ROUNDING)
        np.testing.assert_allclose(corners[1, [0, 2]], [middle, middle], atol=ROUNDING)
    else:
        np.testing.assert_allclose(corners, np.repeat(faces[:, None], 3, axis=1), atol=ROUNDING)


def test_vertices_at_the_same_place_count_as_one():
    """As in STL files, where every face has its own."""
    vertices, faces = MESHES["waves"]
    apart = Scene(vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    np.testing.assert_allclose(
        corner_normals(apart)[0], corner_normals(Scene(vertices, faces))[0], atol=ROUNDING
    )


def test_degenerate_faces_have_no_normal_and_change_none():
    rng = np.random.default_rng(1)
    vertices, faces = bowl()
    expected = corner_normals(Scene(vertices, faces))[0]
    point = np.repeat(rng.integers(0, len(vertices), 4), 3).reshape(-1, 3)
    line = faces[rng.integers(0, len(faces), 4)][:, [0, 1, 1]]
    corners, flat = corner_normals(Scene(vertices, np.concatenate([point, faces, line])))
    n = len(faces)
    np.testing.assert_allclose(corners[4 : 4 + n], expected, atol=ROUNDING)
    assert (flat[:4] == 0).all()
    assert (flat[4 + n :] == 0).all()
    assert (corners[:4] == 0).all()


@pytest.mark.parametrize(
    "mesh",
    [
        with_degenerate(np.random.default_rng(2), bowl()),
        (np.zeros((3, 3)), np.array([[0, 1, 2]])),
    ],
)
def test_normals_are_unit_or_zero(mesh):
    corners, faces = corner_normals(Scene(*mesh), "smooth", 30.0)
    for normals in (corners, faces):
        norm = np.linalg.norm(normals, axis=-1)
        assert (np.isclose(norm, 1, atol=ROUNDING) | (norm == 0)).all()
    assert (np.linalg.norm(corners, axis=2).min(axis=1) > 0).sum() >= (faces != 0).any(axis=1).sum()


def test_three_faces_at_one_edge():
    """A T of three plates: two of them lie in one plane and stay smooth, the third stays apart."""
    vertices = [[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [1, 0.5, 0], [0, 0.5, 1]]
    corners, faces = corner_normals(Scene(vertices, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    np.testing.assert_allclose(corners, np.repeat(faces[:, None], 3, axis=1), atol=ROUNDING)


def test_known_normals_are_used_where_they_fit_the_face():
    vertices, faces = sphere((0, 0, 0.3), 0.05, 1)
    exact = (vertices - [0, 0, 0.3]) / 0.05
    found = corner_normals(Scene(vertices, faces))[0]
    sense = np.where(np.arange(len(vertices)) % 2, -1.0, 1.0)[:, None]
    known = exact * sense  # of either sense
    known[3] = 0.0
    tilted = np.cross(exact[5], [0.3, 0.4, 0.5])
    known[5] = tilted / np.linalg.norm(tilted)  # 90 degrees off
    corners = corner_normals(Scene(vertices, faces, normals=known))[0]
    other = np.isin(faces, (3, 5))
    np.testing.assert_array_equal(corners[other], found[other])
    np.testing.assert_allclose(corners[~other], exact[faces][~other], atol=1e-12)
    flat = corner_normals(Scene(vertices, faces, normals=known), "face")[0]
    np.testing.assert_array_equal(flat, corner_normals(Scene(vertices, faces), "face")[0])
