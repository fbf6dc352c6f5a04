"""Antenna patterns, and with them the absolute scale of images and samples, in dBsm."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import clradar
from clradar import AntennaArray, AntennaPattern, Capture, Scene, VoxelGrid, Waveform
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ModelError
from clradar.model import ImageScale
from clradar.model.range_profile import antenna_subset

# Cosines, roots and powers of float64, a few units in the last place.
ROUNDING = 1e-14
TABLE = {"angle_deg": [0.0, 90.0, 180.0], "field": [1.0, 0.5, 0.0]}


def cosines(*angles_deg: float) -> np.ndarray:
    return np.cos(np.deg2rad(angles_deg))


def test_power_of_the_cosine_is_zero_behind():
    pattern = AntennaPattern(gain_dbi=20.0, exponent=2.0)
    found = pattern.amplitude(np.array([[1.0, 0.5], [0.0, -0.5]]))
    assert np.allclose(found, [[10, 2.5], [0, 0]], atol=ROUNDING)


def test_table_is_linear_over_angle():
    found = AntennaPattern(gain_dbi=6.0, **TABLE).amplitude(cosines(0, 45, 90, 135, 180))
    assert np.allclose(found, 10**0.3 * np.array([1, 0.75, 0.5, 0.25, 0]), atol=10 * ROUNDING)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"gain_dbi": 200}, "gain_dbi: expected within 100 dB"),
        ({"exponent": -1}, r"exponent: .* in \[0, 10000\], got -1"),
        ({"exponent": 1, **TABLE}, "exponent: expected 0 beside a table"),
        ({"angle_deg": [0, 180]}, "expected both or neither"),
        ({"angle_deg": [0, 90], "field": [1, 0]}, "from 0 to 180 degrees, got 0 to 90"),
        ({"angle_deg": [0, 90, 90, 180], "field": [1, 1, 1, 0]}, "strictly ascending"),
        ({**TABLE, "field": [1, 0]}, r"field: expected shape \(3,\)"),
        ({**TABLE, "field": [0, 0, 0]}, "amplitudes >= 0, not all of them 0"),
    ],
)
def test_refused(fields, message):
    with pytest.raises(ModelError, match=message):
        AntennaPattern(**fields)


def test_equal_by_value():
    patterns = [
        AntennaPattern(),
        AntennaPattern(gain_dbi=3),
        AntennaPattern(exponent=1),
        AntennaPattern(**TABLE),
        AntennaPattern(**{**TABLE, "field": [1.0, 0.5, 0.1]}),
    ]
    for i, one in enumerate(patterns):
        copy = pickle.loads(pickle.dumps(one))
        assert [copy == other for other in patterns] == [i == j for j in range(len(patterns))]
        assert hash(copy) == hash(one)
    assert AntennaPattern() != 1


def patterned() -> AntennaArray:
    q = clradar.arrays.qar50()
    return AntennaArray(
        q.tx_m[::12], q.rx_m[::12], "few", AntennaPattern(3.0, 1.0), AntennaPattern(**TABLE)
    )


def test_array_keeps_its_patterns():
    array = patterned()
    plain = replace(array, tx_pattern=None, rx_pattern=None)
    assert array.same_positions(plain)
    assert (plain.has_patterns, array.has_patterns) == (False, True)
    capture = clradar.Capture(np.ones((8, 8, 3)), array, clradar.Waveform.sfcw(72e9, 82e9, 3))
    part = array.part([True] * 4 + [False] * 4, slice(2))
    for other in (pickle.loads(pickle.dumps(array)), part, antenna_subset(capture, 16).array):
        assert other.name == "few"
        assert (other.tx_pattern, other.rx_pattern) == (array.tx_pattern, array.rx_pattern)
    assert part.tx_m.tolist() == array.tx_m[:4].tolist()
    assert part.rx_m.tolist() == array.rx_m[:2].tolist()


def test_estimators_without_patterns_refuse_them():
    scene = clradar.Scene([[0, 0, 0.3], [0.1, 0, 0.3], [0, 0.1, 0.3]], [[0, 1, 2]], alpha=0.0)
    array, waveform = patterned(), clradar.Waveform.sfcw(72e9, 82e9, 3)
    paths = clradar.Paths([0], [0], [0.6], [1.0], [1], n_tx=8, n_rx=8)
    for run in (
        lambda: clradar.simulate(scene, array, waveform),
        lambda: clradar.simulate(scene, array, waveform, estimator="expected"),
        lambda: clradar.trace(scene, array),
        lambda: clradar.synthesize(paths, array, waveform),
    ):
        with pytest.raises(ModelError, match="only estimator='physical' takes"):
            run()


Q = clradar.arrays.qar50()
ARRAY = AntennaArray(Q.tx_m[::8], Q.rx_m[::7])
WAVEFORM = Waveform.sfcw(72e9, 82e9, 24)
PATTERNED = replace(
    ARRAY,
    tx_pattern=AntennaPattern(5.0, 1.5),
    rx_pattern=AntennaPattern(-2.0, 0.0, [0, 20, 60, 90, 180], [1, 0.9, 0.3, 0.05, 0]),
)

# NODE_ERROR of either side, float32 of image and scale: 2e-4 of the amplitude is 0.002 dB.
SCALE_DB = 0.002


def spreading(array: AntennaArray, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a/R of each Tx and Rx at points, from the equation, shape (n, points)."""
    sides = []
    for antennas_m, pattern in (
        (array.tx_m, array.tx_pattern),
        (array.rx_m, array.rx_pattern),
    ):
        to = points_m - antennas_m[:, None]
        distance = np.linalg.norm(to, axis=2)
        amplitude = (pattern or AntennaPattern()).amplitude(to[..., 2] / distance)
        sides.append(amplitude / distance)
    return sides[0], sides[1]


def echo(array: AntennaArray, tx_leg_m: np.ndarray, rx_leg_m: np.ndarray, u: np.ndarray) -> Capture:
    """Return S-parameters by the radar equation of a field u (1/m) over path lengths."""
    length = np.broadcast_to(tx_leg_m + rx_leg_m, u.shape)[..., None]
    wavelength = SPEED_OF_LIGHT_M_PER_S / WAVEFORM.frequencies_hz
    samples = wavelength / (4 * np.pi) * u[..., None] * np.exp(-2j * np.pi * length / wavelength)
    return Capture(samples, array, WAVEFORM, {"absolute": True})


def point_target(array: AntennaArray, at_m: np.ndarray, rcs_m2: float) -> Capture:
    tx, rx = (side[:, 0] for side in spreading(array, at_m[None]))
    legs = [np.linalg.norm(antennas - at_m, axis=1) for antennas in (array.tx_m, array.rx_m)]
    u = np.sqrt(rcs_m2 / (4 * np.pi)) * tx[:, None] * rx
    return echo(array, legs[0][:, None], legs[1], u)


def grid_around(at_m: np.ndarray) -> VoxelGrid:
    return VoxelGrid(at_m - 1e-3, [1e-3] * 3, (3, 3, 3))


@pytest.mark.device
@pytest.mark.parametrize("array", [ARRAY, PATTERNED], ids=["isotropic", "patterns"])
@pytest.mark.parametrize(
    ("at_m", "window"), [((0.09, -0.07, 0.26), "rect"), ((0.0, 0.02, 1.2), "hann")]
)
def test_a_point_target_reads_its_cross_section(array, window, at_m):
    at = np.array(at_m)
    capture = point_target(array, at, 10**-2.35)
    image = clradar.backproject(capture, grid_around(at), window=window, check_grid=False)
    assert image.rcs_dbsm()[1, 1, 1] == pytest.approx(-23.5, abs=SCALE_DB)
    relative = clradar.backproject(replace(capture, meta={}), grid_around(at), check_grid=False)
    with pytest.raises(ModelError, match="image on an absolute scale"):
        relative.rcs_dbsm()


@pytest.mark.parametrize("array", [ARRAY, PATTERNED], ids=["isotropic", "patterns"])
def test_scale_is_that_of_the_equation_everywhere(array):
    grid = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.16, 0.34), 5e-3)
    weights = np.linspace(0.5, 1.0, WAVEFORM.n_freq)
    found = ImageScale(array, WAVEFORM, weights).of_square_metre(grid)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    tx, rx = spreading(array, np.stack([x, y, z], axis=-1).reshape(-1, 3))
    wavelengths = SPEED_OF_LIGHT_M_PER_S / WAVEFORM.frequencies_hz
    mean = np.mean(weights * wavelengths / (4 * np.pi))
    wanted = mean / np.sqrt(4 * np.pi) * tx.mean(axis=0) * rx.mean(axis=0)
    assert np.abs(20 * np.log10(found.ravel() / wanted)).max() < SCALE_DB


def sphere(radius_m: float, range_m: float) -> Capture:
    """Return the echo of a metal sphere by geometrical optics: u = a / 2 d (d + a) face to face."""
    centre = np.array([0.0, 0.0, range_m])
    antennas = ARRAY.tx_m, ARRAY.rx_m
    away = [np.linalg.norm(a - centre, axis=1) for a in antennas]
    towards = [(a - centre) / d[:, None] for a, d in zip(antennas, away, strict=True)]
    # The specular point lies between the directions to both antennas, in the middle if they are
    # as far away; its path is shorter than that of the point that faces the origin.
    half = np.arccos(np.clip(towards[0] @ towards[1].T, -1, 1)) / 2
    lengths = [
        np.sqrt(d**2 + radius_m**2 - 2 * radius_m * d * np.cos(half))
        for d in (away[0][:, None], away[1])
    ]
    u = radius_m / 2 / (lengths[0] * lengths[1] + radius_m * (lengths[0] + lengths[1]) / 2)
    return echo(ARRAY, lengths[0], lengths[1], u)


@pytest.mark.parametrize("radius_m", [0.002, 0.05])
def test_samples_of_a_sphere_tell_pi_a_squared(radius_m):
    # At any size: 2 m away d / (d + a) is 0.22 dB for 50 mm.
    found = sphere(radius_m, 2.0).rcs_dbsm([0, 0, 2.0 - radius_m])
    wanted_db = 10 * np.log10(np.pi * radius_m**2) + 20 * np.log10((2 - radius_m) / 2)
    assert np.abs(found - wanted_db).max() < 0.02


def test_samples_without_a_scale_or_a_place():
    at_m = np.array([0.0, 0.0, 0.3])
    capture = point_target(PATTERNED, at_m, 1.0)
    with pytest.raises(ModelError, match="'absolute': True"):
        replace(capture, meta={}).rcs_dbsm(at_m)
    with pytest.raises(ModelError, match="away from antennas"):
        capture.rcs_dbsm(ARRAY.tx_m[0])
    assert np.isnan(capture.rcs_dbsm([0, 0, -0.3])).all()


def power_mean_db(level_db: np.ndarray) -> float:
    return float(10 * np.log10(np.mean(10 ** (level_db / 10))))


def test_a_sphere_has_pi_a_squared_and_its_image_reads_that(device):
    pattern, sweep = AntennaPattern(5.0, 1.0), Waveform.sfcw(72e9, 82e9, 8)
    q = clradar.arrays.qar50()
    array = replace(q.part(*2 * (slice(None, None, 6),)), tx_pattern=pattern, rx_pattern=pattern)
    radius_m, range_m = 0.01, 0.6
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius_m)
    scene = Scene.from_mesh(ball.apply_translation([0, 0, range_m]))
    capture = clradar.simulate(
        scene, array, sweep, estimator="physical", samples_per_mm2=4.0, device=device
    )
    wanted = 10 * np.log10(np.pi * radius_m**2)
    # The divergence d / (d + a) is 0.15 dB. The sum ends at the shadow, which adds 1 / (2 ka) of
    # the amplitude with a phase that turns by 240 degrees over the band: 0.27 dB at most (ka = 16).
    samples = capture.rcs_dbsm([0, 0, range_m - radius_m])
    assert power_mean_db(samples) == pytest.approx(wanted - 0.15, abs=0.27)
    grid = clradar.VoxelGrid.from_extent((0, 0), (0, 0), (0.58, 0.60), 1e-3)
    image = clradar.backproject(capture, grid, check_grid=False, device=device)
    assert image.rcs_dbsm().max() == pytest.approx(wanted - 0.15, abs=0.3)
