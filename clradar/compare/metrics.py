"""Comparison of a simulated with a measured image (``docs/metrics.md``): one table of metrics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from clradar.compare.images import UnmatchedObject, clipped_db, cut_pair, disagreement
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError, warn
from clradar.model import DepthMap, Volume
from clradar.model.record import Record, plain

SSIM_WINDOW, SSIM_SIGMA = 11, 1.5  # pixels (Wang et al. 2004): skimage truncates at 3.5 sigma

OVERLAP_BLUR_M = 2e-3
"""Standard deviation of the Gaussian that every depth point is blurred with, metres.

The image of a point 0.3 m away falls to -3 dB at 1.9 mm from its centre, as a Gaussian of 2.3 mm
does: a blur much below that compares speckle, one much above it has less resolution than the radar.
"""

MAX_SPAN_M = 20.0  # of all depths: the number of cosines grows with their span, to 6400 here
REACH = 8.0  # distance in blurs at which the kernel is truncated: exp(-(8 / 2)^2) = 1e-7

GOOD_OVERLAP, POOR_CORRELATION = 0.8, 0.6
"""Beyond both of these the overlap and the dB correlation contradict each other.

Of one hand, simulated with another seed, alpha or shift, an overlap above the first comes with a
correlation above 0.65, however narrow the frame around the hand.
"""

POOR_OVERLAP, GOOD_CORRELATION = 0.6, 0.9  # the other way round: correlation does not see depth

NAMED_OBJECTS = 3  # objects that a remark describes; it counts the rest


def overlap(first: DepthMap, second: DepthMap, blur_m: float = OVERLAP_BLUR_M) -> float:
    """Return the cosine between two depth maps on the same pixels as densities in space, 0 to 1.

    It is the kernel correlation of Tsin and Kanade (ECCV 2004), normalised.
    Every pixel that has a depth is a point p with its linear amplitude a as weight. Blurred with
    normal densities of standard deviation s, two clouds have the inner product::

        <A, B> = sum over p in A, q in B of  a_p b_q exp(-|p - q|^2 / (2 s)^2)

    but for a factor that cancels, and the overlap is <A, B> / sqrt(<A, A> <B, B>). The exponential
    splits into factors for x, y and z. Those for x and y are matrices between pixel columns and
    between pixel rows. That for z becomes a Fourier series over a period that is 8 s longer than
    the range of the depths, ended where exp(-(k s)^2) = 1e-7, so that the cost grows with pixels
    and depths and not with pairs of points. Both cuts leave an error of about 1e-7.
    """
    shown = first.mask | second.mask
    rows, columns = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    used = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    clouds = [_cloud(image, used) for image in (first, second)]
    depths_m = np.concatenate([z_m[weight > 0] for weight, z_m in clouds])
    nearest_m = depths_m.min()
    span_m = depths_m.max() - nearest_m
    if span_m > MAX_SPAN_M:
        raise CompareError(
            f"overlap: expected depths within {MAX_SPAN_M:g} m of each other, got them over "
            f"{span_m:g} m; form both images around the object"
        )
    along_x, along_y = (
        np.exp(-(((axis_m[:, None] - axis_m) / (2.0 * blur_m)) ** 2))
        for axis_m in (first.x_m[used[1]], first.y_m[used[0]])
    )
    products = np.zeros(3)
    step = 2.0 * np.pi / (span_m + REACH * blur_m)  # of the wavenumber of the cosines
    for i in range(math.ceil(0.5 * REACH / (blur_m * step)) + 1):
        share = (2.0 if i else 1.0) * math.exp(-((i * step * blur_m) ** 2))
        wave = np.stack(
            [
                weight * part(i * step * (z_m - nearest_m))
                for weight, z_m in clouds
                for part in (np.cos, np.sin)
            ],
            axis=1,
        )
        # Along y, then along x: two large products instead of eight small ones.
        blurred = along_y @ wave.reshape(len(wave), -1)
        blurred = (blurred.reshape(-1, len(along_x)) @ along_x).reshape(wave.shape)
        a, b = slice(0, 2), slice(2, 4)
        for which, (one, other) in enumerate(((a, a), (b, b), (a, b))):
            products[which] += share * np.sum(wave[:, one] * blurred[:, other])
    with_itself = math.sqrt(products[0] * products[1])
    return min(1.0, max(0.0, float(products[2]) / with_itself))


def _cloud(image: DepthMap, used: tuple[slice, slice]) -> tuple[np.ndarray, np.ndarray]:
    """Return weight and depth in metres of the pixels, both 0 where there is no depth."""
    mask = image.mask[used]
    amplitude = np.where(mask, image.amplitude[used], 0.0).astype(np.float64)
    return amplitude / amplitude.max(), np.where(mask, image.depth_m[used], 0.0)


def _correlation(first: DepthMap, second: DepthMap) -> float:
    """Return the Pearson correlation, NaN where an image is constant."""
    a, b = clipped_db(first), clipped_db(second)
    if np.ptp(a) == 0 or np.ptp(b) == 0:  # whose variance can round to above 0
        return math.nan
    a, b = a - a.mean(), b - b.mean()
    # One square root of the product: identical images then give exactly 1.
    ratio = float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))
    return min(1.0, max(-1.0, ratio))


def check_size(image: DepthMap) -> None:
    """Raise `CompareError` unless an image has as many pixels as the metrics need."""
    n_y, n_x = image.amplitude.shape
    if min(n_x, n_y) < SSIM_WINDOW:
        raise CompareError(
            f"compare: expected images of at least {SSIM_WINDOW} x {SSIM_WINDOW} pixels, the "
            f"window of the SSIM, got {n_x} x {n_y} (x, y)"
        )


def _ssim(first: DepthMap, second: DepthMap) -> float:
    check_size(first)
    from skimage.metrics import structural_similarity

    scaled = (clipped_db(image) / image.dynamic_range_db + 1.0 for image in (first, second))
    similarity = structural_similarity(
        *scaled, data_range=1.0, gaussian_weights=True, sigma=SSIM_SIGMA,
        use_sample_covariance=False,
    )  # fmt: skip
    return float(similarity)


def _mask_iou(first: DepthMap, second: DepthMap) -> float:
    a, b = first.mask, second.mask
    return float(np.count_nonzero(a & b) / np.count_nonzero(a | b))


def _depth_rmse_m(first: DepthMap, second: DepthMap) -> float:
    common = first.mask & second.mask
    if not common.any():
        return math.nan
    return float(np.sqrt(np.mean((first.depth_m - second.depth_m)[common] ** 2)))


def _mean_nearest_m(of: DepthMap, to: DepthMap) -> float:
    """Return the mean distance from the depth points of one image to the nearest of the other."""
    from scipy.spatial import cKDTree

    distance_m, _ = cKDTree(to.points_m()).query(of.points_m())
    return float(distance_m.mean())


class Metric(NamedTuple):
    """A field of `Metrics`: value, name with the unit, factor to that unit, and decimals."""

    field: str
    value: Callable[[DepthMap, DepthMap], float]
    name: str
    scale: float = 1.0
    digits: int = 3
    higher_is_better: bool = True
    undefined: str = ""  # what NaN means, where it can be

    def text(self, metrics: Metrics) -> str:
        """The value in the unit of the name."""
        value = self.scale * getattr(metrics, self.field)
        return "n/a" if math.isnan(value) else f"{value:.{self.digits}f}"


METRIC_TABLE = (
    Metric("overlap", overlap, "overlap"),
    Metric(
        "db_correlation", _correlation, "dB correlation",
        undefined="one of the two dB images is constant, so it has no variance",
    ),
    Metric("ssim", _ssim, "SSIM"),
    Metric("mask_iou", _mask_iou, "mask IoU"),
    Metric(
        "depth_rmse_m", _depth_rmse_m, "depth RMSE (mm)", 1e3, 2, False,
        "the two masks have no pixel in common",
    ),
    Metric(
        "chamfer_simulated_to_measured_m", lambda measured, s: _mean_nearest_m(s, measured),
        "Chamfer sim. to meas. (mm)", 1e3, 2, False,
    ),
    Metric(
        "chamfer_measured_to_simulated_m", _mean_nearest_m,
        "Chamfer meas. to sim. (mm)", 1e3, 2, False,
    ),
)  # fmt: skip
"""The metrics wherever they are shown. The first is for ranking by a single number; reasons in
`docs/metrics.md`."""

METRICS = tuple(one.field for one in METRIC_TABLE)


@dataclass(frozen=True, slots=True)
class Metrics(Record):
    """Agreement between a measured and a simulated image, by the formulas of docs/metrics.md.

    Attributes
    ----------
    overlap : float
        Cosine between the depth maps as blurred points in space, 0 to 1, the best.
    db_correlation : float
        Pearson correlation of the clipped dB images. NaN where one of them is constant.
    ssim : float
        Mean structural similarity of the clipped dB images.
    mask_iou : float
        Pixels in both masks over pixels in either.
    depth_rmse_m : float
        RMS difference of depth over the pixels in both masks. NaN where there is none.
    chamfer_simulated_to_measured_m, chamfer_measured_to_simulated_m : float
        Mean distance from each depth point of the one to the nearest of the other.
    dynamic_range_db : float
        Level below each image's maximum at which it was clipped and its mask cut.
    missing, surplus : tuple of UnmatchedObject
        Bright objects that the simulation lacks, or has beyond the measurement, the largest share
        of the energy first.
    """

    overlap: float
    db_correlation: float
    ssim: float
    mask_iou: float
    depth_rmse_m: float
    chamfer_simulated_to_measured_m: float
    chamfer_measured_to_simulated_m: float
    dynamic_range_db: float = DYNAMIC_RANGE_DB
    missing: tuple[UnmatchedObject, ...] = ()
    surplus: tuple[UnmatchedObject, ...] = ()

    @property
    def misleading(self) -> bool:
        """Whether the overlap is good although another metric or an object says otherwise."""
        return self.overlap >= GOOD_OVERLAP and bool(self.remarks)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Objects of one image alone, and contradictions, in words."""
        unmatched = {"missing from the simulation": self.missing}
        unmatched["in the simulation alone"] = self.surplus
        remarks = [f"{where}: {_listed(found)}" for where, found in unmatched.items() if found]
        pair = f"overlap {self.overlap:.2f}, but dB correlation {self.db_correlation:.2f}"
        if self.overlap >= GOOD_OVERLAP and self.db_correlation < POOR_CORRELATION:
            remarks.append(f"the metrics disagree: {pair} and mask IoU {self.mask_iou:.2f}")
        elif self.overlap < POOR_OVERLAP and self.db_correlation > GOOD_CORRELATION:
            remarks.append(
                f"the metrics disagree: {pair}, which does not see depth; the depth RMSE is "
                f"{1e3 * self.depth_rmse_m:.1f} mm"
            )
        return tuple(remarks)

    def to_dict(self) -> dict[str, Any]:
        """Return fields and remarks in types of strict JSON: None replaces NaN."""
        return {**plain(self), "remarks": list(self.remarks)}


def _listed(objects: tuple[UnmatchedObject, ...]) -> str:
    more = len(objects) - NAMED_OBJECTS
    return "; ".join([*map(str, objects[:NAMED_OBJECTS]), *[f"and {more} more"] * (more > 0)])


def compare(
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Metrics:
    """Compare a simulated image with a measured one on the same pixels.

    What values mean: docs/metrics.md. It warns of a good overlap that other metrics contradict.

    Parameters
    ----------
    measured, simulated : Volume or DepthMap
        With the same pixel centres along x and y, at least 11 x 11; z axes may differ.
    dynamic_range_db : float
        Each image is clipped, and its mask cut, this far below its own maximum.

    Examples
    --------
    Two equal spots, 2 mm apart in depth.

    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> near, far = (clradar.DepthMap(0 * spot + z_m, spot, x_m, x_m) for z_m in (0.300, 0.302))
    >>> print(f"{clradar.compare(near, far).overlap:.3f}")
    0.779
    """
    metrics = metrics_of(measured, simulated, dynamic_range_db)
    if metrics.misleading:
        warn(
            f"compare: an overlap of {metrics.overlap:.2f} is misleading here: "
            f"{'; '.join(metrics.remarks)}; look at both images, and correct the scene of the "
            "simulation"
        )
    return metrics


def metrics_of(
    measured: Volume | DepthMap, simulated: Volume | DepthMap, dynamic_range_db: float
) -> Metrics:
    """Return what `compare` returns, without its warning: of simulations that are to differ."""
    first, second = cut_pair("compare", measured, simulated, dynamic_range_db)
    values: dict[str, Any] = {one.field: one.value(first, second) for one in METRIC_TABLE}
    found = disagreement(first, second)
    values |= {"missing": found.missing, "surplus": found.surplus}
    return Metrics(**values, dynamic_range_db=first.dynamic_range_db)
