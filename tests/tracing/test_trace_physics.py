"""The tracer against closed forms: mirror, corner, shadow, sphere, and directions of a rough
surface."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2
from shapes import box, dihedral, plate, sphere

import clradar
from clradar import AntennaArray, Scene, Waveform, reference

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
        scene,
        array,
        samples_per_mm2=density,
        rays_per_sample=1,
        reception_radius_m=radius_m,
        device=device,
    )
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
    print(f"r {radius_m}: mean {error.mean():.4f}, worst {np.abs(error).max():.4f} rad")
    assert counts.min() >= 90
    assert np.abs(error).max() <= PHASE_TOLERANCE_RAD[radius_m]
    # The bias itself is that of the equation, to the factor of obliqueness (cos >= 0.94).
    assert abs(error.mean() / BIAS_RAD[radius_m] - 1) < 0.06


@pytest.mark.slow
def test_the_footprint_of_a_mirror_holds_as_many_paths_as_its_area(device):
    """Rays pass a sphere of radius r behind a mirror half way: pi (r / 2)^2 of the plate does
    it."""
    array = AntennaArray([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
    scene = Scene(*plate(0.1, PLATE_Z_M, 3), 0.0)
    paths = clradar.trace(scene, array, samples_per_mm2=50, rays_per_sample=1, device=device)
    expected = 50 * np.pi * 5**2
    # Stratified, so less than the noise of independent samples, and a rim of 30 mm x its spacing.
    assert abs(len(paths) - expected) <= 3 * np.sqrt(expected)


@pytest.mark.slow
def test_a_corner_has_the_length_of_its_image(device):
    """Two bounces in a right angle: the image lies on the other side of the corner's edge."""
    array = thinned(6)
    apex_m, size_m, radius_m = 0.35, 0.2, 0.005
    scene = Scene(*dihedral(size_m, apex_m), 0.0)
    paths = clradar.trace(
        scene,
        array,
        samples_per_mm2=4,
        rays_per_sample=1,
        max_bounces=2,
        reception_radius_m=radius_m,
        device=device,
    )
    twice = paths.bounces == 2
    assert twice.sum() > 10000
    image = array.tx_m * [-1, 1, -1] + [0, 0, 2 * apex_m]
    exact_m = np.linalg.norm(image[paths.tx] - array.rx_m[paths.rx], axis=1)
    excess_m = (paths.length_m - exact_m)[twice]
    # Unfolded, a path goes straight from the image to the last hit and bends there, by so little
    # that it ends at the centre of a sphere that it would have passed at rho <= r. No detour is
    # shorter than the straight line, and this one is longer by at most rho^2 / (2 a), a being
    # what the ray still has to go: not less than the nearest point of the dihedral is away.
    nearest_m = np.sqrt((apex_m - size_m / np.sqrt(2)) ** 2 - radius_m**2)
    rounding_m = 1e-6  # of the first hit, magnified by no more than the second segment's slant
    print(f"corner: excess {excess_m.min():.2e} to {excess_m.max():.2e} m")
    assert excess_m.min() >= -rounding_m
    assert excess_m.max() <= radius_m**2 / (2 * nearest_m) + rounding_m


def segment_meets_box(a, b, low, high) -> np.ndarray:
    """Slab test of the segments a to b, shapes (..., 3), in float64."""
    d = b - a
    with np.errstate(divide="ignore"):
        t0, t1 = (low - a) / d, (high - a) / d
    enter = np.minimum(t0, t1).max(axis=-1)
    leave = np.maximum(t0, t1).min(axis=-1)
    return (enter <= leave) & (leave > 0) & (enter < 1)


@pytest.mark.slow
def test_a_box_shadows_a_mirror(device):
    """Pairs whose whole footprint is behind the box, on either segment, get nothing from the plate;
    those whose footprint is clear get as much as without the box."""
    array = thinned(2)
    centre, size = np.array([0.01, -0.005, 0.2]), np.array([0.08, 0.06, 0.02])
    mirror = Scene(*plate(0.16, PLATE_Z_M, 5), 0.0)
    both = Scene.combine([Scene(*box(tuple(centre), tuple(size)), 0.0), mirror])
    arguments = {"samples_per_mm2": 2, "rays_per_sample": 1, "device": device}
    alone, shadowed = (clradar.trace(s, array, **arguments) for s in (mirror, both))

    image = array.tx_m * [1, 1, -1] + [0, 0, 2 * PLATE_Z_M]
    specular = (image[:, None] + array.rx_m) / 2  # half way, by symmetry
    # Clear and dark: no segment, or one of the segments, of any ray meets the box made larger, or
    # smaller, by the footprint's radius of 5 mm; rays pass the receiver at up to 10 mm, so nearer
    # to the box the second segment is up to 7 mm off.
    margin_m = 0.0075
    segments = [(np.broadcast_to(array.tx_m[:, None], specular.shape), specular)]
    segments.append((specular, np.broadcast_to(array.rx_m, specular.shape)))
    meets = [
        [segment_meets_box(a, b, centre - size / 2 - m, centre + size / 2 + m) for a, b in segments]
        for m in (margin_m, -margin_m)
    ]
    clear = ~(meets[0][0] | meets[0][1])
    dark = meets[1][0] | meets[1][1]
    assert clear.sum() > 300
    assert dark.sum() > 100

    def from_the_plate(paths):
        # The nearest specular path over the plate is 0.6 m long, the longest over the box 0.46 m.
        kept = paths.length_m > 0.55
        n = np.bincount(paths.pair[kept], minlength=specular.shape[0] * specular.shape[1])
        return n.reshape(specular.shape[:2])

    with_box, without = from_the_plate(shadowed), from_the_plate(alone)
    assert without.min() > 100
    assert (with_box[dark] == 0).all()
    # The random numbers of the two scenes differ, so compare within five standard deviations.
    noise = 5 * np.sqrt(with_box[clear] + without[clear])
    assert (np.abs(with_box[clear] - without[clear]) <= noise).all()


SPHERE_TOLERANCE_M = 0.1e-3
"""Mean path length against the specular path. An offset of the hit by rho adds about rho^2 (1 / z
+ 2 / R), on average 15 micrometres over the 0.8 mm that the sphere's curvature lets the 10 mm
receiver see; the chords of 1.6 mm faces lie up to 6 micrometres inside the sphere, which counts
twice. Three times that is left for the noise of 30 paths."""


@pytest.mark.slow
@pytest.mark.parametrize("distance_m", [0.25, 0.35])
def test_a_sphere_has_the_length_of_the_specular_path(distance_m, device):
    error_m = sphere_errors_m(distance_m, 5, "curved", device)
    print(f"sphere: {error_m.min() * 1e6:.1f} to {error_m.max() * 1e6:.1f} micrometres")
    assert np.abs(error_m).max() <= SPHERE_TOLERANCE_M


def test_a_sphere_of_coarse_faces_has_it_too(device):
    """Edges of 15 mm on a radius of 50 mm: flat faces lie up to 0.8 mm inside.

    Curved points are off by 23 micrometres at most with the sphere's own normals (tests of
    geometry/curved), there and back.
    """
    flat_m, curved_m = (sphere_errors_m(0.25, 2, facets, device) for facets in ("flat", "curved"))
    assert np.abs(curved_m).max() <= SPHERE_TOLERANCE_M + 2 * 23e-6
    assert flat_m.mean() > 5e-4


def sphere_errors_m(distance_m: float, subdivisions: int, facets: str, device) -> np.ndarray:
    """Mean path length of each pair over a mirroring sphere, less the specular path, metres."""
    array = thinned(12)
    radius_m = 0.05
    centre = np.array([0.01, -0.02, distance_m + radius_m])
    vertices, faces = sphere(tuple(centre), radius_m, subdivisions)
    # The cap towards the array is enough.
    faces = faces[vertices[faces].mean(axis=1)[:, 2] < centre[2] - 0.6 * radius_m]
    normals = (vertices - centre) / radius_m
    paths = clradar.trace(
        Scene(vertices, faces, 0.0, normals=normals if subdivisions < 5 else None),
        array,
        samples_per_mm2=40,
        rays_per_sample=1,
        facets=facets,
        device=device,
    )
    n_pairs = array.n_tx * array.n_rx
    counts = np.bincount(paths.pair, minlength=n_pairs)
    assert counts.min() >= 30
    mean_m = np.bincount(paths.pair, paths.length_m, n_pairs) / counts

    def point(angles):
        x, y = angles
        direction = np.array([np.sin(x), np.cos(x) * np.sin(y), -np.cos(x) * np.cos(y)])
        return centre + radius_m * direction

    exact_m = np.empty(n_pairs)
    for t, tx in enumerate(array.tx_m):
        for r, rx in enumerate(array.rx_m):
            # Of all points on the near side, the specular one has the shortest path (Fermat).
            def length(angles, tx=tx, rx=rx):
                p = point(angles)
                return np.linalg.norm(p - tx) + np.linalg.norm(p - rx)

            exact_m[t * array.n_rx + r] = minimize(length, [0.0, 0.0], tol=1e-12).fun
    return mean_m - exact_m


# --- the directions of a rough surface

CHI_SQUARE_P = 1e-3
"""Fixed seeds give one draw per case; a correct model fails with this probability when they
change."""


NORMAL = np.array([0.0, 0.0, -1.0])
ARRIVAL = np.array([np.sin(np.radians(35.0)), 0.0, np.cos(np.radians(35.0))])
MIRRORED = ARRIVAL - 2 * (ARRIVAL @ NORMAL) * NORMAL
RX_DISTANCE_M = 0.3


def half_space(n: int) -> tuple[np.ndarray, float]:
    """Directions all over the half space, and the half angle of caps around them that are disjoint.

    A ray thus meets at most one of the spheres.
    """
    height = (np.arange(n) + 0.5) / n
    turn = np.arange(n) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    axes = np.stack([ring * np.cos(turn), ring * np.sin(turn), -height], axis=1)
    gap = np.linalg.norm(axes[:, None] - axes, axis=2) + 2 * np.eye(n)
    return axes, float(np.arcsin(0.49 * gap.min()))


AXES, HALF_ANGLE = half_space(400)


@pytest.mark.filterwarnings("ignore:trace. the whole scene is within 0.01 mm")
@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.2, 0.35, 0.5, 0.7, 1.0])
def test_directions_of_a_rough_surface(alpha, device):
    """Receivers all over the half space, counted against the density that the model implies."""
    # A patch of 10 micrometres at 0.3 m: directions are known to 3e-5 of the spheres' size.
    patch = 1e-5 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    scene = Scene(patch, [[0, 1, 2]], alpha)
    paths = clradar.trace(
        scene,
        AntennaArray([-0.2 * ARRIVAL], RX_DISTANCE_M * AXES),
        rays_per_face=4096,
        rays_per_sample=128,
        reception_radius_m=RX_DISTANCE_M * np.sin(HALF_ANGLE),
        normals="face",
        seed=1,
        device=device,
    )
    rays = 4096 * 128
    assert paths.statistics.outgoing == rays
    assert paths.statistics.absorbed == 0
    counts = np.bincount(paths.rx, minlength=len(AXES))

    expected = rays * np.array(
        [
            reference.disc_probability(axis, HALF_ANGLE, NORMAL, NORMAL, MIRRORED, alpha)
            for axis in AXES
        ]
    )
    often = expected >= 20
    observed = np.append(counts[often], rays - counts[often].sum())
    wanted = np.append(expected[often], rays - expected[often].sum())
    statistic = ((observed - wanted) ** 2 / wanted).sum()
    p = chi2.sf(statistic, len(wanted) - 1)
    print(f"alpha {alpha}: chi2 {statistic:.1f} of {len(wanted) - 1}, p = {p:.3f}")
    assert often.sum() >= 8
    assert counts[expected == 0].sum() == 0
    assert p > CHI_SQUARE_P
