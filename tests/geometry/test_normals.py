"""Normals at the corners of faces, and curved points by them, against closed forms."""

import numpy as np
import pytest
from shapes import bowl, box, dihedral, plate, sphere

import clradar
from clradar import Scene, reference
from clradar.geometry.curved import corner_heights
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


@pytest.mark.parametrize("turn_deg", [2.0, 20.0])
def test_arcs_are_met_to_fourth_order(turn_deg):
    """The middle of a strip of a cylinder: R (1 - cos t) off the chord, t half of the turn.

    The offset there is R sin^2 t cos t / 2, which is less by 3 R t^4 / 8 in the limit.
    """
    radius_m, t = 0.05, np.radians(turn_deg) / 2
    angle = np.array([-t, t, t])
    normals = np.stack([np.sin(angle), np.zeros(3), np.cos(angle)], axis=1)[None]
    triangle_m = radius_m * normals + np.array([[[0, 0, 0], [0, 0, 0], [0, 0.01, 0]]])
    middle = reference.curved_points(triangle_m, normals, np.array([[0.5, 0.5, 0.0]]))[0]
    missing_m = radius_m - middle[2]
    assert missing_m == pytest.approx(3 * radius_m * t**4 / 8, rel=1.5 * t**2)


def test_flat_sides_have_no_offset_at_all():
    """Neither turned boxes nor those whose corners were rounded to float32."""
    vertices, faces = box((0, 0, 0), (0.1, 0.05, 0.07))
    turn, _ = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))
    for corners in (vertices @ turn, (vertices @ turn + 0.3).astype(np.float32).astype(float)):
        scene = clradar.Scene(corners, faces)
        assert (corner_heights(scene.triangles_m, corner_normals(scene)[0]) == 0).all()


def test_faces_without_area_have_no_offset():
    corners = np.array([[[0.1, 0.0, 0.3]] * 3, [[0, 0, 0.3], [0.1, 0, 0.3], [0.2, 0, 0.3]]])
    scene = clradar.Scene(corners.reshape(-1, 3), np.arange(6).reshape(2, 3))
    normals, _ = corner_normals(scene)
    assert (corner_heights(scene.triangles_m, normals) == 0).all()
