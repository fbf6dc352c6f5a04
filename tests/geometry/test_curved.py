"""Curved points of faces, as the reference has them, against arcs and balls."""

import numpy as np
import pytest
from shapes import box, random_soup, sphere

import clradar
from clradar import reference
from clradar.geometry.curved import corner_heights
from clradar.geometry.normals import corner_normals


def drawn(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles of 1 to 30 mm, unit normals that have nothing to do with them, and weights."""
    vertices, faces = random_soup(rng, n, 0.03)
    normals = rng.normal(size=(n, 3, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return vertices[faces], normals, rng.dirichlet(np.ones(3), n)


def test_offsets_stay_within_the_face():
    """At most a third of the longest edge times the sine of the largest tilt, whatever normals."""
    triangles_m, normals, weight = drawn(np.random.default_rng(4), 20_000)
    edges = np.roll(triangles_m, -1, axis=1) - triangles_m
    across = np.cross(edges[:, 0], edges[:, 1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cosine = np.abs(np.einsum("fka,fa->fk", normals, across)).min(axis=1)
    bound_m = np.linalg.norm(edges, axis=2).max(axis=1) * np.sqrt(1 - cosine**2) / 3
    flat = np.einsum("sk,ska->sa", weight, triangles_m)
    offset = np.linalg.norm(reference.curved_points(triangles_m, normals, weight) - flat, axis=1)
    assert (offset <= bound_m * (1 + 1e-12)).all()
    assert (offset / bound_m).max() > 0.5


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


def test_points_of_a_ball_are_closer_by_the_square_of_the_angle():
    """Normals of the ball itself; all that is left over is of fourth order."""
    centre, radius_m = np.array([0.0, 0.0, 0.3]), 0.05
    rng = np.random.default_rng(5)
    left = []
    for subdivisions in (1, 2, 3):
        vertices, faces = sphere((0, 0, 0.3), radius_m, subdivisions)
        face = rng.integers(len(faces), size=2000)
        triangles_m = vertices[faces[face]]
        normals = (triangles_m - centre) / radius_m
        weight = rng.dirichlet(np.ones(3), len(face))
        points = reference.curved_points(triangles_m, normals, weight)
        left.append(np.abs(np.linalg.norm(points - centre, axis=1) - radius_m).max())
    assert left[0] < 1e-3
    assert left[1] < left[0] / 12
    assert left[2] < left[1] / 12


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
