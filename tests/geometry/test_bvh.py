"""The tree over the triangles, and which surfaces are watertight, so that one ray is enough."""

from functools import cache

import numpy as np
import pytest
from shapes import bowl, box, plate, random_soup, sphere, with_degenerate

import clradar
from clradar.geometry import bvh, bvh as module
from clradar.geometry.bvh import Bvh, build_bvh, face_normals, flatten
from clradar.geometry.watertight import outward_side
from clradar.hand import hand_mesh
from clradar.tracing.visible_surface import VisibleSurface


def triangles_of(mesh: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.asarray(mesh[0])[np.asarray(mesh[1])]


DELTA_M = 1e-6
"""Padding of the boxes; small against the meshes, large against the rounding of their corners."""


def check_flat(bvh: Bvh, triangles_m: np.ndarray) -> None:
    """Walk what the kernels read, as they do, and hold it against ``kernels/common/bvh.h``."""
    corners = np.asarray(triangles_m, dtype=np.float32)
    nodes, records, most_kept, _ = flatten(bvh, triangles_m, DELTA_M)
    n_blocks = int(nodes.view(np.int32)[0, 56])
    assert records.shape == (n_blocks * 104,)
    blocks, faces = np.split(records, [n_blocks * 96])
    blocks, faces = blocks.reshape(n_blocks, 12, 8), faces.view(np.int32).reshape(n_blocks, 8)
    rows = nodes.reshape(-1, 8, 8)
    low, high = rows[:, 1:4].transpose(0, 2, 1), rows[:, 4:7].transpose(0, 2, 1)
    child = rows.view(np.int32)[:, 0]
    used = low[:, :, 0] <= high[:, :, 0]

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
    **{f"{n} faces": triangles_of(random_soup(RNG, n, 0.05)) for n in (4, 5, 8, 9, 16, 17, 97)},
}


@pytest.mark.parametrize("name", MESHES)
def test_every_face_is_in_one_leaf_and_in_its_boxes(name, device):
    bvh = build_bvh(MESHES[name], device)
    check_flat(bvh, MESHES[name])


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


def merged(*meshes):
    """Several meshes as one."""
    vertices, faces, n = [], [], 0
    for v, f in meshes:
        vertices.append(v)
        faces.append(np.asarray(f) + n)
        n += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


def flipped(mesh):
    return mesh[0], mesh[1][:, ::-1]


def scaled(mesh, factor, centre):
    return (mesh[0] - centre) * factor + centre, mesh[1]


CENTRE = np.array([0, 0, 0.3])
BALL = sphere((0, 0, 0.3), 0.05, 3)
BOX = box((0, 0, 0.3), (0.1, 0.1, 0.1))


@cache
def hand() -> tuple[np.ndarray, np.ndarray]:
    mesh = hand_mesh("F", edge_length_m=4e-3)
    return mesh.vertices_m, mesh.faces


CLOSED = {
    "ball": BALL,
    "box": BOX,
    "hand": None,  # made where it is used, since that takes a device
    "two that overlap": merged(BALL, (BALL[0] + [0.03, 0.01, 0], BALL[1])),
    "hollow": merged(BALL, flipped(scaled(BALL, 0.8, CENTRE))),
    "twice the same": merged(BALL, BALL),
    "turned inside out": flipped(BALL),
    "faces turned at random": (
        BALL[0],
        np.where(np.arange(len(BALL[1]))[:, None] % 3 == 0, BALL[1][:, ::-1], BALL[1]),
    ),
    "around some antennas": scaled(BOX, 7.0, CENTRE),
}


def corners_of(mesh) -> np.ndarray:
    return triangles_of(mesh or hand()).astype(np.float32)


@pytest.mark.device
def test_closed_surfaces_are_recognised_and_their_outside_too():
    for name, mesh in CLOSED.items():
        assert abs(outward_side(corners_of(mesh))) == 1, name
    assert outward_side(corners_of(BALL)) == 1
    assert outward_side(corners_of(flipped(BALL))) == -1


@pytest.mark.device
def test_open_surfaces_are_not_closed():
    rng = np.random.default_rng(2)
    for mesh in CLOSED.values():
        assert outward_side(np.delete(corners_of(mesh), 7, axis=0)) == 0
    for mesh in (plate(0.1, 0.3), bowl(), random_soup(rng, 100, 0.02), (BOX[0], BOX[1][:2])):
        assert outward_side(corners_of(mesh)) == 0
    triangles = corners_of(BALL)
    cracked = triangles.copy()
    cracked[5, 1] = np.nextafter(cracked[5, 1], np.float32(1))
    assert outward_side(cracked) == 0
    # Faces without area neither close nor open.
    flat = np.concatenate([np.repeat(triangles[:1, :1], 3, axis=1), triangles[:1, [0, 1, 1]]])
    assert outward_side(np.concatenate([triangles, flat])) == 1
    assert outward_side(np.concatenate([triangles[1:], flat])) == 0


@pytest.mark.device
@pytest.mark.parametrize("name", CLOSED)
def test_parity_of_one_ray_changes_no_visibility(name, device, monkeypatch):
    """Antennas all around, some of them inside the larger surfaces."""
    rng = np.random.default_rng(3)
    tx = np.concatenate(
        [rng.uniform(-0.1, 0.1, (70, 3)) * [1, 1, 0], rng.uniform([-0.4, -0.4, -0.1], 0.5, (25, 3))]
    )
    scene = clradar.Scene(*(CLOSED[name] or hand()))
    density = 400 / (1e6 * face_normals(scene.triangles_m)[1].sum())

    def seen() -> np.ndarray:
        with VisibleSurface(scene, density, 1.0, device) as surface:
            return surface.visible_from(tx)

    with_it = seen()
    monkeypatch.setattr(bvh, "outward_side", lambda _: 0)
    without = seen()
    # One ray may slip through where float32 cannot tell a gap at an edge from the face beside it.
    assert (with_it & ~without).sum() == 0
    assert (without & ~with_it).sum() <= 1
    assert without.any()
    assert not without.all()
