"""The expected estimator: its probabilities, and the mean of the stochastic one."""

from collections.abc import Iterator

import numpy as np
import pytest
from nightly import nightly
from scipy.stats import chi2
from shapes import bowl, box, plate, sphere

import clradar
from clradar import AntennaArray, Scene, Waveform, reference
from clradar.tracing.expected import ExpectedTracer
from clradar.tracing.sampled_surface import samples_per_face
from clradar.tracing.settings import SimulationSettings, resolve_settings

# Meshes are coarse and samples few, so that the reference is cheap; both reflect at the same faces.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*that stay sharp",
    "ignore:simulate. .* faces too coarse:clradar.ClradarWarning",
    "ignore:.* received no ray:clradar.ClradarWarning",
)


WAVEFORM = Waveform.sfcw(72e9, 82e9, 3)
FULL = clradar.arrays.qar50()
ARRAY = AntennaArray(FULL.tx_m[::19], FULL.rx_m[::9])
"""5 x 11. The Rx are 27 mm apart, so that no two spheres of 10 mm overlap."""

FEW = AntennaArray(FULL.tx_m[::40], FULL.rx_m[::18])
"""3 x 6."""

# --- the probabilities of the kernel against the reference


SHARE_TOLERANCE = 6e-3
"""Of the largest probability of the case: discs that the lobe's edge cuts, six slices per piece,
5.3e-3 at worst over all alpha (docs/estimators.md); with what the reference leaves."""

MEAN_TOLERANCE = 1e-3
"""Of the sum of all probabilities: 6e-4 at worst, and the reference's."""


def expectations(
    scene: Scene, array: AntennaArray, settings: SimulationSettings, device
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield pair, length and amplitude of some paths at a time, as the phasor sum gets them."""
    with ExpectedTracer(scene, array, settings, device) as tracer:
        for tile in tracer.tiles():
            assert len(tile.start) == array.n_tx * array.n_rx + 1
            assert tile.start[0] == 0
            n = int(tile.start[-1])
            pair = np.repeat(np.arange(array.n_tx * array.n_rx), np.diff(tile.start.astype(int)))
            length = tracer._buffers.read(tile.length, (n, 2), np.float32).astype(float).sum(axis=1)
            assert length.max(initial=0.0) <= tile.longest_m
            yield pair, length, tracer._buffers.read(tile.amplitude, n, np.float32)


def shares(scene: Scene, device, tolerance: float = SHARE_TOLERANCE, **arguments) -> np.ndarray:
    """What the kernel finds, as the reference orders it: (n_samples, n_tx, n_rx)."""
    settings = resolve_settings(rays_per_sample=1, estimator="expected", **arguments)
    counts = samples_per_face(scene, settings)
    names = ("normals", "crease_deg", "reception_radius_m", "seed")
    wanted, length = reference.expected(
        scene, FEW, counts, **{k: getattr(settings, k) for k in names}
    )
    found = np.zeros_like(wanted)
    for tile in expectations(scene, FEW, settings, device):
        for pair, length_m, share in zip(*tile, strict=True):
            tx, rx = divmod(int(pair), FEW.n_rx)
            off = np.abs(length[:, tx, rx] - length_m)
            # A sample's coordinates in float32, twice; paths of a pair are in the order of samples.
            alike = np.flatnonzero((off < 1e-7) & (found[:, tx, rx] == 0))
            assert len(alike) > 0
            s = int(alike[0])
            found[s, tx, rx] = share
    peak = wanted.max()
    assert peak > 0
    assert np.abs(found - wanted).max() <= tolerance * peak
    assert abs(found.sum() / wanted.sum() - 1) <= MEAN_TOLERANCE
    return found


ALPHAS = [0.0, 0.05, 0.4999, *nightly([1e-4, 0.2, 0.5, 0.5001, 1.0])]


@pytest.mark.parametrize("alpha", ALPHAS)
def test_probabilities_are_those_of_the_reference(alpha, device):
    scene = Scene(*plate(0.16, 0.3, 4, wavy_m=0.01), alpha)
    found = shares(scene, device, rays_per_face=1, crease_deg=180.0, reception_radius_m=0.02)
    assert (found > 0).sum() >= (12 if alpha >= 0.05 else 4)


def test_large_discs_that_the_horizon_of_the_face_cuts(device):
    """Near a mesh whose normals are not those of its faces. The density has a step in them, which
    four slices hold to 1.5e-2 of a probability, and to 5e-5 in the mean."""
    scene = Scene(*plate(0.16, 0.15, 3, wavy_m=0.02), 0.3)
    shares(scene, device, 0.02, rays_per_face=1, crease_deg=180.0, reception_radius_m=0.1)


def test_settings_reach_the_kernel(device):
    settings = {"normals": "face", "seed": 2**40 + 3, "reception_radius_m": 0.005}
    shares(Scene(*plate(0.16, 0.3, 3, wavy_m=0.02), 0.3), device, rays_per_face=1, **settings)


# --- the mean of the stochastic estimator over the same samples

CHI_SQUARE_P = 1e-3
"""Seeds are fixed; a correct program fails with this probability per case when they change."""


MESHES = {
    "plate": plate(0.2, 0.3, 1),
    "waves": plate(0.2, 0.3, 7, wavy_m=0.01),
    "steep waves": plate(0.2, 0.3, 8, wavy_m=0.03),
    "sphere": sphere((0.02, 0.0, 0.3), 0.05, 2),
    "bowl": bowl(),
}


def check_mean(scene: Scene, device, rays: int = 1500, **arguments) -> float:
    """One seed, so the same samples; many rays from each, every one of them another draw: which
    share of these is absorbed.

    The number of receptions of a pair is a sum of independent draws, one per sample and ray, with
    the mean sum P and the variance sum P (1 - P). Pairs are independent but for those of one Tx,
    whose spheres compete for a ray: that makes the sum of squares smaller, not larger.
    """
    common = {"samples_per_mm2": 0.015, "rays_per_sample": rays, "seed": 1, **arguments}
    paths = clradar.trace(scene, ARRAY, device=device, **common)
    n_pairs = ARRAY.n_tx * ARRAY.n_rx
    found = np.bincount(paths.pair, minlength=n_pairs)
    mean, variance = np.zeros((2, n_pairs))
    settings = resolve_settings(estimator="expected", **common)
    for pair, _, amplitude in expectations(scene, ARRAY, settings, device):
        share = amplitude.astype(float) / rays
        mean += np.bincount(pair, rays * share, n_pairs)
        variance += np.bincount(pair, rays * share * (1 - share), n_pairs)
    often = variance > 5
    assert often.sum() >= 10
    z = (found - mean)[often] / np.sqrt(variance[often])
    statistic = float((z**2).sum())
    assert chi2.sf(statistic, len(z)) > CHI_SQUARE_P
    # Five standard deviations of at most 5; and of the total, whose variance is no larger.
    assert (np.abs(found - mean)[~often] <= 5 * np.sqrt(5)).all()
    assert abs(found.sum() - mean.sum()) <= 4 * np.sqrt(variance.sum())
    return paths.statistics.absorbed_share


@pytest.mark.parametrize(
    ("name", "alpha"),
    [
        *[("waves", 0.35), ("steep waves", 0.8)],
        *nightly(("waves", alpha) for alpha in (0.02, 0.1, 0.2, 0.5, 0.7, 1.0)),
        *nightly([("sphere", 0.15), ("plate", 0.6), ("bowl", 0.6)]),
    ],
)
def test_the_mean_is_that_of_the_stochastic_estimator(name, alpha, device):
    """Where many rays are absorbed, too."""
    smooth = {"crease_deg": 180.0} if name == "steep waves" else {}
    lost = check_mean(Scene(*MESHES[name], alpha), device, **smooth)
    assert lost > (0.01 if name == "steep waves" else -1)


def test_amplitudes_with_spreading_and_patterns(device):
    """A small patch, for which the amplitude of each pair is one number."""
    centre, size_m = np.array([0.02, -0.01, 0.25]), 1e-3
    corners = centre + size_m * np.array([[0, 0, 0], [1, 0.1, 0.2], [0, 1, -0.1]])
    scene = Scene(corners, [[0, 1, 2]], 0.6)
    common = {"rays_per_face": 4, "estimator": "expected", "device": device}
    unit = clradar.simulate(scene, ARRAY, WAVEFORM, **common).data
    spread = clradar.simulate(
        scene, ARRAY, WAVEFORM, amplitude="spreading", pattern_exponent=1.5, **common
    ).data
    out, back = centre - ARRAY.tx_m, ARRAY.rx_m - centre
    r1, r2 = np.linalg.norm(out, axis=1), np.linalg.norm(back, axis=1)
    cosines = (out[:, 2] / r1)[:, None] * (-back[:, 2] / r2)
    weight = cosines**1.5 / (r1[:, None] * r2)
    # Both segments and their cosines change by the patch's 1 mm in 0.25 m, once per exponent.
    np.testing.assert_allclose(
        np.abs(spread) / np.abs(unit), weight[..., None] + 0 * np.abs(unit), rtol=0.02
    )


# --- occlusion


@pytest.mark.parametrize(("edge_m", "counts"), [(0.0015, True), (-0.0015, False)])
def test_a_receiver_hidden_in_part_counts_by_its_centre(edge_m, counts, device):
    """The approximation: an edge across the sphere's disc hides a third or two thirds of it, and
    with the centre nothing or all."""
    array = AntennaArray([[0.0, 0.1, 0.0]], [[0.0, 0.0, 0.0]])
    mirror = Scene(*plate(0.002, 0.3, 1), 0.7)
    # Half way, where an edge 1.5 mm beside the ray to the centre is 3 mm beside it at the sphere.
    screen = Scene(*box((edge_m + 0.05, 0.0, 0.15), (0.1, 0.04, 0.002)), 0.7)
    settings = resolve_settings(estimator="expected", rays_per_face=8)
    alone, both = (
        sum(a[length_m > 0.55].sum() for _, length_m, a in expectations(s, array, settings, device))
        for s in (mirror, Scene.combine([mirror, screen]))
    )
    assert alone > 0
    assert both == (alone if counts else 0)


# --- one lane


"""Products may be fused with sums in one build and not in the other: roundings of 6e-8, which
decide where a horizon cuts a disc and are magnified by up to a disc's 1/0.03 there."""


LANES_TOLERANCE = 1e-4
"""Products may be fused with sums in one build and not in the other: roundings of 6e-8, which
decide where a horizon cuts a disc and are magnified by up to a disc's 1/0.03 there."""


@pytest.mark.parametrize(("n_tx", "n_rx"), [(1, 1), (2, 23)])
def test_one_lane_gives_the_same(n_tx, n_rx, device):
    rng = np.random.default_rng(n_rx)
    low, high = [-0.07, -0.07, 0.0], [0.07, 0.07, 0.01]
    array = AntennaArray(rng.uniform(low, high, (n_tx, 3)), rng.uniform(low, high, (n_rx, 3)))
    one, eight = (
        clradar.simulate(
            Scene(*MESHES["waves"], 0.3), array, WAVEFORM, samples_per_mm2=0.02,
            estimator="expected", device=clradar.open_device(device.info.selector, width=width),
        ).data
        for width in (1, 8)
    )  # fmt: skip
    assert np.abs(eight).max() > 0
    assert np.abs(one - eight).max() <= LANES_TOLERANCE * np.abs(eight).max()


def test_a_sample_inside_a_sphere_is_received_from_every_direction(device):
    """As in the stochastic model: a ray that starts inside enters at once."""
    scene = Scene(*plate(0.001, 0.3, 1), 0.4)
    array = AntennaArray([[0.0, 0.0, 0.0]], [[0.001, 0.0, 0.298], [0.001, 0.0, 0.302]])
    arguments = {"rays_per_face": 2, "rays_per_sample": 5, "device": device}
    one, two = (
        clradar.simulate(scene, array, WAVEFORM, estimator=e, **arguments).data
        for e in ("stochastic", "expected")
    )
    np.testing.assert_allclose(two, one, rtol=0, atol=2e-3 * 20)
    assert np.abs(one).min() > 15
