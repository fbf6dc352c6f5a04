"""The tracer against the float64 reference path by path, invariants, a mirror and a sphere."""

from typing import Any

import numpy as np
import pytest
from nightly import nightly
from shapes import bowl, box, dihedral, plate, random_soup, sphere

import calibration
import clradar
from clradar import AntennaArray, Paths, Scene, Waveform, reference
from clradar.errors import ModelError
from clradar.trace import trace as tracing
from clradar.tracing.sampled_surface import samples_per_face
from clradar.tracing.settings import resolve_settings
from clradar.tracing.stochastic import MOST_ORDINAL, Tracer

LENGTH_TOLERANCE_M = (3e-7, 3e-5, 1e-4)
"""For one, two and three bounces. A sample's coordinates are float32 numbers wrong by some
roundings of 2^-24 x 0.4 m, 2.4e-8 m each, and two path segments change by as much. Further bounces
start from where a ray meets a face, and rays start a little above the last one (1e-6 m in the
reference, 2 delta = 1.5e-6 m in the kernel): the difference, times the slant of the ray on the
face that it meets, up to 60 here, and for the third bounce once more three times. Still below a
fiftieth of the wavelength, 8e-5 m."""

FLIPPED_SHARE = 1e-3
"""Paths that only one of the two has. A direction is wrong by about 2e-7, so a ray passes a
receiver at 0.3 m wrong by 1e-7 m and is on the other side of a sphere of 0.02 m with a chance of
1e-5; rays that graze an edge add to that, and later bounces a hundredfold."""

AMPLITUDE_TOLERANCE = (1e-5, 1e-3, 3e-3)
"""Relative, for one, two and three bounces: the lengths' tolerance over segments of 0.1 m and
more, twice for the two lengths and once per power of the patterns' cosines; float32 itself for one
bounce."""


LOST_SHARE = 3e-6
"""Of the bounces in a closed box. One that lands within rounding, 3e-8 m, of an edge may start
its next segment on the wrong side of the adjoining wall: 2 m of edges x 2 x 3e-8 m out of 0.54 m^2
of walls are 4e-7 of the hits, and each costs up to three further bounces, and twice that for the
walls' diagonals."""


def random_array(seed: int, n_tx: int, n_rx: int) -> AntennaArray:
    rng = np.random.default_rng(seed)
    low, high = [-0.07, -0.07, 0.0], [0.07, 0.07, 0.01]
    return AntennaArray(rng.uniform(low, high, (n_tx, 3)), rng.uniform(low, high, (n_rx, 3)))


ARRAY = random_array(1, 9, 11)


def matched(got: Paths, expected: Paths) -> tuple[np.ndarray, np.ndarray, int]:
    """Rows of both that belong together, and how many of either have no partner.

    Both are in the order of pair, sample, ray and bounce; where one has a path that the other
    lacks, the comparison continues behind it.
    """
    tolerance = np.array(LENGTH_TOLERANCE_M)
    i = j = alone = 0
    mine, theirs = [], []
    a, b = got.pair, expected.pair

    def fits(m: int, n: int) -> bool:
        if m >= len(a) or n >= len(b) or a[m] != b[n] or got.bounces[m] != expected.bounces[n]:
            return False
        return abs(got.length_m[m] - expected.length_m[n]) <= tolerance[got.bounces[m] - 1]

    while i < len(a) and j < len(b):
        if fits(i, j):
            mine.append(i)
            theirs.append(j)
            i, j = i + 1, j + 1
            continue
        skips = [(s, t) for s in range(4) for t in range(4) if s + t > 0 and fits(i + s, j + t)]
        if skips:
            s, t = min(skips, key=sum)
        elif a[i] != b[j]:
            s, t = (1, 0) if a[i] < b[j] else (0, 1)
        else:
            s, t = 1, 1
        i, j, alone = i + s, j + t, alone + s + t
    return np.array(mine, int), np.array(theirs, int), alone + len(a) - i + len(b) - j


def check_against_reference(scene: Scene, device, array=ARRAY, **arguments) -> Paths:
    arguments = {"reception_radius_m": 0.02, "seed": 5, **arguments}
    got = tracing(scene, array, device=device, **arguments)
    settings = resolve_settings(**arguments)
    for name in ("samples_per_mm2", "rays_per_face"):
        arguments.pop(name, None)
    arguments["rays_per_sample"] = settings.rays_per_sample
    expected = reference.trace(scene, array, samples_per_face(scene, settings), **arguments)
    assert len(expected) >= 50
    mine, theirs, alone = matched(got, expected)
    assert alone <= max(1, FLIPPED_SHARE * len(expected)), f"{alone} of {len(expected)}"
    error = np.abs(got.amplitude[mine].astype(float) / expected.amplitude[theirs] - 1)
    assert (error <= np.array(AMPLITUDE_TOLERANCE)[got.bounces[mine] - 1]).all()
    return got


@pytest.mark.filterwarnings("ignore:the scene lies behind the aperture")
def test_receivers_that_fill_up_a_group_receive_nothing(device):
    """A mirror sends rays past all receivers to the place that the padding had, 1.7 km away."""
    array = AntennaArray(np.eye(3)[:2] * 1e-3, np.eye(3) * 1e-3)
    across = np.array([[1.0, -1, 0], [-1, -1, 2], [-1, 2, -1]])
    scene = Scene(-0.5 + 1e-3 * across, [[0, 1, 2]], 0.0)
    paths = tracing(scene, array, device=device, rays_per_face=500, reception_radius_m=1.0)
    assert len(paths) == 500 * array.n_tx * array.n_rx
    np.testing.assert_allclose(paths.length_m, np.sqrt(3), rtol=1e-2)


def mixed(mesh, seed: int = 2) -> Scene:
    """A scene with its own alpha on every face, both ends included."""
    alpha = np.random.default_rng(seed).uniform(0, 1, len(mesh[1]))
    alpha[::7], alpha[1::7] = 0.0, 1.0
    return Scene(*mesh, alpha)


SCENES = {
    "plate": mixed(plate(0.2, 0.3, 3)),
    "waves": mixed(plate(0.2, 0.3, 7, wavy_m=0.01)),
    "bowl": mixed(bowl()),
    "sphere": mixed(sphere((0.02, 0, 0.3), 0.05, 2)),
    "dihedral": mixed(dihedral(0.2, 0.35)),
    "box before a plate": Scene.combine(
        [mixed(box((0, 0, 0.2), (0.05, 0.05, 0.02))), mixed(plate(0.2, 0.3, 2))]
    ),
    "soup": mixed(random_soup(np.random.default_rng(3), 40, 0.08)),
}


FEW = {"samples_per_mm2": 0.015, "rays_per_sample": 2}
SPREADING = {"amplitude": "spreading", "pattern_exponent": 2.5, "seed": 2**64 - 1}
CASES: dict[str, tuple[str, float | None, dict[str, Any]]] = {
    **{name: (name, None, FEW) for name in ("plate", "waves", "sphere", "box before a plate")},
    **{f"{n}, 3": (n, None, FEW | {"max_bounces": 3}) for n in ("bowl", "dihedral", "soup")},
    **{f"{name}, 2": (name, None, FEW | {"max_bounces": 2}) for name in SCENES},
    "the faces' normals": ("box before a plate", 0.2, FEW | {"max_bounces": 2, "normals": "face"}),
    "a mirror": ("waves", 0.0, FEW | {"max_bounces": 2, "crease_deg": 60.0}),
    "spreading": ("bowl", None, FEW | SPREADING | {"max_bounces": 2}),
    "by face": ("waves", None, {"rays_per_face": 2, "rays_per_sample": 3}),
}
"""Scene, another alpha for it, and settings."""

AT_NIGHT = [f"{name}, 2" for name in SCENES]


@pytest.mark.parametrize("name", [n for n in CASES if n not in AT_NIGHT] + nightly(AT_NIGHT))
def test_paths_are_those_of_the_reference(name, device):
    scene, alpha, settings = CASES[name]
    body = SCENES[scene] if alpha is None else SCENES[scene].with_alpha(alpha)
    got = check_against_reference(body, device, **settings)
    most = settings.get("max_bounces", 1)
    assert got.bounces.max() <= most
    if most == 3:
        assert (got.bounces > 1).sum() >= 20
    if "rays_per_face" in settings:
        assert got.statistics.samples == 2 * body.n_faces
        assert got.statistics.outgoing == got.statistics.visible * 3


@pytest.mark.filterwarnings("ignore:the scene lies behind")
def test_patterns_are_zero_behind_the_antennas(device):
    """The scene is behind the radar: nothing leaves towards it and nothing arrives from it."""
    scene = Scene(*plate(0.2, -0.3, 3), 0.5)
    arguments = {"samples_per_mm2": 0.05, "amplitude": "spreading", "device": device}
    assert (tracing(scene, ARRAY, **arguments).amplitude > 0).all()
    paths = tracing(scene, ARRAY, pattern_exponent=1.0, **arguments)
    assert len(paths) > 0
    assert (paths.amplitude == 0).all()


# --- buffers and numbers


def test_what_is_counted_in_32_bits_stays_below_them(device):
    """Pairs of an array; rays times pairs of a tile."""
    settings = resolve_settings(samples_per_mm2=1.0, rays_per_sample=2**16, max_bounces=2)
    many = clradar.arrays.qar50()
    with Tracer(SCENES["plate"], many, settings, device) as tracer:
        rays = 2**16 * 2 * many.n_tx * many.n_rx
        assert tracer.n_samples > 10
        assert tracer._tile_samples == MOST_ORDINAL // rays == 3
    assert MOST_ORDINAL == 2**32 - 1
    at_m = np.linspace([0.0, 0, 0], [0.1, 0, 0], 2**16)
    Tracer(SCENES["plate"], AntennaArray(at_m, at_m[1:]), settings, device)
    with pytest.raises(ModelError, match=r"fewer than 2\^32 pairs, got 65536 x 65536"):
        Tracer(SCENES["plate"], AntennaArray(at_m, at_m), settings, device)


# --- closed forms and invariants


@pytest.mark.filterwarnings("ignore:the scene reaches behind")
def test_antennas_in_a_closed_box_receive_only_from_its_inside(device):
    """Both path segments and all bounces stay in: no path is longer than bounces + 1 diagonals."""
    size_m = 0.3
    shell = Scene(*box((0, 0, 0.05), (size_m,) * 3), 0.7)
    outside = Scene(*sphere((0, 0, 0.4), 0.1, 2), 0.7)
    arguments = {"samples_per_mm2": 0.02, "max_bounces": 4, "device": device}
    for scene in (shell, Scene.combine([shell, outside])):
        paths = tracing(scene, ARRAY, **arguments)
        assert len(paths) > 4e4
        assert (paths.length_m <= (paths.bounces + 1.0) * size_m * np.sqrt(3)).all()
        # Every antenna is visible from the samples of the box, none from those of the sphere, and
        # each ray bounces up to the limit.
        n = paths.statistics
        assert n.visible == int(6 * 300 * 300 * 0.02) * 9
        assert n.visible * 4 * 4 * (1 - LOST_SHARE) <= n.outgoing <= n.visible * 4 * 4
        assert n.absorbed == 0


def test_absorbed_fraction(device):
    """alpha = 1: a draw around a normal that leans by theta from the face's is below the face with
    probability (1 - cos theta) / 2; with the face's own normal it never is. Counts add up."""
    lean = np.radians(50.0)
    normals = np.tile([np.sin(lean), 0.0, -np.cos(lean)], (4, 1))
    scene = Scene(*plate(0.2, 0.3), 1.0, normals=normals)
    tx = AntennaArray([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.01]])
    arguments = {"samples_per_mm2": 0.3, "rays_per_sample": 16, "device": device}
    assert tracing(scene, tx, normals="face", **arguments).statistics.absorbed == 0
    first, second = (tracing(scene, tx, seed=i, **arguments).statistics for i in range(2))
    n = first + second
    assert n.outgoing == n.visible * 16 == n.samples * 16 == 2 * 0.3 * 200**2 * 16
    share = (1 - np.cos(lean)) / 2
    # Binomial: four standard deviations.
    assert abs(n.absorbed_share - share) <= 4 * np.sqrt(share * (1 - share) / n.outgoing)


CARRIER_HZ = 77e9

PLATE_Z_M = 0.3

PHASE_TOLERANCE_RAD = {0.010: 0.1, 0.005: 0.03}
"""Reception sphere's radius in metres to the largest phase error of any pair. A ray that passes the
receiver at distance rho met the plate rho / 2 from the specular point, and its path is longer by
rho^2 / (2 x 2 z cos): on average r^2 / (8 z) = 42 micrometres or -0.067 rad at 77 GHz and 10 mm for
normal incidence, four times less at 5 mm. The rest of the tolerance is the noise of 100 paths whose
phases spread by 0.039 rad (10 mm): 0.004 rad, and five standard deviations of that."""

BIAS_RAD = {0.010: -0.0673, 0.005: -0.0168}
"""2 pi f / c x r^2 / (8 z), of which oblique pairs have a little less."""


def thinned(step: int) -> AntennaArray:
    """Every `step`-th antenna of the imager, in both rows and columns."""
    array = clradar.arrays.qar50()
    return AntennaArray(array.tx_m[::step], array.rx_m[::step])


def phase_errors(radius_m: float, array: AntennaArray, scene: Scene, density: float, device):
    """Phase of every pair's phasor sum against that of the image source, radians, and path
    counts."""
    paths = clradar.trace(
        scene, array, samples_per_mm2=density, rays_per_sample=1, reception_radius_m=radius_m,
        device=device,
    )  # fmt: skip
    image = array.tx_m * [1, 1, -1] + [0, 0, 2 * PLATE_Z_M]
    exact_m = np.linalg.norm(image[:, None] - array.rx_m, axis=2)
    waveform = Waveform(np.array([CARRIER_HZ]))
    data = clradar.synthesize(paths, array, waveform, device=device).data[:, :, 0]
    turned = data * np.exp(2j * np.pi * CARRIER_HZ / 299_792_458.0 * exact_m)
    counts = np.bincount(paths.pair, minlength=array.n_tx * array.n_rx)
    return np.angle(turned), counts.reshape(array.n_tx, array.n_rx)


@pytest.mark.parametrize(
    "step", [3, pytest.param(1, marks=pytest.mark.slow)], ids=["every third", "all"]
)
@pytest.mark.parametrize("radius_m", [0.010, 0.005])
def test_a_mirror_has_the_phase_of_the_image_source(radius_m, step, device):
    array = thinned(step)
    # Every specular point is within 72 mm, and its footprint within 5 mm of it.
    scene = Scene(*plate(0.16, PLATE_Z_M, 5), 0.0)
    # 130 paths in a footprint of pi (r / 2)^2.
    density = 130 / (np.pi * (radius_m * 1e3 / 2) ** 2)
    error, counts = phase_errors(radius_m, array, scene, density, device)
    assert counts.min() >= 90
    assert np.abs(error).max() <= PHASE_TOLERANCE_RAD[radius_m]
    # The bias itself is that of the equation, to the factor of obliqueness (cos >= 0.94).
    assert abs(error.mean() / BIAS_RAD[radius_m] - 1) < 0.06


SPHERE_TOLERANCE_M = 0.1e-3
"""Mean path length against the specular path. An offset of the hit by rho adds about rho^2 (1 / z
+ 2 / R), on average 15 micrometres over the 0.8 mm that the sphere's curvature lets the 10 mm
receiver see; the chords of 1.6 mm faces lie up to 6 micrometres inside the sphere, which counts
twice. Three times that is left for the noise of 30 paths."""


def test_a_sphere_has_the_length_of_the_specular_path(device):
    """Of edges of 15 mm on a radius of 50 mm: flat faces lie up to 0.8 mm inside.

    Curved points are off by 23 micrometres at most with the sphere's own normals (tests of
    geometry/curved), there and back.
    """
    flat_m, curved_m = (sphere_errors_m(facets, device) for facets in ("flat", "curved"))
    assert np.abs(curved_m).max() <= SPHERE_TOLERANCE_M + 2 * 23e-6
    assert flat_m.mean() > 5e-4


def sphere_errors_m(facets: str, device) -> np.ndarray:
    """Mean path length of each pair over a mirroring sphere, less the specular path, metres."""
    array, radius_m = thinned(12), 0.05
    centre = np.array([0.01, -0.02, 0.25 + radius_m])
    vertices, faces = sphere(tuple(centre), radius_m, 2)
    # The cap towards the array is enough.
    faces = faces[vertices[faces].mean(axis=1)[:, 2] < centre[2] - 0.6 * radius_m]
    cap = Scene(vertices, faces, 0.0, normals=(vertices - centre) / radius_m)
    paths = clradar.trace(
        cap, array, samples_per_mm2=40, rays_per_sample=1, facets=facets, device=device
    )
    n_pairs = array.n_tx * array.n_rx
    counts = np.bincount(paths.pair, minlength=n_pairs)
    assert counts.min() >= 30
    mean_m = np.bincount(paths.pair, paths.length_m, n_pairs) / counts

    # Which test_calibration_targets.py compares with the shortest path over all points (Fermat).
    return mean_m - calibration.Sphere(centre, radius_m).echo(array).length_m.ravel()
