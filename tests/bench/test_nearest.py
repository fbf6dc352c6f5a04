"""Any-hit and closest-hit traversal against a brute force in float64, the latter against Embree."""

import numpy as np
import pytest
from core.nearest import NearestHits
from shapes import bowl, box, plate, random_soup, sphere, with_degenerate

from clradar import reference
from clradar.geometry.bvh import error_bound_m, upload_tree
from clradar.hand import hand_mesh, pose_by_name
from clradar.opencl import Buffers, build
from clradar.tracing.antenna_packets import VisibilityOptions, bundled, items, n_groups

DISTANCE_TOLERANCE = 1e-5
"""Relative, which float32 keeps for rays that are not close to grazing; for those see
DISTANCE_ROUNDINGS."""

DISTANCE_ROUNDINGS = 9 * 2.0**-24
"""t = T.N / d.N: 5 roundings relative to |T| |N| above and 4 relative to |N| below, both divided by
d.N: an error of 9 roundings of |T| + t, times the slant |N| / |d.N|."""

EDGE_ROUNDINGS = 23 * 2.0**-24
"""kernels/common/bvh.h: a hit is accepted within 12 roundings of |T|_1 outside an edge, and
computed to 8 of them; 3 more for the direction, which is a float32 too."""

THIRD_EDGE_ROUNDINGS = 12 * 2.0**-24
"""At the third edge, relative to |N|: 8 accepted, 4 computed."""


STACK = 128
"""For all trees of the tests, so that the kernel is built once."""


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def seen(mesh, point, normal, tx, device) -> np.ndarray:
    """Visibility of antennas from points, shape (n_points, n_tx), from `visible_antennas`."""
    vertices, faces = mesh
    groups = n_groups(len(tx))
    wide = device.width == 8
    options = VisibilityOptions(width=device.width, wide=wide, stack=STACK)
    program = build(device, "visibility.cl", options)
    with Buffers(device) as buffers:
        tree = upload_tree(vertices[faces], [tx, point], buffers)
        assert tree.stack <= STACK
        arrays = (bundled(tx), point.astype(np.float32), normal.astype(np.float32))
        out = buffers.zeros(len(point) * groups)
        u = np.uint32
        program.launch(
            "visible_antennas", items(device, len(point), groups), u(len(point)), u(len(tx)),
            u(groups), tree.delta_m, *tree.buffers, *(buffers.upload(a) for a in arrays), out,
        )  # fmt: skip
        bits = buffers.read(out, (len(point), groups), np.uint8)
    flags = np.unpackbits(bits, axis=1, bitorder="little").astype(bool)
    assert not flags[:, len(tx) :].any()
    return flags[:, : len(tx)]


class Rays:
    """Triangles, and rays given in float32 as the kernels read them."""

    def __init__(self, mesh, origin, direction) -> None:
        vertices, faces = mesh
        self.triangles = vertices[faces].astype(np.float32)
        self.origin = np.ascontiguousarray(origin, dtype=np.float32)
        self.direction = unit(np.asarray(direction, dtype=np.float64)).astype(np.float32)

    def nearest(self, device):
        """Distance (-1: none), face (-1: none) and (u, v) from the kernel."""
        with NearestHits(self.triangles, self.origin, self.direction, device) as rays:
            rays.trace()
            return rays.hits()

    def brute_force(self):
        """Distance (inf: none) and face (-1: none) of the same rays in float64."""
        t, face, _ = reference.closest_hit(
            self.origin.astype(float), self.direction.astype(float), self.triangles.astype(float)
        )
        return t, face

    def on_face(self, rows: np.ndarray, face: np.ndarray):
        """In float64, of ray `rows` and `face`: distance, its error in float32, and miss.

        The miss is how far the ray passes outside the triangle, in units of the documented error
        bound: 1 is as far as a hit may be accepted, 0 is inside.
        """
        o, d = self.origin[rows].astype(float), self.direction[rows].astype(float)
        v0, v1, v2 = np.moveaxis(self.triangles[face].astype(float), 1, 0)
        e1, e2 = v1 - v0, v2 - v0
        normal = np.cross(e1, e2)
        dn = np.einsum("ij,ij->i", d, normal)
        sign = np.sign(dn)
        u = np.einsum("ij,ij->i", d, np.cross(e2, v0 - o)) * sign
        v = np.einsum("ij,ij->i", d, np.cross(v0 - o, e1)) * sign
        w = np.abs(dn) - u - v
        size = np.linalg.norm(normal, axis=1)
        to = EDGE_ROUNDINGS * np.abs(v0 - o).sum(axis=1)
        bound1 = to * np.linalg.norm(e1, axis=1)
        bound2 = to * np.linalg.norm(e2, axis=1)
        bound3 = bound1 + bound2 + THIRD_EDGE_ROUNDINGS * size
        miss = np.max([-u / bound2, -v / bound1, -w / bound3, np.zeros(len(u))], axis=0)
        t = np.einsum("ij,ij->i", v0 - o, normal) / dn
        reach = np.linalg.norm(v0 - o, axis=1) + np.abs(t)
        error = DISTANCE_TOLERANCE * np.abs(t) + DISTANCE_ROUNDINGS * reach * size / np.abs(dn)
        return t, error, miss


def check_where_it_is(rays: Rays, got_t, got, t, face) -> None:
    """What the kernel reports is there within its error bound, and nothing is in front of it."""
    rows = np.flatnonzero(got >= 0)
    own_t, error, miss = rays.on_face(rows, got[rows])
    assert (miss <= 1).all(), miss.max()
    assert (np.abs(got_t[rows] - own_t) <= error).all(), (np.abs(got_t[rows] - own_t) / error).max()
    rows = np.flatnonzero(face >= 0)
    error = rays.on_face(rows, face[rows])[1]
    assert (got_t[rows] - t[rows] <= error).all(), ((got_t[rows] - t[rows]) / error).max()


def check_nearest(rays: Rays, device) -> int:
    """Hold every ray against the brute force; how many have another face at another distance."""
    got_t, got, _ = rays.nearest(device)
    t, face = rays.brute_force()
    hit = np.isfinite(t)
    assert hit.any()
    missed = hit & (got < 0)
    assert not missed.any(), f"{missed.sum()} hits missed"
    check_where_it_is(rays, got_t, got, t, face)
    relative = np.abs(got_t - t) <= DISTANCE_TOLERANCE * np.where(hit, t, 0)
    return np.count_nonzero((got != face) & ~relative)


def all_round(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays between random points of a box around the meshes here."""
    origin = rng.uniform([-0.2, -0.2, 0.0], [0.2, 0.2, 0.5], (n, 3))
    return origin, rng.uniform([-0.1, -0.1, 0.2], [0.1, 0.1, 0.4], (n, 3)) - origin


MESHES = {
    "one face": (plate(0.1, 0.3)[0], plate(0.1, 0.3)[1][:1]),
    "waves": plate(0.2, 0.3, 14, wavy_m=0.02),
    "box": box((0, 0, 0.3), (0.1, 0.1, 0.1)),
    "sphere": sphere((0, 0, 0.3), 0.05, 3),
    "bowl": bowl(),
    "soup": random_soup(np.random.default_rng(1), 211, 0.05),
    "degenerate soup": with_degenerate(
        np.random.default_rng(3), random_soup(np.random.default_rng(4), 97, 0.1)
    ),
}


@pytest.mark.parametrize("name", MESHES)
def test_nearest_hit_of_random_rays_and_of_those_at_vertices_and_edges(name, device):
    rng = np.random.default_rng(5)
    # Random rays pass an edge within the bound of 1e-6 m once in 10^4 or so.
    assert check_nearest(Rays(MESHES[name], *all_round(rng, 2001)), device) <= 2
    vertices, faces = MESHES[name]
    corners = vertices[faces]
    which = rng.integers(0, len(faces), 1500)
    share = np.where(np.arange(1500)[:, None] % 3 == 0, 1.0, rng.uniform(0, 1, (1500, 1)))
    target = share * corners[which, 0] + (1 - share) * corners[which, 1]
    origin = rng.uniform([-0.2, -0.2, 0.0], [0.2, 0.2, 0.1], (1500, 3))
    check_nearest(Rays(MESHES[name], origin, target - origin), device)


def test_nearest_hit_of_axis_parallel_rays_in_the_planes_of_boxes(device):
    """Zero components, and origins and rays that lie exactly in the faces of the boxes."""
    mesh = plate(0.25, 0.25, 8)
    vertices, faces = mesh
    tilted = vertices + [0, 0, 1] * np.round(vertices[:, :1] * 8) / 8
    grid = np.linspace(-0.125, 0.125, 33)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    down = np.stack([x, y, np.zeros_like(x)], axis=1)
    origin = np.concatenate(
        [down, down + np.array([0, 0, 0.5]), np.stack([x - 1, y, 0.25 + 0 * x], axis=1)]
    )
    direction = np.repeat([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]], len(x), axis=0)
    for shape in (mesh, (tilted, faces), box((0, 0, 0.25), (0.25, 0.25, 0.25))):
        check_nearest(Rays(shape, origin, direction), device)
        check_nearest(Rays(shape, origin + 2 * direction, -direction + 0.0), device)


@pytest.mark.parametrize(
    ("name", "n_tx"),
    [*((name, 19) for name in MESHES), *(("degenerate soup", n_tx) for n_tx in (1, 8, 9))],
)
def test_any_hit(name, n_tx, device):
    rng = np.random.default_rng(9)
    vertices, faces = MESHES[name]
    # Points on the faces themselves, as in the tracer; some of the antennas behind the mesh.
    tx = rng.uniform([-0.2, -0.2, 0.0], [0.2, 0.2, 0.05], (n_tx, 3))
    tx[2::3, 2] += 0.6
    triangles = vertices[faces].astype(np.float32).astype(float)
    edge = triangles - triangles[:, :1]
    normal = np.cross(edge[:, 1], edge[:, 2])
    real = np.flatnonzero(np.linalg.norm(normal, axis=1) > 1e-10)
    which = real[rng.integers(0, len(real), 300)]
    weight = rng.dirichlet([1, 1, 1], 300)
    point = np.einsum("ij,ijk->ik", weight, triangles[which]).astype(np.float32).astype(float)
    normal = unit(normal[which])
    got = seen(MESHES[name], point, normal, tx, device)

    # The same query in float64: from 2 delta above the face towards the antenna.
    delta_m = error_bound_m(triangles, tx, point)
    towards = tx[None].astype(np.float32).astype(float) - point[:, None]
    side = np.sign(np.einsum("sta,sa->st", towards, normal))
    origin = point[:, None] + 2 * delta_m * side[:, :, None] * normal[:, None]
    segment = tx.astype(np.float32).astype(float)[None] - origin
    reach = np.linalg.norm(segment, axis=2)
    flat = (origin.reshape(-1, 3), (segment / reach[:, :, None]).reshape(-1, 3))
    t = reference.closest_hit(*flat, triangles)[0].reshape(reach.shape)
    # No blocker is missed that the exact ray meets, but within the error of where it ends.
    surely_blocked = (t < reach - 4 * delta_m) & (t > 4 * delta_m)
    assert not (got & surely_blocked).any(), int((got & surely_blocked).sum())
    # What is called blocked is so, but for rays that pass a face's edge within the error bound.
    # That is one ray in 10^3 or so, since some of the points lie on slivers that are no wider.
    wrongly = ~got & (t >= reach)
    assert wrongly.mean() <= (1e-2 if "degenerate" in name else 1e-3) + 1 / wrongly.size


def hand_rays(n_rays: int, seed: int) -> Rays:
    """From a 14 cm aperture at random points of a hand's bounding box, and bounces off its
    faces."""
    rng = np.random.default_rng(seed)
    mesh = hand_mesh(pose_by_name("F"))
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    half = n_rays // 2
    aperture = np.append(rng.uniform(-0.07, 0.07, (half, 2)), np.zeros((half, 1)), axis=1)
    at = rng.uniform(low, high, (half, 3))
    corners = mesh.vertices_m[mesh.faces][rng.integers(0, len(mesh.faces), n_rays - half)]
    normal = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    off = corners.mean(axis=1) + 1e-4 * normal
    away = unit(rng.normal(size=normal.shape)) + normal
    return Rays(
        (mesh.vertices_m, mesh.faces),
        np.concatenate([aperture, off]),
        np.concatenate([at - aperture, away]),
    )


EMBREE_DISAGREE = 2e-6
"""Share of rays that may get another answer. Ours decides the side of an edge in doubled
precision, so what is left is Embree's rounding: 2^-24 of 0.3 m, 2e-8 m, along silhouettes some 2 m
long, out of the 0.04 m^2 that the rays are aimed at, is 1e-6."""


@pytest.mark.slow
@pytest.mark.parametrize(("n_rays", "seed"), [(10**5, 10), (10**6, 11)])
def test_nearest_hit_against_embree(n_rays, seed, device):
    scene_module = pytest.importorskip("embreex.rtcore_scene")
    construction = pytest.importorskip("embreex.mesh_construction")
    rays = hand_rays(n_rays, seed)
    scene = scene_module.EmbreeScene(robust=True)
    construction.TriangleMesh(scene, rays.triangles)
    found = scene.run(rays.origin, rays.direction, output=1)
    face = np.asarray(found["primID"])
    t = np.where(face >= 0, found["tfar"], -1.0)

    got_t, got, _ = rays.nearest(device)
    assert (face >= 0).mean() > 0.1
    agree = (got == face) | (
        (got >= 0) & (face >= 0) & (np.abs(got_t - t) <= DISTANCE_TOLERANCE * t)
    )
    rows = np.flatnonzero(~agree)
    print(f"{len(rows)} of {n_rays} rays disagree")
    assert len(rows) <= EMBREE_DISAGREE * n_rays

    # Of those, each one is decided by the exact test: neither answer is off by more than the bound.
    some = Rays.__new__(Rays)
    some.triangles = rays.triangles
    some.origin, some.direction = rays.origin[rows], rays.direction[rows]
    exact_t, exact = some.brute_force() if len(rows) else (np.zeros(0), np.zeros(0, int))
    assert not ((exact >= 0) & (got[rows] < 0)).any()
    check_where_it_is(some, got_t[rows], got[rows], exact_t, exact)
