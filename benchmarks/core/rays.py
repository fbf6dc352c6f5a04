"""Ray tracing against Mitsuba, which traces by Embree: visibility, bounces, tree building."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

import clradar
from clradar.geometry.bvh import build_bvh, face_normals, flatten
from clradar.tracing.visible_surface import VisibleSurface
from core import meshes
from core.nearest import NearestHits
from core.peers import MitsubaRays, answer
from core.work import ARRAY, Work

PAUSE_S = 0.1  # mitsuba's threads wait actively for a while after each call
LIFT_M = 2e-6  # height above its face at which a ray begins
SCENES = {"closed": partial(meshes.ball, 101), "concave": partial(meshes.waves, 708)}


def visibility(device: clradar.Device, n_points: int) -> Iterator[Work]:
    """Rays from points of a mesh to the Tx: the bulk of the tracing."""
    for name, make in SCENES.items():
        scene = make()
        area_mm2 = face_normals(scene.triangles_m)[1].sum() * 1e6
        with VisibleSurface(scene, n_points / area_mm2, 0.2, device) as surface:
            # From each point to each Tx, one point after the other, as the kernel traces them.
            origins = surface.ray_origins(ARRAY.tx_m)
            directions = (ARRAY.tx_m[None] - origins).astype(np.float32)
            ours = partial(surface.visible_bits, ARRAY.tx_m)
            hidden = ~surface.visible_from(ARRAY.tx_m).ravel()
            rays = origins.reshape(-1, 3), directions.reshape(-1, 3)
            yield _against(f"visibility, {name}", scene, rays, "blocked", ours, hidden)


def bounces(device: clradar.Device, n_rays: int) -> Iterator[Work]:
    """Incoherent rays: off random points of a mesh, in random order, to all sides."""
    for name, make in SCENES.items():
        scene = make()
        origins, directions = rays = bounces_of(scene, n_rays)
        with NearestHits(scene.triangles_m, origins, directions, device) as hits:
            hits.trace()
            yield _against(f"bounces, {name}", scene, rays, "faces", hits.trace, hits.hits()[1])


def trees(device: clradar.Device, cells: tuple[int, ...]) -> Iterator[Work]:
    """Building the tree, as the kernels read it."""
    for n in cells:
        triangles = meshes.waves(n).triangles_m
        yield Work(
            f"tree of {len(triangles)} faces", {"": partial(_our_tree, triangles, device)},
            {"Mitsuba, copying the mesh included": partial(_mitsuba_tree, triangles)},
            "tests/geometry/test_bvh.py",
        )  # fmt: skip


def _our_tree(triangles_m: np.ndarray, device: clradar.Device) -> None:
    flatten(build_bvh(triangles_m, device), triangles_m, LIFT_M)


def _mitsuba_tree(triangles_m: np.ndarray) -> None:
    one = np.ones((1, 3), np.float32)
    MitsubaRays(triangles_m, one, one).faces()  # nothing is left to be done later


def bounces_of(scene: clradar.Scene, n_rays: int) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse rays off random points, from the side of each face that the normal is on."""
    rng = np.random.default_rng(3)
    triangles = scene.triangles_m
    normals, area = face_normals(triangles)
    face = rng.choice(len(triangles), n_rays, p=area / area.sum())
    weights = rng.dirichlet([1, 1, 1], n_rays)
    origins = np.einsum("ij,ijk->ik", weights, triangles[face]) + LIFT_M * normals[face]
    away = rng.normal(size=(n_rays, 3))
    away = normals[face] + 0.999 * away / np.linalg.norm(away, axis=1)[:, None]
    away /= np.linalg.norm(away, axis=1)[:, None]
    return origins.astype(np.float32), away.astype(np.float32)


def _against(
    name: str,
    scene: clradar.Scene,
    rays: tuple[np.ndarray, np.ndarray],
    query: str,
    ours: Any,
    found: np.ndarray,
) -> Work:
    """The same rays by Mitsuba; `found` is our answer to `query`, a method of its."""
    peer = MitsubaRays(scene.triangles_m, *rays)
    theirs, n = getattr(peer, query), len(rays[0])
    differ = np.mean(answer(*theirs()) != found)
    return Work(
        f"{name}, {n / 1e6:.2g} M rays, {scene.n_faces} faces", {"": ours},
        {peer.name: theirs}, f"{differ:.1e} of the results differ",
        n / 1e6, "M rays/s", pause_s=PAUSE_S,
    )  # fmt: skip
