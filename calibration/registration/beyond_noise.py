"""Where a measurement differs from simulations of the mesh by more than these among themselves.

Every image is fitted by the same rendering, whose errors (interference, the curvature of glints)
are in the residuals of all. What the measurement's have beyond those of the mesh's own simulations
is noise, whose size is the scatter of the simulations, or another pose or shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from calibration.registration.mesh_fit import (
    CAUCHY_SCALE,
    POWER_FLOOR,
    TUKEY_CUTOFF,
    MeshFit,
    residuals,
)
from calibration.registration.mesh_rendering import MeshRendering

CELL_STD_M = 4e-3
"""Residuals are averaged by a Gaussian of this standard deviation, about the resolution."""

SMALLEST_NOISE = 0.03
"""Of averaged residuals, in their own scale: simulations of a hand have 0.04 to 0.15."""

NOMINAL_NOISE = {"level": 0.087, "range": 0.108}
"""Median over the simulations of 18 simulated measurements of hands. The standard deviations of the
fit after the correction were measured with such residuals: larger ones widen them."""

FEWEST_SIMULATIONS = 1.5  # effective number below which the scatter of simulations says nothing
LOCAL_RATIO = 3.0
"""Ratio to the noise from which a pixel disagrees: one in a hundred does by chance."""

ALPHA_WIDTH, MOST_ALPHA = 0.1, 0.15
"""Alphas of the simulations from which the residuals' change with alpha is estimated, and the
largest error of alpha that it may explain: alpha is found to 0.1 in most simulations."""

SMALLEST_PLACE_M2 = 5e-5  # three resolution cells: smaller ones are mostly chance
MOST_PLACES = 3  # listed, the worst first


@dataclass(frozen=True, slots=True, eq=False)
class ResidualImage:
    """Averaged residuals of a fit and what they are of, each of shape (n_y, n_x).

    `level` and `range`, residuals of brightness and range in units of their scales; `power` and
    `range_m`, of the image, NaN without depth; `drawn`, the rendering's power; `drawn_m`, its
    range; `x_m`, `y_m`, the pixels.
    """

    level: np.ndarray
    range: np.ndarray
    power: np.ndarray
    range_m: np.ndarray
    drawn: np.ndarray
    drawn_m: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray

    @classmethod
    def of(cls, image: MeshRendering, fit: MeshFit) -> ResidualImage:
        """The residuals of a fit to the image of a rendering, with visibility updated there."""
        power, range_m = image.render(fit.transform, fit.log_brightness)
        found = residuals(image, power, range_m)
        # Clipped where the fit's weights fall: a few glints would be all there is.
        level = np.clip(found.speckle, -2.0 * CAUCHY_SCALE, 2.0 * CAUCHY_SCALE)
        ranges = np.clip(found.range_m / found.range_std_m, -TUKEY_CUTOFF, TUKEY_CUTOFF)
        width = [CELL_STD_M / step_m for step_m in reversed(image.measured.step_m)]
        return cls(
            level=ndimage.gaussian_filter(level, width),
            range=ndimage.gaussian_filter(ranges * np.sqrt(found.covered), width),
            power=image.power,
            range_m=image.measured.range_m,
            drawn=power,
            drawn_m=range_m,
            x_m=image.measured.x_m,
            y_m=image.measured.y_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A place where a measurement and the mesh, simulated in the pose found, disagree.

    Attributes
    ----------
    position_m : ndarray, shape (3,)
        On the measured surface.
    area_m2 : float
        Across the line of sight.
    ratio : float
        Root mean square of the residuals there, relative to the noise.
    closer_m : float
        How much closer to the radar the measured surface is; NaN where either has no depth.
    brighter_db : float
        How much higher the measured power is.

    Examples
    --------
    >>> print(calibration.Place(np.array([0.02, 0.06, 0.3]), 4e-4, 6.2, 5.1e-3, -2.0).text())
    x, y, z 20, 60, 300 mm (4 cm2): measured 5.1 mm closer and 2.0 dB darker
    """

    position_m: np.ndarray
    area_m2: float
    ratio: float
    closer_m: float
    brighter_db: float

    def text(self) -> str:
        """One clause."""
        at = ", ".join(f"{1e3 * v:.0f}" for v in self.position_m)
        what = []
        if np.isfinite(self.closer_m):
            side = "closer" if self.closer_m > 0 else "farther"
            what.append(f"{1e3 * abs(self.closer_m):.1f} mm {side}")
        side = "brighter" if self.brighter_db > 0 else "darker"
        what.append(f"{abs(self.brighter_db):.1f} dB {side}")
        return f"x, y, z {at} mm ({1e4 * self.area_m2:.0f} cm2): measured {' and '.join(what)}"


@dataclass(frozen=True, slots=True, eq=False)
class BeyondNoise:
    """What the residuals of a measurement are beyond noise.

    `ratio`, root mean square of the residuals over the lit pixels, relative to the noise; 1 is
    noise, None with too few simulations to know it. `widening`, the same relative to the nominal
    noise, at least 1, by which the standard deviations are wider. `places`, worst first.
    """

    ratio: float | None = None
    widening: float = 1.0
    places: tuple[Place, ...] = ()


def beyond_noise(
    measured: ResidualImage,
    simulated: Sequence[ResidualImage],
    weights: np.ndarray,
    alphas: Sequence[float],
    centre_m: np.ndarray,
) -> BeyondNoise:
    """Residuals of a measurement relative to the noise, and the places where they are largest.

    `weights`, (n,), are how near each simulation is to the pose and the alpha that were found;
    `alphas` those of each, the last one that found; empty if alpha is given. With weights w_k of
    sum 1, s the weighted standard deviation of the simulations over all lit pixels, m the residual
    of the measurement, that of a pixel is (m - sum w_k m_k) / (s sqrt(1 + sum w_k^2)). The scatter
    of the measurement is assumed to be that of a simulation. What a small error of alpha explains
    is subtracted by least squares: it is no error of the pose.
    """
    share = weights / weights.sum()
    if 1.0 / (share @ share) < FEWEST_SIMULATIONS:
        return BeyondNoise()
    lit = np.maximum(measured.power, measured.drawn) > POWER_FLOOR
    beyond, by_alpha, noises = [], [], []
    for kind in NOMINAL_NOISE:
        each = np.array([getattr(image, kind) for image in simulated])
        mean = np.tensordot(share, each, 1)
        variance = np.tensordot(share, (each - mean) ** 2, 1)[lit].mean() / (1.0 - share @ share)
        noise = max(np.sqrt(variance), SMALLEST_NOISE) * np.sqrt(1.0 + share @ share)
        noises.append(noise)
        beyond.append(np.where(lit, (getattr(measured, kind) - mean) / noise, 0.0))
        by_alpha.append(np.where(lit, _slope(each, alphas) / noise, 0.0))
    left, slope = np.array(beyond), np.array(by_alpha)
    off = np.sum(left * slope) / max(np.sum(slope**2), 1e-12)
    left = left - np.clip(off, -MOST_ALPHA, MOST_ALPHA) * slope
    square = (left**2).mean(axis=0)
    nominal = np.array(list(NOMINAL_NOISE.values())) * np.sqrt(1.0 + share @ share)
    spread = (left[:, lit] ** 2).mean(axis=1) * (np.array(noises) / nominal) ** 2
    return BeyondNoise(
        ratio=float(np.sqrt(square[lit].mean())),
        widening=max(1.0, float(np.sqrt(spread.mean()))),
        places=_places(measured, simulated, share, np.sqrt(square), left[1], centre_m),
    )


def _slope(each: np.ndarray, alphas: Sequence[float]) -> np.ndarray:
    """Change of images, shape (n, n_y, n_x), with alpha near the last one; 0 if alpha is given."""
    away = np.array(alphas) - alphas[-1] if len(alphas) else np.zeros(len(each))
    weights = np.exp(-0.5 * (away / ALPHA_WIDTH) ** 2)
    away = away - weights @ away / weights.sum()
    return np.tensordot(weights * away, each, 1) / max(weights @ away**2, 1e-12)


def _places(
    measured: ResidualImage,
    simulated: Sequence[ResidualImage],
    share: np.ndarray,
    ratio: np.ndarray,
    away: np.ndarray,
    centre_m: np.ndarray,
) -> tuple[Place, ...]:
    """Connected pixels above `LOCAL_RATIO` on one side, `away`, by the sum of their squares."""
    # Those that are closer and those that are farther each alone: together they would say neither.
    label, closer = ndimage.label((ratio > LOCAL_RATIO) & (away > 0))
    other, farther = ndimage.label((ratio > LOCAL_RATIO) & (away <= 0))
    label, count = np.where(other > 0, other + closer, label), closer + farther
    total = ndimage.sum_labels(ratio**2, label, np.arange(1, count + 1))
    x, y = np.meshgrid(measured.x_m, measured.y_m)
    away_m = measured.drawn_m - measured.range_m
    away_m = away_m - np.tensordot(share, [i.drawn_m - i.range_m for i in simulated], 1)
    power = np.tensordot(share, [i.power / i.drawn for i in simulated], 1) * measured.drawn
    pixel_m2 = float(np.ptp(x[0]) * np.ptp(y[:, 0]) / ((x.shape[1] - 1) * (x.shape[0] - 1)))
    places = []
    for number in 1 + np.argsort(-total):
        here = label == number
        if pixel_m2 * here.sum() < SMALLEST_PLACE_M2:
            continue
        weight = ratio[here] ** 2 / (ratio[here] ** 2).sum()
        across_m = np.array([weight @ x[here], weight @ y[here]]) - centre_m[:2]
        ranges_m = np.where(np.isfinite(measured.range_m), measured.range_m, measured.drawn_m)
        range_m = weight @ ranges_m[here]
        deep_m = np.sqrt(max(range_m**2 - across_m @ across_m, 0.0))
        both = here & np.isfinite(away_m)
        level = (image[here].sum() + POWER_FLOOR for image in (measured.power, power))
        places.append(
            Place(
                position_m=centre_m + np.array([*across_m, deep_m]),
                area_m2=pixel_m2 * int(here.sum()),
                ratio=float(np.sqrt((ratio[here] ** 2).mean())),
                closer_m=float(np.median(away_m[both])) if both.any() else float("nan"),
                brighter_db=float(10.0 * np.log10(next(level) / next(level))),
            )
        )
    return tuple(places[:MOST_PLACES])
