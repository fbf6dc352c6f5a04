"""The metrics, against closed forms and against formulas written out by hand."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clradar.compare import METRIC_TABLE, METRICS, compare
from clradar.compare.metrics import SSIM_SIGMA, SSIM_WINDOW
from clradar.errors import CompareError, ModelError
from clradar.model import DepthMap, Volume, VoxelGrid
from clradar.overlap import OVERLAP_BLUR_M, overlap

# Depths and coordinates are float64 sums and products of numbers below 1: a few units in the last
# place of 1, taken with a margin of about a hundred.
ROUNDING = 1e-13
# Amplitudes are float32, relative error 6e-8, which is 20 / ln(10) * 6e-8 = 5e-7 dB on a scale of
# 15 dB. Correlation and SSIM change by no more than a few times that share.
FLOAT32 = 1e-6

# The overlap's kernel is truncated twice, at exp(-16) = 1.1e-7 each.
OVERLAP_CUTS = 3e-7

MM = 1e-3
N_X, N_Y, N_Z = 40, 30, 21


def grid(z_first_mm: float = 290.0, x_first_mm: float = -20.0, n_x: int = N_X) -> VoxelGrid:
    """1 mm voxels; pixel [row, column] is at y = row - 15, x = x_first + column (mm)."""
    return VoxelGrid(
        np.array([x_first_mm, -15.0, z_first_mm]) * MM, np.full(3, MM), (n_x, N_Y, N_Z)
    )


def layer(amplitude: np.ndarray, z_index: int | np.ndarray = 10, **kwargs: Any) -> Volume:
    """A volume with `amplitude[y, x]` in the one layer `z_index` (one per pixel, or one for all).

    With nothing beside it along z, the parabola leaves each depth at its voxel's centre.
    """
    at = np.broadcast_to(z_index, amplitude.shape)
    data = np.where(np.arange(N_Z)[:, None, None] == at, amplitude, 0.0)
    return Volume(data.astype(np.complex64), grid(**kwargs))


def plate(rows: slice, columns: slice, level: float = 1.0) -> np.ndarray:
    amplitude = np.zeros((N_Y, N_X))
    amplitude[rows, columns] = level
    return amplitude


def texture(seed: int) -> np.ndarray:
    """Amplitudes spread over 30 dB, so that about half of them are clipped."""
    return 10.0 ** (np.random.default_rng(seed).uniform(-30.0, 0.0, (N_Y, N_X)) / 20.0)


def depth_map(
    amplitude: np.ndarray, depth_m: np.ndarray | float = 0.3, rng_db: float = 15.0
) -> DepthMap:
    n_y, n_x = amplitude.shape
    depth = np.broadcast_to(np.asarray(depth_m, dtype=float), amplitude.shape)
    return DepthMap(depth, amplitude, np.arange(n_x) * MM, np.arange(n_y) * MM, rng_db)


SPECKLE = pytest.mark.filterwarnings("ignore:compare. an overlap of:clradar.ClradarWarning")
"""Of textures of two seeds the overlap sees one full plate, the correlation no likeness."""

PLATE = plate(slice(5, 20), slice(10, 30))


@pytest.mark.parametrize("steps", [0, -7, 1])
def test_plane_shifted_in_depth(steps):
    metrics = compare(layer(PLATE), layer(PLATE, 10 + steps))
    shift_m = abs(steps) * MM
    assert (metrics.db_correlation, metrics.mask_iou) == (1.0, 1.0)
    assert metrics.ssim == pytest.approx(1.0, abs=ROUNDING)
    # A weight common to all pairs of points comes out of the sum: exp(-(shift / 2 blur)^2).
    expected = math.exp(-((shift_m / (2 * OVERLAP_BLUR_M)) ** 2))
    assert metrics.overlap == pytest.approx(expected, abs=OVERLAP_CUTS)
    assert metrics.depth_rmse_m == pytest.approx(shift_m, abs=ROUNDING)
    # Between parallel planes on the same pixels the nearest point is straight ahead.
    assert metrics.chamfer_simulated_to_measured_m == pytest.approx(shift_m, abs=ROUNDING)
    assert metrics.chamfer_measured_to_simulated_m == pytest.approx(shift_m, abs=ROUNDING)


def test_masks_that_share_a_part_and_none():
    # 20 x 10 and 20 x 10 pixels that share 20 x 4: 80 / (200 + 200 - 80).
    first, second, apart = (layer(plate(slice(0, 20), slice(at, at + 10))) for at in (0, 6, 15))
    assert compare(first, second).mask_iou == 80 / 320
    metrics = compare(first, apart)
    assert metrics.mask_iou == 0.0
    assert math.isnan(metrics.depth_rmse_m)
    # Columns 15 to 24 to the nearest measured column, 9: 6 to 15 mm, and the same backwards.
    assert metrics.chamfer_simulated_to_measured_m == pytest.approx(10.5 * MM, abs=ROUNDING)
    assert metrics.chamfer_measured_to_simulated_m == pytest.approx(10.5 * MM, abs=ROUNDING)
    record = json.loads(json.dumps(metrics.to_dict(), allow_nan=False))
    assert record["depth_rmse_m"] is None
    assert record["chamfer_simulated_to_measured_m"] == metrics.chamfer_simulated_to_measured_m


@pytest.mark.parametrize("blur_mm", [0.7, 5.0])
def test_overlap_against_all_pairs(blur_mm):
    """On uneven pixels, with depths between the voxels and pixels that have none."""
    rng = np.random.default_rng(6)
    x_m, y_m = (np.cumsum(rng.uniform(0.5, 1.5, n)) * MM for n in (N_X, N_Y))
    maps = []
    for seed in (50, 51):
        depth_m = np.where(
            rng.random((N_Y, N_X)) < 0.6, rng.uniform(0.29, 0.31, (N_Y, N_X)), np.nan
        )
        maps.append(DepthMap(depth_m, texture(seed), x_m, y_m, 30.0))
    points = [image.points_m() for image in maps]
    weights = [image.amplitude[image.mask].astype(np.float64) for image in maps]

    def product(i: int, j: int) -> float:
        distance = np.linalg.norm(points[i][:, None] - points[j][None], axis=2)
        return weights[i] @ np.exp(-((distance / (2e-3 * blur_mm)) ** 2)) @ weights[j]

    expected = product(0, 1) / math.sqrt(product(0, 0) * product(1, 1))
    assert 0.2 < expected < 0.99
    assert overlap(*maps, blur_mm * MM) == pytest.approx(expected, abs=OVERLAP_CUTS)
    assert overlap(*maps[::-1], blur_mm * MM) == pytest.approx(expected, abs=OVERLAP_CUTS)


@SPECKLE
def test_the_metrics_have_the_stated_sense():
    """Perfect agreement against a worse image: each metric changes in its stated direction."""
    base = layer(texture(60), np.random.default_rng(61).integers(0, N_Z, (N_Y, N_X)))
    other = layer(texture(62), np.random.default_rng(63).integers(0, N_Z, (N_Y, N_X)))
    perfect, worse = compare(base, base).to_dict(), compare(base, other).to_dict()
    names, higher = list(METRICS), {one.field for one in METRIC_TABLE if one.higher_is_better}
    assert {n for n in names if perfect[n] > worse[n]} == higher
    assert {n for n in names if perfect[n] < worse[n]} == set(names) - higher


@SPECKLE
def test_chamfer_against_all_pairs_and_correlation_against_numpy():
    """dB by hand: relative to each maximum, clipped, every pixel of the image."""
    rng, amplitudes = np.random.default_rng(5), (texture(7), texture(8) + 0.5 * texture(7))
    a, b = (layer(one, rng.integers(0, N_Z, (N_Y, N_X))) for one in amplitudes)
    points_a, points_b = a.depth_map().points_m(), b.depth_map().points_m()
    distance = np.linalg.norm(points_a[:, None] - points_b[None], axis=2)
    metrics = compare(a, b)
    expected = distance.min(axis=0).mean()
    assert metrics.chamfer_simulated_to_measured_m == pytest.approx(expected, abs=ROUNDING)
    expected = distance.min(axis=1).mean()
    assert metrics.chamfer_measured_to_simulated_m == pytest.approx(expected, abs=ROUNDING)
    clipped = [np.maximum(20 * np.log10(v / v.max()), -15.0).ravel() for v in amplitudes]
    expected = np.corrcoef(*clipped)[0, 1]
    assert metrics.db_correlation == pytest.approx(expected, abs=FLOAT32)


@SPECKLE
def test_ssim_by_hand():
    """Wang et al. 2004, written out for one image of exactly one window."""
    rng = np.random.default_rng(11)
    a, b = (10.0 ** (rng.uniform(-15.0, 0.0, (11, 11)) / 20.0) for _ in range(2))
    offset = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    line = np.exp(-0.5 * (offset / SSIM_SIGMA) ** 2)
    weight = np.outer(line, line) / np.outer(line, line).sum()
    x, y = (20 * np.log10(v / v.max()) / 15.0 + 1.0 for v in (a, b))
    mean_x, mean_y = (weight * x).sum(), (weight * y).sum()
    var_x, var_y = ((weight * v**2).sum() - (weight * v).sum() ** 2 for v in (x, y))
    cov = (weight * x * y).sum() - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    expected = ((2 * mean_x * mean_y + c1) * (2 * cov + c2)) / (
        (mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2)
    )
    # c2 = 9e-4 in the denominator magnifies the float32 error of the images.
    assert compare(depth_map(a), depth_map(b)).ssim == pytest.approx(expected, abs=10 * FLOAT32)


def test_depth_maps_and_volumes_agree():
    a, b = layer(texture(40), 3), layer(texture(41), 5)
    expected = compare(a, b)
    assert compare(a.depth_map(), b) == expected
    # A map that was cut further down is cut again, at the same pixels.
    assert compare(a.depth_map(30.0), b.depth_map(20.0)) == expected


def test_correlation_of_a_constant_image_is_nan():
    constant, other = layer(np.ones((N_Y, N_X))), layer(PLATE)
    for pair in ((constant, other), (other, constant), (constant, constant)):
        metrics = compare(*pair)
        assert math.isnan(metrics.db_correlation)
        assert math.isfinite(metrics.ssim)
        assert metrics.depth_rmse_m == 0.0


NOWHERE = replace(layer(PLATE).depth_map(), depth_m=np.full((N_Y, N_X), np.nan))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (layer(np.zeros((N_Y, N_X))), "0 everywhere"),
        (PLATE, "got ndarray"),
        (NOWHERE, "depth somewhere within 15 dB"),
        (layer(PLATE).depth_map(10.0), "15 dB.*cut at 10 dB"),
        (layer(PLATE, x_first_mm=-19.5), r"same pixels.*-20 to 19 mm|-19\.5 to 19\.5 mm.*in 40"),
        (layer(PLATE[:, :31], n_x=31), "x = -20 to 10 mm in 31"),
    ],
)
def test_images_that_cannot_be_compared(bad, message):
    for pair, which in (((bad, layer(PLATE)), "measured"), ((layer(PLATE), bad), "simulated")):
        with pytest.raises(CompareError, match=message) as caught:
            compare(*pair)
        assert which in str(caught.value)
    compare(layer(PLATE), layer(PLATE, x_first_mm=-20.0 + 5e-5))  # the same within 0.1 um


def test_the_dynamic_range_and_the_size_are_checked():
    with pytest.raises(ModelError, match="dynamic_range_db"):
        compare(layer(PLATE), layer(PLATE), dynamic_range_db=0.0)
    small = depth_map(texture(0)[:10, :12])
    with pytest.raises(CompareError, match=r"at least 11 x 11.*got 12 x 10"):
        compare(small, small)
