"""Quadrature points of the physical estimator: where they are, what they see, their roughness."""

import warnings

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from truths import measured
from truths.measured import lit_points

import clradar
from clradar.errors import MeshError, ModelError
from clradar.reference import kirchhoff as reference
from clradar.tracing.height_field import mended_texture
from clradar.tracing.pieces import pieces_of

AROUND = clradar.AntennaArray(0.5 * np.vstack([np.eye(3), -np.eye(3)]), [[0.5, 0.0, 0.001]])
"""Every point of a convex body at the origin is seen by some Tx."""

ROUGH = clradar.Material(
    "rough", conductor=True, roughness_rms_m=0.15e-3, correlation_length_m=2e-3
)


def ball(subdivisions: int, radius_m: float = 0.02) -> clradar.Scene:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m)
    return clradar.Scene.from_mesh(mesh)


@pytest.mark.parametrize(
    "corners_mm",
    [
        [[0, 0, 0], [100, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [100, 0, 0], [50, 0.01, 0]],
        [[0, 0, 0], [0.4, 0, 0], [0, 0.5, 0]],
        [[0, 0, 0], [1, 0, 0], [0.5, 0.866, 0]],  # 1.3 points of the density along its root
    ],
)
def test_pieces_are_dense_in_both_directions(corners_mm):
    triangle_m = 1e-3 * np.array([corners_mm])
    pieces = pieces_of(triangle_m, 4.0)
    edges = np.roll(pieces.corners.astype(float), -1, axis=1) - pieces.corners
    share = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
    assert 2 * share.sum() == pytest.approx(1.0, rel=1e-6)  # of the unit triangle
    centroid = share @ pieces.corners.astype(float).mean(axis=1) / share.sum()
    assert centroid == pytest.approx(1 / 3, abs=1e-6)  # none twice, and none missing
    edges_m = edges @ (triangle_m[0, 1:] - triangle_m[0, 0])
    longest_m = np.linalg.norm(edges_m, axis=2).max(axis=1)
    assert (longest_m / pieces.edge_points).max() <= 2.1 * 0.5e-3 * (1 + 1e-6)
    area_mm2 = 1e6 * np.linalg.norm(np.cross(*np.diff(triangle_m[0], axis=0))) / 2
    assert pieces.n_points >= 4.0 * area_mm2 / 1.25
    assert pieces.n_points == (pieces.edge_points.astype(int) ** 2).sum()


def test_scenes_without_area_or_with_too_many_points_are_refused():
    with pytest.raises(MeshError, match="only degenerate faces"):
        pieces_of(np.zeros((1, 3, 3)), 4.0)
    with pytest.raises(MeshError, match="fewer than 2\\^31 samples"):
        pieces_of(np.array([[[0.0, 0, 0], [40, 0, 0], [0, 40, 0]]]), 4.0)


def test_points_of_a_rough_ball_are_those_of_the_reference():
    """To the float32 of positions of 20 mm and of the waves: 4e-5 rad of K q."""
    scene = ball(2, 0.006).with_material(ROUGH)
    lit = lit_points(scene, AROUND, seed=5)
    pieces = pieces_of(scene.triangles_m, 4.0)
    smooth = reference.quadrature(scene, pieces.edge_points)
    want = reference.roughened(smooth, 0.15e-3, 2e-3, 5, ROUGH.name)
    assert len(lit.sample) > 0.4 * pieces.n_points
    # The reference has its points of a face in another order.
    at = cKDTree(want.point_m).query(lit.position_m)[1]
    assert len(set(at)) == len(at)
    assert np.abs(lit.position_m - want.point_m[at]).max() < 2e-8
    outward = np.sign(np.einsum("pa,pa->p", smooth.normal, smooth.point_m))[at]
    assert np.abs(lit.area_m2 - outward[:, None] * want.area_m2[at]).max() < 1e-4 * np.median(
        np.linalg.norm(want.area_m2, axis=1)
    )


def test_curved_points_make_the_area_of_a_sphere():
    """Of 320 faces, which turn by 2 b = 0.32 rad from corner to corner: 1.9 % too small if flat."""
    whole = clradar.AntennaArray(AROUND.tx_m, AROUND.tx_m)
    radius_m = 0.02
    for facets, area, deepest in (("curved", -6e-4, -1.4e-3), ("flat", -1.9e-2, -1.8e-2)):
        lit = lit_points(ball(2, radius_m), whole, facets=facets)
        single = np.unique(lit.sample, return_index=True)[1]
        found_m2 = np.linalg.norm(lit.area_m2[single], axis=1).sum()
        assert len(single) == pieces_of(ball(2, radius_m).triangles_m, 4.0).n_points
        assert found_m2 / (4 * np.pi * radius_m**2) - 1 == pytest.approx(area, rel=0.1)
        away = np.linalg.norm(lit.position_m, axis=1) / radius_m - 1
        assert away.min() == pytest.approx(deepest, rel=0.1)


def test_texture_moves_with_the_body():
    scene = ball(2).with_material(ROUGH)
    move = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    move[:3, 3] = [0.01, -0.02, 0.005]
    whole = clradar.AntennaArray(AROUND.tx_m, AROUND.tx_m)
    one, two = (lit_points(s, whole, seed=1) for s in (scene, scene.transformed(move)))
    _, i, j = np.intersect1d(one.sample, two.sample, return_indices=True)
    assert len(i) > 0.99 * len(one.sample)
    moved_m = one.position_m[i] @ move[:3, :3].T + move[:3, 3]
    assert np.abs(two.position_m[j] - moved_m).max() < 3e-8


@pytest.mark.parametrize(("longer", "torn"), [(1.95, False), (2.05, True), (50.0, True)])
def test_texture_of_torn_faces_is_not_stretched(longer, torn):
    triangles_m = 1e-3 * np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 2)
    texture_m = triangles_m + 0.01
    texture_m[1] += [[0, 0, 0], [0, 0, 0], [0, 1e-3 * (longer - 1), 0]]
    mended = mended_texture(triangles_m, texture_m)
    assert np.array_equal(mended[0], texture_m[0])
    if not torn:
        assert np.array_equal(mended, texture_m)
        return
    edges = [np.linalg.norm(np.roll(c, -1, 1) - c, axis=2) for c in (mended, triangles_m)]
    assert edges[0] == pytest.approx(edges[1], rel=1e-9)


def test_a_curved_face_that_folds_back_is_seen_from_the_side_of_its_flat_one():
    """By normals 50 degrees off it: in a sixth of its points the derivatives turn round."""
    corners_m = 1e-3 * np.array([[16.0, 10, 0], [20, 18, 0], [2, 2, 0]])
    normals = np.array([[-0.05, 0.8, 0.6], [0.79, -0.03, 0.61], [-0.25, 0.71, 0.65]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scene = clradar.Scene(corners_m, [[0, 1, 2]], normals=normals)
    above = [[0.0, 0.0, 4.0]]
    lit = lit_points(scene, clradar.AntennaArray(above, above), samples_per_mm2=10.0)
    np.testing.assert_array_equal(lit.sample, np.arange(len(lit.sample)))
    assert len(lit.sample) >= 10.0 * 40.0 / 1.25  # all of 40 mm^2


def test_antennas_on_both_sides_of_a_sheet():
    """What Tx and Rx see from different sides does not reflect; each side reflects alike."""
    scene = measured.plate((0.02, 0.02), 0.0)
    near, far = [0.0, 0, -0.3], [0.0, 0, 0.3]
    waveform = clradar.Waveform([77e9])

    def sample(tx: list[float], rx: list[float]) -> complex:
        array = clradar.AntennaArray([tx], [rx])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a scene behind antennas, and of no echo
            capture = clradar.simulate(scene, array, waveform, estimator="physical")
        return complex(capture.data[0, 0, 0])

    assert sample(near, far) == 0
    assert abs(sample(near, near)) > 0
    assert sample(far, far) == pytest.approx(sample(near, near), rel=1e-5)
    both = lit_points(scene, clradar.AntennaArray([near, far], [near, far]))
    assert len(both.sample) == 2 * len(np.unique(both.sample))


@pytest.mark.parametrize("at_m", [[0.003, 0.002, 0.2], [0.01, 0.01, 0.2], [0.01, 0.01, 0.2 - 1e-5]])
def test_an_antenna_on_the_surface_is_refused(at_m):
    with pytest.raises(ModelError, match=r"antennas at least 0[.]75 mm"):
        lit_points(measured.plate((0.02, 0.02), 0.2), clradar.AntennaArray([[0, 0, 0]], [at_m]))


def test_a_material_keeps_its_roughness_whatever_else_is_in_the_scene():
    own = ball(1, 0.006).with_material(ROUGH)
    aside = trimesh.transformations.translation_matrix([0.03, 0.03, 0.03])
    other = ball(1, 0.002).transformed(aside).with_material("palm")
    alone = lit_points(own, AROUND, seed=5)
    for scenes in ([own, other], [other, own]):
        both = clradar.Scene.combine(scenes)
        lit = lit_points(both, AROUND, seed=5)
        here = lit.position_m[lit.material == both.materials.index(ROUGH)]
        assert len(here) == len(alone.sample)
        # float32 relative to the middle of another scene; heights are 0.15 mm.
        assert cKDTree(here).query(alone.position_m)[0].max() < 2e-8
