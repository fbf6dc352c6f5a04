"""Visibility, bounces and building the tree, against Embree and Mitsuba, all results compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

import clradar
from clradar.bench import meshes
from clradar.bench.nearest import NearestHits
from clradar.bench.rays import bounces_of, embree_tree, our_tree, peers_of, rays_of, surface_of
from clradar.bench.timing import ARRAY

Measured = Callable[[Callable[[], Any]], Any]
Query = tuple[Callable[[], np.ndarray], Callable[[], Any]]
"""The results as an array; to be timed."""

MESHES = {"closed": partial(meshes.ball, 203, 202), "concave": partial(meshes.waves, 708)}
WHO = ("clradar", "embreex", "mitsuba")
N_POINTS, N_BOUNCES = 16384, 200_000

OTHER_ANSWERS = 1e-4
"""Fraction of rays whose results may differ: those that graze an edge, in float32."""


@pytest.fixture(scope="module", params=MESHES)
def scene(request: pytest.FixtureRequest) -> clradar.Scene:
    return MESHES[request.param]()


@pytest.fixture(scope="module")
def visibility(scene: clradar.Scene, device: clradar.Device) -> Iterator[dict[str, Query]]:
    with surface_of(scene, N_POINTS, device) as surface:
        queries, _ = peers_of(scene, *rays_of(surface), "blocked")
        ours = (
            (lambda: surface.visible_from(ARRAY.tx_m).ravel()),
            partial(surface.visible_bits, ARRAY.tx_m),
        )
        yield dict(zip(WHO, [ours, *queries], strict=True))


@pytest.fixture(scope="module")
def bounces(scene: clradar.Scene, device: clradar.Device) -> Iterator[dict[str, Query]]:
    origins, directions = bounces_of(scene, N_BOUNCES)
    with NearestHits(scene.triangles_m, origins, directions, device) as rays:

        def ours() -> np.ndarray:
            rays.trace()
            return rays.hits()[1]

        queries, _ = peers_of(scene, origins, directions, "faces")
        yield dict(zip(WHO, [(ours, rays.trace), *queries], strict=True))


@pytest.mark.benchmark(group="visibility")
@pytest.mark.parametrize("who", WHO)
def test_visibility(measured: Measured, visibility: dict[str, Query], who: str) -> None:
    """Visibility of 94 Tx from points of a mesh."""
    answers, timed = visibility[who]
    measured(timed)
    seen = visibility["clradar"][0]()
    same = seen if who == "clradar" else ~answers()
    assert 0.05 < seen.mean() < 0.95
    assert np.mean(same != seen) <= OTHER_ANSWERS


@pytest.mark.benchmark(group="bounces")
@pytest.mark.parametrize("who", WHO)
def test_bounces(measured: Measured, bounces: dict[str, Query], who: str) -> None:
    """Incoherent rays: which face does each hit first?"""
    answers, timed = bounces[who]
    measured(timed)
    assert np.mean(answers() != bounces["clradar"][0]()) <= OTHER_ANSWERS


@pytest.mark.benchmark(group="tree of 100 352 faces")
@pytest.mark.parametrize("who", ["clradar", "embreex"])
def test_tree(measured: Measured, device: clradar.Device, who: str) -> None:
    triangles_m = meshes.waves(224).triangles_m
    build = {"clradar": partial(our_tree, triangles_m, device)}
    build["embreex"] = partial(embree_tree, triangles_m)
    measured(build[who])
    scene = meshes.waves(224)
    origins, directions = bounces_of(scene, 20_000)
    queries, _ = peers_of(scene, origins, directions, "faces")
    with NearestHits(scene.triangles_m, origins, directions, device) as rays:
        rays.trace()
        assert np.mean(queries[0][0]() != rays.hits()[1]) <= OTHER_ANSWERS
