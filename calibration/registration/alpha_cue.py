"""Estimation of alpha from pose-invariant features, between simulations at several alphas."""

from __future__ import annotations

import numpy as np

from calibration.registration.mesh_fit import POWER_FLOOR, MeshFit
from calibration.registration.mesh_rendering import KNOTS_RAD, Canvas, MeshRendering

ALPHA_STARTS = (0.3, 0.0, 0.6, 0.1)
"""Simulated first. Most of the change is between 0 and 0.1, from a mirror to a rough surface."""

FEWEST_ROUNDS = len(ALPHA_STARTS) + 3
"""Of a registration that has to find alpha: the starts, and three that come to rest. It took 5 to
12 in simulations (docs/registration-method.md)."""

ALPHA_TOLERANCE = 0.03
MERGED_ALPHA = 0.04  # simulations whose alphas differ by less are averaged: they differ by speckle
LEVELS_DB = (3.0, 6.0, 10.0, 15.0, 20.0)
AREA_STD = 0.15  # scatter over the seeds of the logarithm of the area above a level
PROFILE_STD = 0.5  # scatter over the seeds of the fitted logarithm of the brightness
_KNOTS_COMPARED = 6  # without the last, at grazing incidence


def pose_invariant_features(image: MeshRendering, fit: MeshFit) -> np.ndarray:
    """`brightness_features` of a fitted mesh."""
    image.update_visibility(fit.transform)
    silhouette, _ = image.render(fit.transform, np.zeros(len(KNOTS_RAD)))
    return brightness_features(image, silhouette, fit.log_brightness)


def brightness_features(
    image: Canvas, silhouette: np.ndarray, log_brightness: np.ndarray
) -> np.ndarray:
    """Features that depend on alpha but hardly on the pose, in units of their scatter.

    The fitted fall of the brightness with the angle, and the areas of the object's silhouette, its
    rendering with a brightness of 1, within several levels of its brightest pixel.
    """
    power = image.power[silhouette > POWER_FLOOR * silhouette.max()]
    step_x, step_y = image.measured.step_m
    cells = step_x * step_y / image.aperture.cell_m2(image.reference_m)
    brighter = [(power > 10.0 ** (-level / 10.0) * power.max()).sum() for level in LEVELS_DB]
    area = np.log(np.maximum(cells * np.array(brighter), cells))
    profile = (log_brightness - log_brightness.max())[:_KNOTS_COMPARED]
    return np.concatenate([profile / PROFILE_STD, area / AREA_STD])


def next_alpha(alphas: list[float], features: list[np.ndarray], wanted: np.ndarray) -> float:
    """Alpha whose features, interpolated between the simulated ones, are nearest to `wanted`."""
    tried, known = _merged(alphas, features)
    best, least = float(tried[0]), np.inf
    for i in range(len(tried) - 1):
        along = known[i + 1] - known[i]
        share = float(along @ (wanted - known[i]) / max(along @ along, 1e-12))
        # Extrapolated at the upper end only, and not far.
        share = float(np.clip(share, 0.0, 2.0 if i + 2 == len(tried) else 1.0))
        apart = float(((known[i] + share * along - wanted) ** 2).sum())
        if apart < least:
            best, least = float(tried[i] + share * (tried[i + 1] - tried[i])), apart
    return float(np.clip(best, 0.0, 1.0))


def _merged(alphas: list[float], features: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Ascending alphas and their features, with neighbours averaged."""
    order = np.argsort(alphas, kind="stable")
    groups: list[list[int]] = []
    for i in order:
        if groups and alphas[i] - alphas[groups[-1][0]] < MERGED_ALPHA:
            groups[-1].append(int(i))
        else:
            groups.append([int(i)])
    tried = np.array([np.mean([alphas[i] for i in group]) for group in groups])
    known = np.array([np.mean([features[i] for i in group], axis=0) for group in groups])
    return tried, known
