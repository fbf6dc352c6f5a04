"""The tracer against closed forms: mirror and sphere; tests of truths have corners."""

import numpy as np
import pytest
from scipy.optimize import minimize
from shapes import plate, sphere

import clradar
from clradar import AntennaArray, Scene, Waveform

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
