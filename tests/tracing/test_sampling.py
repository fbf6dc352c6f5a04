"""Where the tracer puts its samples, uniform on each face, and the bundles of its antennas."""

import warnings
from functools import cache

import numpy as np
import pyopencl as cl
import pytest
from core import meshes
from shapes import bowl, plate, random_soup, sphere, with_degenerate

import clradar
from clradar import reference
from clradar.errors import MeshError
from clradar.geometry.normals import corner_normals
from clradar.hand import hand_mesh
from clradar.opencl import Buffers
from clradar.opencl.sources import source
from clradar.tracing.sampled_surface import samples_per_face
from clradar.tracing.settings import resolve_settings
from clradar.tracing.stochastic import Tracer
from clradar.tracing.visible_surface import VisibleSurface

POINT_TOLERANCE_M = 3e-7
"""Three products and two sums of float32 numbers below 0.5 m, and weights wrong by two roundings:
eight roundings of 2^-24 x 0.5 m at most."""

NORMAL_TOLERANCE = 2e-6
"""The same for unit vectors, whose sum may be as short as one half before it is normalised."""

ARRAY = clradar.AntennaArray([[0.0, 0.0, 0.0]], [[0.01, 0.0, 0.0]])


def scene_of(mesh, alpha=0.5) -> clradar.Scene:
    return clradar.Scene(*mesh, alpha)


def sampled(scene, device, **arguments):
    """Points on flat faces, shading normals, geometric normals, faces and curved points of all
    samples, as the tracer has them."""
    settings = resolve_settings(**arguments)
    with Tracer(scene, ARRAY, settings, device) as tracer:
        parts = []
        first = 0
        while first < tracer.n_samples:
            count = min(tracer._tile_samples, tracer.n_samples - first)
            tracer._illuminate(first, count)
            points, shading, geometric, face, _, _, curved = tracer._tile
            read = tracer._buffers.read
            vectors = [
                read(b, (count, 3), np.float32) for b in (points, shading, geometric, curved)
            ]
            parts.append([*vectors[:3], read(face, count, np.int32), vectors[3]])
            first += count
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


MESHES = {
    "plate": plate(0.2, 0.3, 3),
    "bowl": bowl(),
    "sphere": sphere((0, 0, 0.3), 0.05, 2),
    "soup": random_soup(np.random.default_rng(1), 57, 0.05),
}


@pytest.mark.parametrize(("name", "seed"), [*zip(MESHES, [0, 1, 5, 2**64 - 1], strict=True)])
def test_samples_are_those_of_the_reference(name, seed, device):
    scene = scene_of(MESHES[name])
    arguments = {"samples_per_mm2": 0.05, "seed": seed}
    counts = samples_per_face(scene, resolve_settings(**arguments))
    corners = corner_normals(scene)[0]
    expected = reference.sample_surface(scene, counts, corners, seed)
    got = sampled(scene, device, **arguments)
    np.testing.assert_array_equal(got[3], expected[3])
    np.testing.assert_allclose(got[0], expected[0], rtol=0, atol=POINT_TOLERANCE_M)
    np.testing.assert_allclose(got[1], expected[1], rtol=0, atol=NORMAL_TOLERANCE)
    np.testing.assert_allclose(got[2], expected[2], rtol=0, atol=NORMAL_TOLERANCE)


@pytest.mark.parametrize("name", ["bowl", "sphere", "soup"])
def test_curved_points_are_those_of_the_reference(name, device):
    scene = scene_of(MESHES[name])
    arguments = {"samples_per_mm2": 0.05, "seed": 5}
    counts = samples_per_face(scene, resolve_settings(**arguments))
    corners = corner_normals(scene)[0]
    expected = reference.curved_samples(scene, counts, corners, 5)
    curved, flat = (
        sampled(scene, device, facets=facets, **arguments)[4] for facets in ("curved", "flat")
    )
    np.testing.assert_allclose(curved, expected, rtol=0, atol=POINT_TOLERANCE_M)
    ground = sampled(scene, device, **arguments)[0]
    np.testing.assert_array_equal(flat, ground)
    # Triangles of a soup share no corner and are flat.
    assert (np.abs(curved - ground).max() == 0) == (name == "soup")


@pytest.mark.parametrize("density", [0.003, 1.7])
@pytest.mark.parametrize("name", MESHES)
def test_counts_are_proportional_to_the_area(name, density):
    scene = scene_of(MESHES[name])
    counts = samples_per_face(scene, resolve_settings(samples_per_mm2=density))
    e = scene.triangles_m - scene.triangles_m[:, :1]
    exact = np.linalg.norm(np.cross(e[:, 1], e[:, 2]), axis=1) / 2 * 1e6 * density
    assert (np.abs(counts - exact) <= 1).all()
    # So is every run of faces, so that nothing piles up.
    assert (np.abs(np.cumsum(counts) - np.cumsum(exact)) <= 1).all()


def test_a_scene_smaller_than_one_sample_gets_one(device):
    assert len(sampled(scene_of(plate(1e-4, 0.3)), device, samples_per_mm2=0.01)[0]) == 1


@pytest.mark.parametrize("arguments", [{"samples_per_mm2": 0.2}, {"rays_per_face": 3}])
def test_faces_without_area_get_none(arguments, device):
    scene = scene_of(with_degenerate(np.random.default_rng(2), bowl()))
    e = scene.triangles_m - scene.triangles_m[:, :1]
    area = np.linalg.norm(np.cross(e[:, 1], e[:, 2]), axis=1)
    points, shading, geometric, face, _ = sampled(scene, device, **arguments)
    assert (area[face] > 0).all()
    assert np.isfinite(points).all()
    for normals in (shading, geometric):
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=NORMAL_TOLERANCE)


def test_no_face_with_area_is_an_error(device):
    scene = clradar.Scene(np.full((3, 3), 0.3), [[0, 1, 2]])
    with pytest.raises(MeshError, match="at least one face with an area"):
        clradar.trace(scene, ARRAY, device=device)


def test_as_many_samples_as_32_bits_count():
    scene = scene_of(plate(1.0, 0.3))  # 10^6 mm^2
    counts = samples_per_face(scene, resolve_settings(samples_per_mm2=2147.48))
    assert abs(counts.sum() - 2147.48e6) <= 2
    with pytest.raises(MeshError, match=r"fewer than 2\^31 samples, got 2147490000"):
        samples_per_face(scene, resolve_settings(samples_per_mm2=2147.49))


def test_random_numbers_never_reach_the_ends_of_their_interval(device):
    """2^24 cells would: the middle of the last one rounds to 1 in float32."""
    naive = "(float)(bits >> 8) * 0x1p-24f + 0x1p-25f"
    kernel = f"""
__kernel void ends(__global float *out) {{
    const uint bits = get_global_id(0) == 0 ? 0u : 0xFFFFFFFFu;
    out[2 * get_global_id(0)] = unit_interval(bits);
    out[2 * get_global_id(0) + 1] = {naive};
}}"""
    flags = ["-cl-std=CL1.2", "-DCLR_WIDTH=1"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Intel's compiler has remarks
        program = cl.Program(device.context, source("sample.cl") + kernel).build(flags)
    with Buffers(device) as buffers:
        out = buffers.empty(16)
        program.ends(device.queue, (2,), None, out).wait()
        low, high = buffers.read(out, (2, 2), np.float32)
    assert 0 < low[0] < high[0] < 1
    assert high[1] == 1


def test_random_words_are_those_of_the_published_generator():
    """Known answers of Philox4x32-10 from the Random123 distribution (kat_vectors)."""
    counters = np.array([[0] * 4, [0xFFFFFFFF] * 4], dtype=np.uint64)
    zero = [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    ones = [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]
    assert reference.philox(counters[:1], 0)[0].tolist() == zero
    assert reference.philox(counters[1:], 2**64 - 1)[0].tolist() == ones
    digits = np.array([[0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344]], dtype=np.uint64)
    key = 0x299F31D0 << 32 | 0xA4093822
    pi = [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1]
    assert reference.philox(digits, key)[0].tolist() == pi


def test_small_faces_have_samples_in_the_share_of_their_area():
    """On faces of a tenth of a sample each seed takes others, so that no face is left out."""
    scene = scene_of(plate(0.01, 0.3, 20))  # 800 faces of 0.125 mm2
    seeds, share = 150, 0.8 * 0.125
    counts = sum(
        samples_per_face(scene, resolve_settings(samples_per_mm2=0.8, seed=seed))
        for seed in range(seeds)
    )
    # Each count is binomial; 4.5 standard deviations leave a chance of 0.5 % to the worst of 800.
    assert np.abs(counts - seeds * share).max() <= 4.5 * np.sqrt(seeds * share * (1 - share))


RNG = np.random.default_rng(30)
ARRAYS = {
    "one": np.array([[0.01, 0.02, 0.0]]),
    "nine": RNG.uniform([-0.07, -0.07, 0], [0.07, 0.07, 0], (9, 3)),
    "imager": clradar.arrays.qar50().tx_m,
    "shuffled imager": RNG.permutation(clradar.arrays.qar50().tx_m),
    "scattered": RNG.uniform([-0.1, -0.1, -0.02], [0.1, 0.1, 0.02], (201, 3)),
    "all round": 0.6 * RNG.normal(size=(67, 3)) + [0, 0, 0.3],
    "along x": RNG.uniform([-0.9, -0.1, 0.2], [-0.8, 0.1, 0.4], (30, 3)),
    "same place": np.repeat([[0.0, 0.0, 0.1]], 70, axis=0),
}


SCENES = {
    "hand": None,  # made where it is used, since that takes a device
    "bowl": clradar.Scene(*bowl(40, 80)),
    # Fine enough that groups and rays are traced apart from their bundle.
    "fine ball": meshes.ball(100),
}


@cache
def body_of(name: str) -> clradar.Scene:
    return SCENES[name] or clradar.Scene.from_mesh(hand_mesh("F", edge_length_m=4e-3))


@pytest.mark.parametrize("scene", SCENES)
def test_shafts_and_single_rays_agree(scene):
    """The same bits from the kernel for CPUs, by shafts, and that for GPUs, ray by ray."""
    seen = []
    for width in (1, 8):
        device = clradar.open_device("pocl", width=width)
        with VisibleSurface(body_of(scene), 0.003, 3.0, device) as surface:
            seen.append({name: surface.visible_from(at) for name, at in ARRAYS.items()})
    for name in ARRAYS:
        np.testing.assert_array_equal(seen[0][name], seen[1][name], err_msg=name)
    both = np.concatenate(list(seen[0].values()), axis=1)
    assert 0.05 < both.mean() < 0.95  # there are enough of either to compare
