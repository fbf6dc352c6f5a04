"""Images on an absolute scale: what targets of known radar cross section read, in dBsm."""

from dataclasses import replace

import numpy as np
import pytest

import clradar
from clradar import AntennaArray, AntennaPattern, Capture, VoxelGrid, Waveform
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import ModelError
from clradar.model import ImageScale

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
