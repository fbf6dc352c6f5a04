"""Tables of what a leg of a path, from antenna to surface, depends on: materials and patterns.

The reflection coefficient of a pair of directions is -g(theta_t) g(theta_r) with g = sqrt(-Gamma),
so each leg has a factor of its own (E12 in ``docs/equations.md``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaPattern, Material

NODES = 128
"""Of a material's table, evenly over sqrt(cos theta), in which g is smooth also at grazing
incidence, where it goes to 0 like it. Interpolation is off by up to 1/8 of the square of a step
times the second derivative, which was below 3 for skin, palm, plaster and wood: 2.4e-5."""

PATTERN_NODES = 4096
"""Of a pattern's table, evenly over sin(angle / 2), which resolves beams of half a degree."""


def reflection_legs(materials: Sequence[Material], frequencies_hz: np.ndarray) -> np.ndarray:
    """Return the factors of a leg over angle, float64, shape (n_materials, n_freq, NODES, 3).

    Over sqrt(cos theta) from 0 to 1: real and imaginary part of g exp(-k^2 h_u^2 cos^2 theta), and
    the amplitude of the incoherent part of micro-roughness h_u, times sqrt(4 pi / k): its field has
    no factor k / 4 pi, which the sum is multiplied with at last.
    """
    cosine = np.linspace(0.0, 1.0, NODES) ** 2
    out = np.empty((len(materials), len(frequencies_hz), NODES, 3))
    for at, material in enumerate(materials):
        gamma = material.reflection(frequencies_hz, cosine)
        # The root is continuous over angle; its sign does not matter, since two legs share it.
        phase = np.unwrap(np.angle(-gamma)[:, ::-1], axis=1)[:, ::-1]
        g = np.sqrt(np.abs(gamma)) * np.exp(0.5j * phase)
        waves = 2.0 * np.pi * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        damping = (waves[:, None] * material.micro_roughness_rms_m * cosine) ** 2
        g *= np.exp(-damping)
        out[at, :, :, 0], out[at, :, :, 1] = g.real, g.imag
        lost = np.abs(gamma) ** 2 * -np.expm1(-4.0 * damping)
        out[at, :, :, 2] = _incoherent(lost, cosine) * np.sqrt(4.0 * np.pi / waves)[:, None]
    return out


def _incoherent(lost: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Amplitude a of each leg with sigma0 = 4 a_t^2 a_r^2 that scatters the power `lost`.

    a^2 = cos theta L(theta) / sqrt(M), M = 2 int L cos dcos: then the power scattered from theta,
    int sigma0 dOmega / (4 pi cos theta), is L(theta), the part that the specular direction lost.
    """
    from scipy.integrate import trapezoid

    mean = 2.0 * trapezoid(lost * cosine, cosine, axis=1)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        square = np.where(mean > 0, cosine * lost / np.sqrt(mean), 0.0)
    return np.sqrt(square)


def pattern_table(pattern: AntennaPattern | None) -> np.ndarray:
    """Return a pattern's field over sin(angle to boresight / 2), (PATTERN_NODES,), float64."""
    if pattern is None:
        return np.ones(PATTERN_NODES)
    return pattern.amplitude(1.0 - 2.0 * np.linspace(0.0, 1.0, PATTERN_NODES) ** 2)
