"""Image similarity: the metrics of a simulated against a measured image (``docs/metrics.md``)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.overlap import overlap

SSIM_WINDOW = 11
"""Side of the SSIM window in pixels: skimage truncates its Gaussian at 3.5 standard deviations."""

SSIM_SIGMA = 1.5
"""Standard deviation of the SSIM window in pixels, as in Wang et al. 2004."""

SAME_PIXEL_TOLERANCE_M = 1e-7
"""Pixel centres closer than this are the same, as in `VoxelGrid.same_voxels`."""

HEADLINE_METRIC = "overlap"
"""The field of `Metrics` for ranking by a single number; reasons in `docs/metrics.md`."""

HIGHER_IS_BETTER = frozenset({"overlap", "db_correlation", "ssim", "mask_iou"})
"""The metrics whose best value is the largest; for the rest it is the smallest."""

UNDEFINED = {
    "db_correlation": "one of the two dB images is constant, so it has no variance",
    "depth_rmse_m": "the two masks have no pixel in common",
}
"""The metrics that can be NaN, and what NaN means there."""


@dataclass(frozen=True, slots=True)
class Metrics:
    """Agreement between a measured and a simulated image.

    `docs/metrics.md` has the formulas and the pixels that each metric uses.

    Attributes
    ----------
    overlap : float
        Cosine between the two depth maps as blurred points in space, in [0, 1]; 1 is best.
    db_correlation : float
        Pearson correlation of the clipped dB images, in [-1, 1]; 1 is best. NaN where one of them
        is constant.
    ssim : float
        Mean structural similarity of the clipped dB images scaled to [0, 1]; at most 1, the best.
    mask_iou : float
        Pixels in both masks over pixels in either, in [0, 1]; 1 is best.
    depth_rmse_m : float, metres
        Root mean square difference of depth over the pixels in both masks; 0 is best. NaN where
        the masks have no pixel in common.
    chamfer_simulated_to_measured_m : float, metres
        Mean distance from each simulated depth point to the nearest measured one; 0 is best.
    chamfer_measured_to_simulated_m : float, metres
        Mean distance from each measured depth point to the nearest simulated one; 0 is best.
    dynamic_range_db : float, decibel
        Level below each image's own maximum at which it was clipped and its mask cut.

    Examples
    --------
    NaN, here of two masks without a common pixel, becomes None for JSON.

    >>> import clradar
    >>> metrics = clradar.Metrics(0.0, 0.1, 0.2, 0.0, float("nan"), 0.012, 0.009)
    >>> record = metrics.to_dict()
    >>> record["mask_iou"], record["depth_rmse_m"]
    (0.0, None)
    """

    overlap: float
    db_correlation: float
    ssim: float
    mask_iou: float
    depth_rmse_m: float
    chamfer_simulated_to_measured_m: float
    chamfer_measured_to_simulated_m: float
    dynamic_range_db: float = DYNAMIC_RANGE_DB

    def to_dict(self) -> dict[str, float | None]:
        """Return the fields in order, in types of strict JSON: None replaces NaN."""
        values = {f.name: float(getattr(self, f.name)) for f in fields(self)}
        return {name: None if math.isnan(value) else value for name, value in values.items()}


def compare(
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Metrics:
    """Compare a simulated image with a measured one on the same pixels.

    Parameters
    ----------
    measured, simulated : Volume or DepthMap
        Both with the same pixel centres along x and y. Their z axes may differ: only the maximum
        projection and the depth map of a volume are used.
    dynamic_range_db : float, decibel
        Each image is clipped, and its mask cut, this far below its own maximum.

    Returns
    -------
    Metrics

    Raises
    ------
    CompareError
        One of them is not an image, is zero everywhere, has no depth anywhere, or is a depth map
        that was cut at a smaller dynamic range; the pixels differ; or the images are smaller than
        the SSIM window, 11 x 11 pixels.
    ModelError
        `dynamic_range_db` is not a positive number.

    Notes
    -----
    The overall level of an image has no influence: each is normalised to its own maximum.

    Examples
    --------
    Two equal spots, 2 mm apart in depth; the overlap of equal planes is exp(-(d / 4 mm)^2).

    >>> import numpy as np
    >>> import clradar
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> near, far = (clradar.DepthMap(0 * spot + z_m, spot, x_m, x_m) for z_m in (0.300, 0.302))
    >>> metrics = clradar.compare(near, far)
    >>> print(f"{metrics.overlap:.3f} {metrics.ssim:.3f} {1e3 * metrics.depth_rmse_m:.1f} mm")
    0.779 1.000 2.0 mm
    """
    first, second, dynamic_range_db = _prepared(measured, simulated, dynamic_range_db)
    values = {name: value_of(first, second) for name, value_of in _VALUES.items()}
    return Metrics(**values, dynamic_range_db=dynamic_range_db)


def compare_by(
    metric: str,
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> float:
    """Return one field of what `compare` returns, without computing the rest.

    Parameters
    ----------
    metric : str
        A field of `Metrics` other than `dynamic_range_db`.
    measured, simulated, dynamic_range_db
        As in `compare`, with its errors.
    """
    checks.one_of("compare_by: metric", metric, tuple(_VALUES))
    first, second, _ = _prepared(measured, simulated, dynamic_range_db)
    return _VALUES[metric](first, second)


def _prepared(
    measured: Volume | DepthMap, simulated: Volume | DepthMap, dynamic_range_db: float
) -> tuple[DepthMap, DepthMap, float]:
    dynamic_range_db = checks.positive("compare: dynamic_range_db", dynamic_range_db)
    first = depth_map_of(measured, dynamic_range_db, "measured image")
    second = depth_map_of(simulated, dynamic_range_db, "simulated image")
    _check_same_pixels(first, second)
    return first, second, dynamic_range_db


def depth_map_of(image: Volume | DepthMap, dynamic_range_db: float, label: str) -> DepthMap:
    """Return the depth map of an image, cut at `dynamic_range_db`.

    Parameters
    ----------
    image : Volume or DepthMap
        A depth map that was cut at a larger dynamic range is cut again.
    dynamic_range_db : float, decibel
    label : str
        Name of the image in errors.

    Raises
    ------
    CompareError
        Not an image, zero everywhere, without any depth, or a depth map that was cut at a smaller
        dynamic range.
    """
    if isinstance(image, Volume):
        image = image.depth_map(dynamic_range_db)
    elif not isinstance(image, DepthMap):
        raise CompareError(f"{label}: expected a Volume or a DepthMap, got {type(image).__name__}")
    peak = image.amplitude.max()
    if peak <= 0:
        raise CompareError(f"{label}: expected an amplitude above 0 somewhere, got 0 everywhere")
    if image.dynamic_range_db < dynamic_range_db:
        raise CompareError(
            f"{label}: expected depths down to {dynamic_range_db:g} dB below the maximum, got a "
            f"depth map that was cut at {image.dynamic_range_db:g} dB"
        )
    # The same expression as in Volume.depth_map, so that both cuts agree to the pixel.
    threshold = peak * 10.0 ** (-dynamic_range_db / 20.0)
    kept = image.mask & (image.amplitude >= threshold) & (image.amplitude > 0)
    if not kept.any():
        raise CompareError(
            f"{label}: expected a depth somewhere within {dynamic_range_db:g} dB of the maximum, "
            "got none"
        )
    depth_m = np.where(kept, image.depth_m, np.nan)
    return DepthMap(depth_m, image.amplitude, image.x_m, image.y_m, dynamic_range_db)


def clipped_db(image: DepthMap) -> np.ndarray:
    """Return the amplitude in decibel relative to its maximum, clipped at the dynamic range.

    Parameters
    ----------
    image : DepthMap
        With an amplitude above 0 somewhere.

    Returns
    -------
    ndarray, shape (n_y, n_x), float64, decibel
        In [-dynamic_range_db, 0]; an amplitude of 0 gives the lower end.
    """
    amplitude = image.amplitude.astype(np.float64)
    floor = 10.0 ** (-image.dynamic_range_db / 20.0)
    # Clipped before the logarithm, which has no value at 0, and after it, because of its rounding.
    level_db = 20.0 * np.log10(np.maximum(amplitude / amplitude.max(), floor))
    return np.clip(level_db, -image.dynamic_range_db, 0.0)


def _check_same_pixels(measured: DepthMap, simulated: DepthMap) -> None:
    pairs = ((measured.x_m, simulated.x_m), (measured.y_m, simulated.y_m))
    if all(len(a) == len(b) and np.abs(a - b).max() <= SAME_PIXEL_TOLERANCE_M for a, b in pairs):
        return
    raise CompareError(
        f"compare: expected both images on the same pixels along x and y, got "
        f"{_pixels_text(measured)} measured and {_pixels_text(simulated)} simulated; form both "
        "on one grid"
    )


def _pixels_text(image: DepthMap) -> str:
    def axis_text(name: str, axis_m: np.ndarray) -> str:
        # Nine digits show any difference beyond the tolerance.
        ends = f"{1e3 * axis_m[0]:.9g} to {1e3 * axis_m[-1]:.9g} mm"
        return f"{name} = {ends} in {len(axis_m)}"

    return f"({axis_text('x', image.x_m)}, {axis_text('y', image.y_m)})"


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


_VALUES: dict[str, Callable[[DepthMap, DepthMap], float]] = {
    "overlap": overlap,
    "db_correlation": lambda a, b: _correlation(clipped_db(a), clipped_db(b)),
    "ssim": lambda a, b: _ssim(_scaled(a), _scaled(b)),
    "mask_iou": lambda a, b: _iou(a.mask, b.mask),
    "depth_rmse_m": lambda a, b: _depth_rmse(a.depth_m, b.depth_m),
    "chamfer_simulated_to_measured_m": lambda a, b: _mean_nearest_m(b.points_m(), a.points_m()),
    "chamfer_measured_to_simulated_m": lambda a, b: _mean_nearest_m(a.points_m(), b.points_m()),
}
"""Each metric of a measured and a simulated depth map of the same dynamic range."""

METRICS = tuple(_VALUES)
"""The names of the metrics, in the order of the fields of `Metrics`."""


def _scaled(image: DepthMap) -> np.ndarray:
    """Return the clipped dB image in [0, 1]."""
    return clipped_db(image) / image.dynamic_range_db + 1.0
