"""Gains and boresights of single antennas in captures, images, figures and files."""

from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from shapes import sphere

import clradar
from clradar.arrays.point_spread import response
from clradar.phasors import kirchhoff_sum
from clradar.simulation import simulate_alphas
from measurement_io import open_capture, save_capture

RNG = np.random.Generator(np.random.Philox(3))
TX_M, RX_M = (RNG.uniform(-0.05, 0.05, (n, 3)) * [1, 1, 0] for n in (5, 9))
TX_GAIN, RX_GAIN = (RNG.normal(size=(n, 2)) @ [1, 1j] for n in (5, 9))
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 8)
PLAIN = clradar.AntennaArray(TX_M, RX_M)
UNEVEN = clradar.AntennaArray(TX_M, RX_M, tx_gain=TX_GAIN, rx_gain=RX_GAIN)
TIMES = (TX_GAIN[:, None] * RX_GAIN)[:, :, None].astype(np.complex64)
BALL = clradar.Scene(*sphere((0.0, 0.0, 0.3), 0.02, 3), 0.5)


@pytest.mark.parametrize(
    "settings",
    [{"estimator": "expected"}, {"estimator": "physical", "samples_per_mm2": 4}],
)
def test_gains_multiply_the_samples(settings):
    scene = BALL.with_material("metal") if settings["estimator"] == "physical" else BALL
    plain, uneven = (
        clradar.simulate(scene, array, WAVEFORM, **settings).data for array in (PLAIN, UNEVEN)
    )
    assert np.abs(plain).max() > 0
    np.testing.assert_array_equal(uneven, plain * TIMES)


def test_gains_are_taken_out_of_samples_unless_one_is_zero():
    data = RNG.normal(size=(5, 9, 8)).astype(np.complex64)
    found = clradar.Capture(data * TIMES, UNEVEN, WAVEFORM).without_gains()
    np.testing.assert_allclose(found.data, data, atol=1e-6)
    assert not found.array.has_gains
    dead = clradar.AntennaArray(TX_M, RX_M, rx_gain=[1.0] * 8 + [0.0])
    with pytest.raises(
        clradar.errors.ModelError, match=r"rx_gain: expected no gain of 0.* index 8"
    ):
        clradar.Capture(data, dead, WAVEFORM).without_gains()


def test_gains_in_every_other_way_to_a_capture():
    fields: dict[str, Any] = {"samples_per_mm2": 5, "rays_per_sample": 2}
    want = clradar.simulate(BALL, UNEVEN, WAVEFORM, estimator="stochastic", **fields).data
    paths = clradar.trace(BALL, UNEVEN, **fields)
    np.testing.assert_array_equal(clradar.synthesize(paths, UNEVEN, WAVEFORM).data, want)
    ((alone,),) = simulate_alphas(BALL, UNEVEN, WAVEFORM, [0.5], **fields)
    np.testing.assert_array_equal(alone.data, want)
    grid = clradar.VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.27, 0.33), 2e-3)
    with clradar.FrameImager(UNEVEN, WAVEFORM, grid) as imager:
        clradar.simulate_image(BALL, imager, estimator="stochastic", **fields)
        capture = clradar.Capture(want, UNEVEN, WAVEFORM)
        image = clradar.backproject(capture, grid, check_grid=False)
        np.testing.assert_array_equal(imager.volume().data, image.data)


def test_a_taper_lowers_side_lobes_of_the_response():
    """Cosine weights on a uniform line: the array factor is known, sum of w exp(j k x sin)."""
    x_m = np.linspace(-0.03, 0.03, 31)
    taper = np.cos(np.pi * x_m / 0.064)
    line = np.stack([x_m, 0 * x_m, 0 * x_m], axis=1)
    array = clradar.AntennaArray([[0, 0, 0]], line, rx_gain=taper)
    k = 2 * np.pi * 77e9 / clradar.constants.SPEED_OF_LIGHT_M_PER_S
    sines = np.linspace(-0.5, 0.5, 101)
    at_m = 1e3 * np.stack([sines, 0 * sines, np.sqrt(1 - sines**2)], axis=1)
    got = response(array, np.array([77e9]), np.array([0, 0, 1e3]), at_m)
    want = np.abs(np.exp(1j * k * np.outer(sines, x_m)) @ taper) / taper.sum()
    # The distance at which the far field holds: (D/2)^2 k / 2R = 7e-4 rad of phase left.
    np.testing.assert_allclose(got, want, atol=1e-3)


@pytest.mark.parametrize("skeletons", [False, True])
def test_a_tilted_antenna_has_the_gain_of_its_angle(skeletons, monkeypatch):
    """cos^3 about each antenna's own axis, for a plate of 4 mm 1 m away: the ratio to isotropic
    antennas is the product of both fields at the plate, which spans 0.3 degrees."""
    if skeletons:
        monkeypatch.setattr(kirchhoff_sum, "FEW_POINTS", 0)
    turns = Rotation.from_rotvec(RNG.uniform(-0.5, 0.5, (14, 3))).as_matrix()[:, :, 2]
    pattern = clradar.AntennaPattern(gain_dbi=3.0, exponent=3.0)
    tilted = clradar.AntennaArray(
        TX_M, RX_M, "tilted", pattern, pattern,
        tx_boresight=turns[:5], rx_boresight=2 * turns[5:],
    )  # fmt: skip
    plate = trimesh.creation.box((4e-3, 4e-3, 1e-4)).apply_translation([0.1, -0.05, 1.0])
    scene = clradar.Scene.from_mesh(plate).with_material("metal")
    plain, got = (
        clradar.simulate(scene, a, WAVEFORM, estimator="physical", samples_per_mm2=20).data
        for a in (PLAIN, tilted)
    )
    fields = []
    for at_m, axes in ((TX_M, turns[:5]), (RX_M, turns[5:])):
        towards = [0.1, -0.05, 1.0] - at_m
        cosine = (towards * axes).sum(axis=1) / np.linalg.norm(towards, axis=1)
        fields.append(10 ** (3 / 20) * cosine**3)
    want = np.multiply.outer(*fields)[:, :, None]
    np.testing.assert_allclose(got / plain, np.broadcast_to(want, got.shape), rtol=0.01)


def test_files_keep_them(tmp_path):
    pattern = clradar.AntennaPattern(exponent=1.0)
    array = clradar.AntennaArray(
        TX_M, RX_M, "lab", pattern, None, TX_GAIN, None, np.tile([0.6, 0, 0.8], (5, 1))
    )
    data = np.ones((5, 9, 8), np.complex64)
    save_capture(tmp_path / "capture.h5", clradar.Capture(data, array, WAVEFORM))
    read = open_capture(tmp_path / "capture.h5").array
    np.testing.assert_array_equal(read.tx_gain, TX_GAIN)
    np.testing.assert_array_equal(read.tx_boresight, array.tx_boresight)
    assert read.rx_gain is None
    assert read.rx_boresight is None
