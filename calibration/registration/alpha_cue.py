"""Find alpha from how an image looks: between simulations of several alphas."""

from __future__ import annotations

import numpy as np

from calibration.registration.mesh_fit import FLOOR, MeshFit
from calibration.registration.mesh_rendering import KNOTS_RAD, MeshImage

ALPHA_STARTS = (0.3, 0.0, 0.6, 0.1)
"""Tried first. Between 0 and 0.1 a mirror turns into a surface, and most of all changes."""

ALPHA_TOLERANCE = 0.03
MERGED_ALPHA = 0.04
"""Simulations whose alphas are this near to each other are averaged: they differ by speckle."""

LEVELS_DB = (3.0, 6.0, 10.0, 15.0, 20.0)
AREA_STD = 0.15
"""Scatter of the logarithm of the area that is brighter than a level, from seed to seed."""

PROFILE_STD = 0.5
"""Scatter of the fitted logarithm of the brightness, from seed to seed."""

_KNOTS_COMPARED = 6  # the last knot is where the mesh is hardly seen


def look_of(image: MeshImage, fit: MeshFit) -> np.ndarray:
    """Return numbers that alpha changes and the exact place does not, in units of their scatter.

    How the brightness falls with the angle, as it was fitted, and how much of the mesh's silhouette
    is brighter than so many decibels below its brightest pixel.
    """
    image.look(fit.transform)
    silhouette, _ = image.of(fit.transform, np.zeros(len(KNOTS_RAD)))
    power = image.power[silhouette > FLOOR * silhouette.max()]
    step_x, step_y = image.picture.step_m
    cells = step_x * step_y / image.aperture.cell_m2(image.reference_m)
    brighter = [(power > 10.0 ** (-level / 10.0) * power.max()).sum() for level in LEVELS_DB]
    area = np.log(np.maximum(cells * np.array(brighter), cells))
    profile = (fit.log_brightness - fit.log_brightness.max())[:_KNOTS_COMPARED]
    return np.concatenate([profile / PROFILE_STD, area / AREA_STD])


def next_alpha(alphas: list[float], looks: list[np.ndarray], wanted: np.ndarray) -> float:
    """Return the alpha whose look, between those tried, is nearest to the `wanted` one."""
    tried, known = _merged(alphas, looks)
    best, least = float(tried[0]), np.inf
    for i in range(len(tried) - 1):
        along = known[i + 1] - known[i]
        share = float(along @ (wanted - known[i]) / max(along @ along, 1e-12))
        # Beyond what was tried only at the upper end, and not far.
        share = float(np.clip(share, 0.0, 2.0 if i + 2 == len(tried) else 1.0))
        apart = float(((known[i] + share * along - wanted) ** 2).sum())
        if apart < least:
            best, least = float(tried[i] + share * (tried[i + 1] - tried[i])), apart
    return float(np.clip(best, 0.0, 1.0))


def _merged(alphas: list[float], looks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return alphas, ascending, and looks, with neighbours averaged."""
    order = np.argsort(alphas, kind="stable")
    groups: list[list[int]] = []
    for i in order:
        if groups and alphas[i] - alphas[groups[-1][0]] < MERGED_ALPHA:
            groups[-1].append(int(i))
        else:
            groups.append([int(i)])
    tried = np.array([np.mean([alphas[i] for i in group]) for group in groups])
    known = np.array([np.mean([looks[i] for i in group], axis=0) for group in groups])
    return tried, known
