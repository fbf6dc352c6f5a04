"""Mean and standard deviation over seeds: against numpy, and against what theory says varies."""

import warnings
from typing import Any

import numpy as np
import pytest
from shapes import sphere

import clradar
from clradar.errors import ModelError

FULL = clradar.arrays.qar50()
ARRAY = clradar.AntennaArray(FULL.tx_m[::16], FULL.rx_m[::16])
WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 8)
GRID = clradar.VoxelGrid.from_extent((-0.02, 0.02), (-0.012, 0.012), (0.28, 0.31), 2e-3)
BALL = clradar.Scene(*sphere((0.0, 0.0, 0.3), 0.01, 3), 0.6)
FEW: dict[str, Any] = {
    "samples_per_mm2": 2, "rays_per_sample": 16, "estimator": "stochastic", "device": "pocl",
}  # fmt: skip

pytestmark = pytest.mark.filterwarnings(
    "ignore:.* pairs of antennas received no ray", "ignore:the grid reaches"
)


def test_moments_are_those_of_all_images_at_once():
    noise = {"snr_db": 10.0}
    found = clradar.spread(BALL, ARRAY, WAVEFORM, GRID, seeds=5, seed=7, impairments=noise, **FEW)
    volumes = []
    for i in range(5):
        capture = clradar.simulate(BALL, ARRAY, WAVEFORM, seed=7 + i, **FEW)
        noisy = clradar.impair(capture, seed=i, **noise)
        volumes.append(clradar.backproject(noisy, GRID, device="pocl"))
    data = np.array([v.data for v in volumes]).astype(complex)
    amplitude = np.array([v.max_projection() for v in volumes]).astype(float)
    depth = np.array([v.depth_map(15.0).depth_m for v in volumes])
    close = {"rtol": 1e-6, "atol": 1e-6 * amplitude.max()}  # the mean is rounded to complex64
    np.testing.assert_allclose(found.mean.data, data.mean(axis=0), **close)
    np.testing.assert_allclose(found.amplitude, amplitude.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.amplitude_sd, amplitude.std(axis=0, ddof=1), rtol=1e-9)
    count = np.isfinite(depth).sum(axis=0)
    np.testing.assert_array_equal(found.depth_count, count)
    assert count.min() < 2
    assert count.max() == 5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of pixels without a depth
        mean_m, sd_m = np.nanmean(depth, axis=0), np.nanstd(depth, axis=0, ddof=1)
    np.testing.assert_allclose(found.depth_m, mean_m, rtol=1e-12)
    np.testing.assert_allclose(found.depth_sd_m, np.where(count > 1, sd_m, np.nan), atol=1e-12)
    varying = (np.abs(data - data.mean(axis=0)) ** 2).sum() / 4
    assert found.varying_share == pytest.approx(varying / (np.abs(data) ** 2).sum() * 5, rel=1e-9)
    assert found.seeds == (7, 8, 9, 10, 11)
    assert found.varies == "shot noise of random rays and noise"
    assert list(found.mean.meta["spread"]["seeds"]) == [7, 8, 9, 10, 11]
    assert found.to_depth_map().amplitude.max() == np.float32(found.amplitude.max())


def test_shot_noise_of_captures_is_what_campbell_says():
    """At alpha = 1, one ray per sample: a pair with n paths of amplitude 1 has n of noise power.

    Stratified samples take a little of it away: positions on a face are not independent.
    """
    rays = {**FEW, "samples_per_mm2": 20, "rays_per_sample": 1}
    scene = BALL.with_alpha(1.0)
    captures = [clradar.simulate(scene, ARRAY, WAVEFORM, seed=seed, **rays) for seed in range(12)]
    data = np.array([c.data for c in captures]).astype(complex)
    varying = (np.abs(data - data.mean(axis=0)) ** 2).sum() / 11
    expected = np.mean([c.meta["rays"]["paths"] for c in captures]) * WAVEFORM.n_freq
    # 36 pairs of 12 seeds, whose frequencies are alike over the ball's 10 mm: 400 draws of an
    # exponential variable, three standard deviations.
    assert 0.8 * expected < varying < 1.15 * expected


def test_what_has_no_roughness_does_not_vary():
    physical = {"estimator": "physical", "samples_per_mm2": 1.5, "device": "pocl"}
    found = clradar.spread(BALL, ARRAY, WAVEFORM, GRID, seeds=2, **physical)
    assert (found.varying_share, found.varies) == (0.0, "nothing")
    assert not found.amplitude_sd.any()
    assert not found.depth_sd_m[found.depth_count > 0].any()
    assert np.isnan(found.depth_m[found.depth_count == 0]).all()
    rough = BALL.with_material("palm")
    found = clradar.spread(rough, ARRAY, WAVEFORM, GRID, seeds=2, **physical)
    assert found.varies == "roughness"
    assert 0 < found.varying_share < 0.9


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seeds": 1}, "spread: seeds: expected a whole number in"),
        ({"seeds": 2, "impairments": {"snr": 3}}, "spread: impairments: expected settings of"),
        ({"seed": 2**64 - 1, "seeds": 2}, "seed"),
    ],
)
def test_bad_arguments_are_one_error(given, message):
    with pytest.raises(ModelError, match=message):
        clradar.spread(BALL, ARRAY, WAVEFORM, GRID, **{**FEW, "samples_per_mm2": 0.5, **given})


def test_warnings_come_once():
    behind = clradar.Scene(*sphere((0.0, 0.0, -0.01), 0.02, 1), 1.0)
    with pytest.warns(clradar.ClradarWarning) as caught:
        clradar.spread(behind, ARRAY, WAVEFORM, GRID, seeds=3, **{**FEW, "samples_per_mm2": 0.1})
    texts = [str(one.message) for one in caught]
    assert len(texts) == len(set(texts))
