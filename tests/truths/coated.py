"""Scattering by a sphere under one even layer, far away: the Mie series of two boundaries.

Time factor exp(+j w t), permittivity eps' - j eps''. A permittivity of None is a perfect conductor.
The logarithmic derivative of the radial functions is carried from the core through the layer [1]_.

References
----------
.. [1] C. F. Bohren, D. R. Huffman, Absorption and Scattering of Light by Small Particles,
   Wiley 1983, section 8.1.
"""

import numpy as np
from scipy.special import hankel1e, hankel2e

from truths.mie import order_of, riccati


def cross_section_m2(
    radius_m: float, k: float, core: complex | None, layer: complex, thickness_m: float
) -> float:
    """Radar cross section, square metres, of a sphere of outer radius `radius_m` far away."""
    size = k * radius_m
    n = np.arange(1, order_of(size) + 1)
    index = np.sqrt(complex(layer))
    inner, outer = index * k * (radius_m - thickness_m), index * size
    slope, field = _core(n, k * (radius_m - thickness_m), core)
    psi, xi, dpsi, dxi = riccati(n, size)
    electric = _through(n, inner, outer, slope[0] * index, field[0]) / index
    a = (electric * psi - dpsi) / (electric * xi - dxi)
    magnetic = _through(n, inner, outer, slope[1] / index, field[1]) * index
    b = (magnetic * psi - dpsi) / (magnetic * xi - dxi)
    return float(np.pi / k**2 * abs(np.sum((2 * n + 1) * (-1.0) ** n * (a - b))) ** 2)


def _core(n: np.ndarray, size: float, permittivity: complex | None) -> tuple[np.ndarray, ...]:
    """psi'/m and psi (electric), m psi' and psi (magnetic) at the core, up to a common factor."""
    zeros, ones = np.zeros(len(n)), np.ones(len(n))
    if permittivity is None:
        return np.array([zeros, ones]), np.array([ones, zeros])
    index = np.sqrt(complex(permittivity))
    inside = index * size
    start = int(max(len(n), abs(inside)) + 16)
    slope = np.zeros(start + 1, complex)
    for m in range(start, 0, -1):  # downwards, where the recursion is stable
        slope[m - 1] = m / inside - 1 / (slope[m] + m / inside)
    slope = slope[1 : len(n) + 1]
    return np.array([slope / index, slope * index]), np.array([ones, ones])


def _through(
    n: np.ndarray, inner: complex, outer: complex, slope: np.ndarray, field: np.ndarray
) -> np.ndarray:
    """The logarithmic derivative at `outer` of the function of this slope and value at `inner`.

    It is a sum of z h_n^(1) and z h_n^(2), each without its exponential, which the layer adds.
    """
    (out1, in1, dout1, din1), (out2, in2, dout2, din2) = _waves(n, inner), _waves(n, outer)
    mixed = (slope * out1 - field * dout1) / (field * din1 - slope * in1)
    mixed = mixed * np.exp(-2j * (outer - inner))
    return (dout2 + mixed * din2) / (out2 + mixed * in2)


def _waves(n: np.ndarray, z: complex) -> tuple[np.ndarray, ...]:
    """z h_n^(1) exp(-j z), z h_n^(2) exp(+j z), and the same of their derivatives."""
    found = []
    for hankel in (hankel1e, hankel2e):
        factor = np.sqrt(np.pi * z / 2)
        here, before = factor * hankel(n + 0.5, z), factor * hankel(n - 0.5, z)
        found.append((here, before - n / z * here))
    (h1, dh1), (h2, dh2) = found
    return h1, h2, dh1, dh2
