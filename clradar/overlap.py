"""Kernel correlation of two depth maps (Tsin, Kanade, ECCV 2004), normalised to a cosine."""

from __future__ import annotations

import math

import numpy as np

from clradar.errors import CompareError
from clradar.model import DepthMap

OVERLAP_BLUR_M = 2e-3
"""Standard deviation of the Gaussian that every depth point is blurred with, metres.

The image of a point 0.3 m away falls to -3 dB at 1.9 mm from its centre, as a Gaussian of 2.3 mm
does: a blur much below that compares speckle, one much above it has less resolution than the radar.
"""

MAX_SPAN_M = 20.0
"""Depths of both images together; the number of cosines grows with their span: 6400 here."""

REACH = 8.0
"""Distance in units of the blur at which the kernel is truncated: exp(-(8 / 2)^2) = 1e-7."""


def overlap(first: DepthMap, second: DepthMap, blur_m: float = OVERLAP_BLUR_M) -> float:
    """Return the cosine between two depth maps on the same pixels as densities in space, 0 to 1.

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
