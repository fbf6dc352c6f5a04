"""Ray tracing against Embree and Mitsuba: visibility, bounces, tree building."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import clradar
from clradar.geometry.bvh import build_bvh, face_normals, flatten
from clradar.tracing.visible_surface import VisibleSurface
from core import meshes
from core.nearest import NearestHits
from core.peers import EmbreeRays, MitsubaRays
from core.timing import ARRAY, Row, interleaved_s

PAUSE_S = 0.1
"""Mitsuba's threads wait actively for a while after each call."""

LIFT_M = 2e-6
"""Height above its face at which a ray begins."""


def visibility(device: clradar.Device, repeats: int, n_points: int) -> list[Row]:
    """Rays from points of a mesh to the Tx: the bulk of the tracing."""
    rows = []
    for name, scene in (("closed", meshes.ball(203, 202)), ("concave", meshes.waves(708))):
        with surface_of(scene, n_points, device) as surface:
            origins, directions = rays_of(surface)
            ours = partial(surface.visible_bits, ARRAY.tx_m)
            queries, names = peers_of(scene, origins, directions, "blocked")
            visible = surface.visible_from(ARRAY.tx_m).ravel()
            differ = [float(np.mean(visible == peer())) for peer, _ in queries]
            times = interleaved_s([ours, *(run for _, run in queries)], repeats, PAUSE_S)
        what = f"visibility, {visible.size / 1e6:.2g} M rays, {scene.n_faces} faces, {name}"
        rows.append(_row(what, visible.size, times, names, differ))
    return rows


def bounces(device: clradar.Device, repeats: int, n_rays: int) -> list[Row]:
    """Incoherent rays: off random points of a mesh, in random order, to all sides."""
    rows = []
    for name, scene in (("closed", meshes.ball(203, 202)), ("concave", meshes.waves(708))):
        origins, directions = bounces_of(scene, n_rays)
        with NearestHits(scene.triangles_m, origins, directions, device) as rays:
            rays.trace()
            face = rays.hits()[1]
            queries, names = peers_of(scene, origins, directions, "faces")
            differ = [float(np.mean(face != peer())) for peer, _ in queries]
            times = interleaved_s([rays.trace, *(run for _, run in queries)], repeats, PAUSE_S)
        what = f"bounces, {n_rays / 1e6:.2g} M rays, {scene.n_faces} faces, {name}"
        rows.append(_row(what, n_rays, times, names, differ))
    return rows


def trees(device: clradar.Device, repeats: int, cells: tuple[int, ...]) -> list[Row]:
    """Building the tree, as the kernels read it."""
    rows = []
    for n in cells:
        triangles = meshes.waves(n).triangles_m
        works = [partial(our_tree, triangles, device), partial(embree_tree, triangles)]
        ours_s, theirs_s = np.median(interleaved_s(works, repeats), axis=0)
        rows.append(
            Row(
                work=f"tree of {len(triangles)} faces",
                ours=f"{ours_s:.2f} s",
                peer=f"Embree through embreex, copying the mesh included, {theirs_s:.2f} s",
                ratio=theirs_s / ours_s,
                check="tests/geometry/test_bvh.py",
            )
        )
    return rows


def our_tree(triangles_m: np.ndarray, device: clradar.Device) -> None:
    flatten(build_bvh(triangles_m, device), triangles_m, LIFT_M)


def embree_tree(triangles_m: np.ndarray) -> None:
    one = np.ones((1, 3), np.float32)
    embree = EmbreeRays(triangles_m)
    embree.prepare(one, one)
    embree.faces()  # it builds in the first query


def surface_of(scene: clradar.Scene, n_points: int, device: clradar.Device) -> VisibleSurface:
    area_mm2 = face_normals(scene.triangles_m)[1].sum() * 1e6
    return VisibleSurface(scene, n_points / area_mm2, 0.2, device)


def rays_of(surface: VisibleSurface) -> tuple[np.ndarray, np.ndarray]:
    """From each point to each Tx, one point after the other, as `visible_antennas` traces them."""
    origins = surface.ray_origins(ARRAY.tx_m)
    directions = (ARRAY.tx_m[None] - origins).astype(np.float32)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


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


def peers_of(
    scene: clradar.Scene, origins: np.ndarray, directions: np.ndarray, query: str
) -> tuple[list[tuple[Callable[[], np.ndarray], Callable[[], Any]]], list[str]]:
    """For each peer: the query with its results as an array, the query that is timed; its name."""
    embree, mitsuba = EmbreeRays(scene.triangles_m), MitsubaRays(scene.triangles_m)
    embree.prepare(origins, directions)
    mitsuba.prepare(origins, directions)
    own = getattr(embree, query)
    runs = [(own, own), (getattr(mitsuba, query), getattr(mitsuba, f"query_{query}"))]
    return runs, [embree.name, mitsuba.name]


def _row(work: str, n_rays: int, times_s: np.ndarray, names: list[str], differ: list[float]) -> Row:
    """A row against the fastest of the peers; `times_s` has ours first."""
    speed = [n_rays / s / 1e6 for s in np.median(times_s, axis=0)]
    best = int(np.argmax(speed[1:]))
    others = ", ".join(f"{name} {v:.1f} M rays/s" for name, v in zip(names, speed[1:], strict=True))
    ratios = times_s[:, 1 + best] / times_s[:, 0]
    shares = " and ".join(f"{d:.1e}" for d in differ)
    return Row(
        work=work,
        ours=f"{speed[0]:.1f} M rays/s",
        peer=f"the faster of: {others}",
        ratio=float(np.median(ratios)),
        check=f"ratios {ratios.min():.1f} to {ratios.max():.1f}; {shares} of the results differ",
    )
