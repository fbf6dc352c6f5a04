"""Comparison of a simulated with a measured image (``docs/metrics.md``)."""

from __future__ import annotations

from clradar.compare.images import check_same_pixels, depth_map_of
from clradar.compare.metrics import Metrics
from clradar.compare.similarity import METRICS, VALUES
from clradar.compare.unmatched import disagreement_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import warn
from clradar.model import DepthMap, Volume, checks


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

    Warns
    -----
    ClradarWarning
        The overlap is 0.8 or more and misleading: the dB correlation is below 0.6, or one image has
        a bright object that the other lacks (`Metrics.remarks`).

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
    first, second, dynamic_range_db = _prepared(measured, simulated, dynamic_range_db)
    values = {name: value_of(first, second) for name, value_of in VALUES.items()}
    found = disagreement_of(first, second)
    return Metrics(
        **values,
        dynamic_range_db=dynamic_range_db,
        missing=found.missing,
        surplus=found.surplus,
    )


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
    checks.one_of("compare_by: metric", metric, METRICS)
    first, second, _ = _prepared(measured, simulated, dynamic_range_db)
    return VALUES[metric](first, second)


def _prepared(
    measured: Volume | DepthMap, simulated: Volume | DepthMap, dynamic_range_db: float
) -> tuple[DepthMap, DepthMap, float]:
    dynamic_range_db = checks.dynamic_range("compare: dynamic_range_db", dynamic_range_db)
    first = depth_map_of(measured, dynamic_range_db, "measured image")
    second = depth_map_of(simulated, dynamic_range_db, "simulated image")
    check_same_pixels(first, second)
    return first, second, dynamic_range_db
