"""The value of each metric of two depth maps on the same pixels (``docs/metrics.md``)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from clradar.compare.images import clipped_db
from clradar.errors import CompareError
from clradar.model import DepthMap
from clradar.overlap import overlap

SSIM_WINDOW = 11
"""Side of the SSIM window in pixels: skimage truncates its Gaussian at 3.5 standard deviations."""

SSIM_SIGMA = 1.5
"""Standard deviation of the SSIM window in pixels, as in Wang et al. 2004."""


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return the Pearson correlation, NaN where `a` or `b` is constant.

    The test is on the values, because the variance of a constant image can round to above 0.
    """
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return math.nan
    a = a - a.mean()
    b = b - b.mean()
    # One square root of the product: identical images then give exactly 1.
    ratio = float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))
    return min(1.0, max(-1.0, ratio))


def _ssim(a: np.ndarray, b: np.ndarray) -> float:
    if min(a.shape) < SSIM_WINDOW:
        n_y, n_x = a.shape
        raise CompareError(
            f"compare: expected images of at least {SSIM_WINDOW} x {SSIM_WINDOW} pixels, the "
            f"window of the SSIM, got {n_x} x {n_y} (x, y)"
        )
    from skimage.metrics import structural_similarity

    value = structural_similarity(
        a,
        b,
        data_range=1.0,
        gaussian_weights=True,
        sigma=SSIM_SIGMA,
        use_sample_covariance=False,
    )
    return float(value)


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.count_nonzero(a & b) / np.count_nonzero(a | b))


def _depth_rmse(a_m: np.ndarray, b_m: np.ndarray) -> float:
    difference_m = a_m - b_m
    common = ~np.isnan(difference_m)
    if not common.any():
        return math.nan
    return float(np.sqrt(np.mean(difference_m[common] ** 2)))


def _mean_nearest_m(from_m: np.ndarray, to_m: np.ndarray) -> float:
    """Return the mean over `from_m` of the distance to the nearest point of `to_m`, metres."""
    from scipy.spatial import cKDTree

    distance_m, _ = cKDTree(to_m).query(from_m)
    return float(distance_m.mean())


def _scaled(image: DepthMap) -> np.ndarray:
    """Return the clipped dB image in [0, 1]."""
    return clipped_db(image) / image.dynamic_range_db + 1.0


VALUES: dict[str, Callable[[DepthMap, DepthMap], float]] = {
    "overlap": overlap,
    "db_correlation": lambda a, b: _correlation(clipped_db(a), clipped_db(b)),
    "ssim": lambda a, b: _ssim(_scaled(a), _scaled(b)),
    "mask_iou": lambda a, b: _iou(a.mask, b.mask),
    "depth_rmse_m": lambda a, b: _depth_rmse(a.depth_m, b.depth_m),
    "chamfer_simulated_to_measured_m": lambda a, b: _mean_nearest_m(b.points_m(), a.points_m()),
    "chamfer_measured_to_simulated_m": lambda a, b: _mean_nearest_m(a.points_m(), b.points_m()),
}
"""Each metric of a measured and a simulated depth map of the same dynamic range."""

METRICS = tuple(VALUES)
"""The names of the metrics, in the order of the fields of `Metrics`."""
