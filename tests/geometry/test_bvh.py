"""The tree over the triangles: complete, tight enough, and of bounded depth."""

import numpy as np
import pytest
from shapes import bowl, box, plate, random_soup, sphere, with_degenerate

from clradar.geometry import bvh as module
from clradar.geometry.bvh import Bvh, build_bvh, face_normals, flatten


def triangles_of(mesh: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    vertices, faces = mesh
    return vertices[faces]


DELTA_M = 1e-6
"""Padding of the boxes; small against the meshes, large against the rounding of their corners."""


def check_flat(bvh: Bvh, triangles_m: np.ndarray) -> None:
    """Walk what the kernels read, as they do, and hold it against ``kernels/common/bvh.h``."""
    corners = np.asarray(triangles_m, dtype=np.float32)
    nodes, records, most_kept, _ = flatten(bvh, triangles_m, DELTA_M)
    assert nodes.dtype == records.dtype == np.float32
    assert nodes.shape[1:] == (64,)
    n_blocks = int(nodes.view(np.int32)[0, 56])
    assert records.shape == (n_blocks * 104,)
    blocks, faces = np.split(records, [n_blocks * 96])
    blocks, faces = blocks.reshape(n_blocks, 12, 8), faces.view(np.int32).reshape(n_blocks, 8)
    rows = nodes.reshape(-1, 8, 8)
    low, high = rows[:, 1:4].transpose(0, 2, 1), rows[:, 4:7].transpose(0, 2, 1)
    child = rows.view(np.int32)[:, 0]
    used = low[:, :, 0] <= high[:, :, 0]
    parents = np.bincount(child[used & (child >= 0)], minlength=len(nodes))
    assert parents[0] == 0
    assert (parents[1:] == 1).all()

    # The kernels' walk: all children of a node are put on the stack, and the last is taken next.
    most = 0
    waiting = [0]
    while waiting and len(nodes) < 1000:
        most = max(most, len(waiting))
        node = waiting.pop()
        if node >= 0:
            waiting += child[node][used[node]].tolist()
    assert most <= most_kept

    filled = faces >= 0
    assert (blocks.transpose(0, 2, 1)[~filled] == 0).all()
    np.testing.assert_array_equal(np.sort(faces[filled]), np.sort(bvh.order))
    of_leaf = -1 - child[used & (child < 0)]
    np.testing.assert_array_equal(np.sort(of_leaf), np.arange(len(of_leaf)))
    if not len(bvh.order):
        return
    assert len(of_leaf) == len(blocks)
    # Every box holds what is below it with DELTA_M to spare; a bound is rounded to nearest.
    spare_m = DELTA_M - 2.0**-24 * float(np.abs(corners).max() + DELTA_M)
    mine = np.where(filled[:, :, None, None], corners[faces], np.nan)
    block_low, block_high = np.nanmin(mine, axis=(1, 2)), np.nanmax(mine, axis=(1, 2))
    leaf = used & (child < 0)
    assert (low[leaf] <= block_low[of_leaf] - spare_m).all()
    assert (high[leaf] >= block_high[of_leaf] + spare_m).all()
    whole_low = np.where(used[:, :, None], low, np.inf).min(axis=1)
    whole_high = np.where(used[:, :, None], high, -np.inf).max(axis=1)
    inner = used & (child >= 0)
    assert (low[inner] <= whole_low[child[inner]]).all()
    assert (high[inner] >= whole_high[child[inner]]).all()


RNG = np.random.default_rng(20)
MESHES = {
    "one face": triangles_of(plate(0.1, 0.3))[:1],
    "two faces": triangles_of(plate(0.1, 0.3)),
    "three faces": triangles_of(bowl())[:3],
    "box": triangles_of(box((0, 0, 0.3), (0.1, 0.2, 0.3))),
    "plane": triangles_of(plate(0.2, 0.3, 37)),
    "sphere": triangles_of(sphere((0, 0, 0.3), 0.05, 4)),
    "bowl": triangles_of(bowl()),
    "soup": triangles_of(random_soup(RNG, 1009, 0.05)),
    "degenerate": triangles_of(with_degenerate(RNG, bowl())),
    "duplicates": np.repeat(triangles_of(bowl()), 7, axis=0),
}


@pytest.mark.parametrize("name", MESHES)
def test_every_face_is_in_one_leaf_and_in_its_boxes(name, device):
    bvh = build_bvh(MESHES[name], device)
    check_flat(bvh, MESHES[name])


@pytest.mark.parametrize("n_faces", [4, 5, 8, 9, 16, 17, 97])
def test_small_sizes(n_faces, device):
    triangles = triangles_of(random_soup(np.random.default_rng(n_faces), n_faces, 0.05))
    bvh = build_bvh(triangles, device)
    check_flat(bvh, triangles)


def test_faces_without_area_are_left_out(device):
    point = np.full((1, 3, 3), 0.3)
    line = np.array([[[0, 0, 0.3], [0.1, 0, 0.3], [0.2, 0, 0.3]]])
    real = triangles_of(plate(0.1, 0.3))
    for triangles, kept in (
        (np.concatenate([point, real[:1], line, real[1:]]), [1, 3]),
        (np.full((5, 3, 3), 0.1), []),
    ):
        bvh = build_bvh(triangles, device)
        np.testing.assert_array_equal(np.sort(bvh.order), kept)
        check_flat(bvh, triangles)


@pytest.mark.parametrize("n_faces", [3, 4099])
@pytest.mark.parametrize("kind", ["identical", "concentric"])
def test_equal_centroids_are_halved_by_count(kind, n_faces, device):
    one = np.array([[-1.0, -0.5, 0.0], [1.0, -0.5, 0.0], [0.0, 1.0, 0.0]])
    size = np.full(n_faces, 0.1)
    if kind == "concentric":
        # Boxes symmetric about one point, so that the centres of all boxes are the same.
        one = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
        size = np.linspace(0.001, 0.1, n_faces)
    triangles = size[:, None, None] * one
    bvh = build_bvh(triangles, device)
    check_flat(bvh, triangles)
    assert bvh.depth <= np.ceil(np.log2(n_faces)) + 1


def exponential(n_faces: int, octaves: float) -> np.ndarray:
    """Triangles whose size and distance shrink geometrically: the worst case of a binned tree."""
    scale = 2.0 ** (-np.arange(n_faces) * octaves / n_faces)
    one = np.array([[1.0, 0.0, 0.0], [1.1, 0.0, 0.1], [1.0, 0.1, 0.0]])
    return scale[:, None, None] * one


def test_splits_by_count_bound_the_depth_of_an_unbalanced_tree(monkeypatch, device):
    triangles = exponential(2000, 120)
    bvh = build_bvh(triangles, device)
    assert 20 < bvh.depth <= module.MEDIAN_BELOW_LEVEL + np.ceil(np.log2(2000)) + 1
    monkeypatch.setattr(module, "MEDIAN_BELOW_LEVEL", 3)
    bvh = build_bvh(triangles, device)
    check_flat(bvh, triangles)
    assert bvh.depth <= 3 + np.ceil(np.log2(len(triangles)))


@pytest.mark.parametrize(
    "triangles",
    [
        MESHES["soup"],
        MESHES["degenerate"],
        exponential(2000, 120),
        np.repeat(MESHES["bowl"][:1], 100, axis=0),
    ],
)
def test_without_a_cpu_device_numpy_builds_the_same_tree(triangles, monkeypatch, device):
    expected = build_bvh(triangles, device)
    monkeypatch.setattr(module, "cpu_beside", lambda device: None)
    found = build_bvh(triangles, device)
    for field in ("low", "high", "child", "order", "depth"):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))


def test_normals_and_areas_of_faces():
    normal, area = face_normals(
        np.array(
            [
                [[0, 0, 0], [2, 0, 0], [0, 3, 0]],
                [[0, 0, 0], [0, 3, 0], [2, 0, 0]],
                [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
                [[5, 5, 5], [5, 5, 5], [5, 5, 5]],
                [[0, 0, 0], [1, 0, 0], [0.5, 1e-13, 0]],  # below 2^-40 of its length squared
            ],
            dtype=float,
        )
    )
    np.testing.assert_array_equal(normal, [[0, 0, 1], [0, 0, -1], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(area, [3, 3, 0, 0, 0])
