"""Our times alone, to be held against those of other versions, with the results of the peers.

benchmarks/against_peers.py times the same work against the peers.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any

import numpy as np
import pytest
import trimesh
from core import meshes
from core.images import ExactImage, PaperVolume, noise
from core.nearest import NearestHits
from core.phasor_sums import PathSums
from core.physical import PhysicalHand
from core.rays import bounces_of, our_tree, peers_of, rays_of, surface_of
from core.timing import ARRAY, WAVEFORM, relative_rms_db

import clradar
from clradar import reference
from clradar.hand import hand_mesh
from clradar.hand.mesh import DEFAULT_EDGE_LENGTH_M

Measured = Callable[[Callable[[], Any]], Any]

MESHES = {"closed": partial(meshes.ball, 203, 202), "concave": partial(meshes.waves, 708)}

OTHER_ANSWERS = 1e-4
"""Fraction of rays whose results may differ: those that graze an edge, in float32."""

OURS_DB, PEER_DB = -120.0, -95.0
"""Ours: a few float32 roundings of terms of one pair, compensated. The peer: 1e-5 is requested."""

PLANES = 5
"""Of the paper's 81, which the peers get: the planning of "fast" counts more with fewer."""

RANGE_DB = -50.0
"""Linear interpolation between range bins: -54 dB."""

FAST_DB = -50.0 + 1.5
"""The default tolerance, and the error of the image by range profiles."""

FLOAT32_DB = -100.0
"""Two ways to do the same float32 sums of 10^6 terms."""

SAMPLES_PER_MM2 = 2.0
"""A fifth of the default experiment."""

PHYSICAL_DB = -60.0
"""Skeleton antennas and frequencies are chosen to this."""

SAME_SUM_DB = -100.0
"""The float64 sum over the same paths: phases in float32, moments of E7."""


@pytest.fixture(scope="module", params=MESHES)
def scene(request: pytest.FixtureRequest) -> clradar.Scene:
    return MESHES[request.param]()


@pytest.fixture(scope="module")
def sums(device: clradar.Device) -> PathSums:
    return PathSums(device, 1_000_000)


@pytest.fixture(scope="module")
def image(device: clradar.Device) -> PaperVolume:
    return PaperVolume(device, noise(), PLANES)


@pytest.fixture(scope="module")
def by_range(image: PaperVolume) -> np.ndarray:
    return image.ours("range")


@pytest.fixture(scope="module")
def plane(device: clradar.Device) -> ExactImage:
    return ExactImage(device, noise())


@pytest.mark.benchmark(group="visibility")
def test_visibility(measured: Measured, scene: clradar.Scene, device: clradar.Device) -> None:
    """Visibility of 94 Tx from points of a mesh, as by Embree and Mitsuba."""
    with surface_of(scene, 16384, device) as surface:
        measured(partial(surface.visible_bits, ARRAY.tx_m))
        seen = surface.visible_from(ARRAY.tx_m).ravel()
        queries, names = peers_of(scene, *rays_of(surface), "blocked")
    assert 0.05 < seen.mean() < 0.95
    for (blocked, _), name in zip(queries, names, strict=True):
        assert np.mean(blocked() == seen) <= OTHER_ANSWERS, name


@pytest.mark.benchmark(group="bounces")
def test_bounces(measured: Measured, scene: clradar.Scene, device: clradar.Device) -> None:
    """Incoherent rays: which face does each hit first? As by Embree and Mitsuba."""
    origins, directions = bounces_of(scene, 200_000)
    with NearestHits(scene.triangles_m, origins, directions, device) as rays:
        measured(rays.trace)
        face = rays.hits()[1]
    queries, names = peers_of(scene, origins, directions, "faces")
    for (faces, _), name in zip(queries, names, strict=True):
        assert np.mean(faces() != face) <= OTHER_ANSWERS, name


@pytest.mark.benchmark(group="tree of 100 352 faces")
def test_tree(measured: Measured, device: clradar.Device) -> None:
    """`test_bounces` compares the hits of rays in such trees."""
    measured(partial(our_tree, meshes.waves(224).triangles_m, device))


@pytest.mark.benchmark(group="phasor sum, 1 M paths")
@pytest.mark.parametrize("steps", ["equal", "unequal"])
def test_phasor_sum(measured: Measured, sums: PathSums, steps: str) -> None:
    """Ours and that of finufft against float64."""
    waveform = WAVEFORM if steps == "equal" else sums.unequal
    data: np.ndarray = measured(partial(sums.ours, waveform))
    assert sums.error_db(data, waveform) <= OURS_DB
    if steps == "equal":
        sums.prepare()
        assert sums.error_db(sums.peer.transform()) <= PEER_DB


@pytest.mark.benchmark(group="image, 201 x 201 x 5")
def test_fast(measured: Measured, image: PaperVolume, by_range: np.ndarray) -> None:
    data: np.ndarray = measured(partial(image.ours, "fast"))
    assert relative_rms_db(data, by_range) <= FAST_DB


@pytest.mark.benchmark(group="image, 201 x 201 x 5")
def test_range(measured: Measured, image: PaperVolume, plane: ExactImage) -> None:
    """As numba on the same range profiles, and another grid as the exact sum."""
    data: np.ndarray = measured(partial(image.ours, "range"))
    assert relative_rms_db(image.theirs(), data) <= FLOAT32_DB
    by_range = clradar.backproject(
        plane.capture, plane.grid, method="range", device=plane.device
    ).data.ravel()
    assert relative_rms_db(by_range, plane.ours()) <= RANGE_DB


@pytest.mark.benchmark(group="exact sum, 5.8 G terms")
def test_exact(measured: Measured, plane: ExactImage) -> None:
    """As numpy by a complex GEMM per frequency."""
    data: np.ndarray = measured(plane.ours)
    assert relative_rms_db(data, plane.theirs()) <= FLOAT32_DB


@pytest.mark.benchmark(group="simulate a hand, 2 samples/mm^2")
def test_simulate(measured: Measured, device: clradar.Device) -> None:
    scene = clradar.Scene.from_mesh(hand_mesh("F"), alpha=0.5)
    settings = {"samples_per_mm2": SAMPLES_PER_MM2, "seed": 1, "device": device}
    capture: clradar.Capture = measured(
        partial(clradar.simulate, scene, ARRAY, WAVEFORM, **settings)
    )
    paths = clradar.trace(scene, ARRAY, **settings)
    some = clradar.Waveform(WAVEFORM.frequencies_hz[::31])
    want = reference.synthesize(paths, ARRAY, some)
    assert relative_rms_db(capture.data[:, :, ::31], want) <= SAME_SUM_DB


@pytest.mark.benchmark(group="simulate a hand physically, 1 sample/mm^2")
def test_physical(measured: Measured, device: clradar.Device) -> None:
    hand = PhysicalHand(device, 1.0, 2)
    data: np.ndarray = measured(hand.ours)
    assert relative_rms_db(data[:, :, hand.chosen], hand.dense()) <= PHYSICAL_DB


@pytest.mark.benchmark(group="hand mesh")
def test_hand_mesh(measured: Measured) -> None:
    factor = count(1)  # a new length each time, since the last few meshes are cached
    mesh = measured(lambda: hand_mesh("F", DEFAULT_EDGE_LENGTH_M * (1 + 1e-6 * next(factor))))
    solid = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert solid.is_watertight
    assert 1e-4 < solid.volume < 6e-4  # a hand has about 0.35 litres
