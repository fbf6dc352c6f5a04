"""Reflection of plane waves by a half space or conductor, bare or under one layer."""

from __future__ import annotations

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S

GRAZING_COS = 1e-7  # least cosine of incidence: at 0 some coefficients are a quotient of zeros


def half_space(
    eps: np.ndarray | None, cos_incidence: np.ndarray, under: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Reflection coefficients (r_s, r_p), (n, m), of the boundary between two media.

    `eps` and `under`, (n, 1), are the permittivities behind and before the boundary; `eps` None is
    a perfect conductor. `cos_incidence`, (m,), is that in vacuum. They are of the electric field
    for s, of the magnetic field for p: r_p = -r_s at normal incidence.
    """
    before = normal_index(under, cos_incidence)
    if eps is None:
        return -np.ones_like(before), np.ones_like(before)
    behind = normal_index(eps, cos_incidence)
    r_s = (before - behind) / (before + behind)
    r_p = (eps * before - under * behind) / (eps * before + under * behind)
    return r_s, r_p


def coated(
    eps: np.ndarray | None,
    coating: np.ndarray,
    thickness_m: float,
    frequency_hz: np.ndarray,
    cos_incidence: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Reflection coefficients (r_s, r_p) as `half_space`, under a layer of permittivity `coating`.

    Exact for any thickness: r = (r_01 + r_12 e) / (1 + r_01 r_12 e), e = exp(-2 j k q d), the sum
    over all reflections within the layer (M. Born, E. Wolf, Principles of Optics, 7.6).
    """
    wavenumber = 2 * np.pi * frequency_hz[:, None] / SPEED_OF_LIGHT_M_PER_S
    through = np.exp(-2j * wavenumber * thickness_m * normal_index(coating, cos_incidence))
    outer = half_space(coating, cos_incidence)
    inner = half_space(eps, cos_incidence, coating)
    r_s, r_p = (
        (a + b * through) / (1 + a * b * through) for a, b in zip(outer, inner, strict=True)
    )
    return r_s, r_p


def normal_index(eps: np.ndarray | float, cos_incidence: np.ndarray) -> np.ndarray:
    """sqrt(eps - sin^2) with the branch that decays: the normal wavenumber relative to vacuum's."""
    root = np.sqrt(np.asarray(eps, np.complex128) - (1 - cos_incidence**2))
    return np.where(root.imag > 0, -root, root)
