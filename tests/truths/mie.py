"""Scattering by spheres: the Mie series, far away [1]_, under a layer, and for a near dipole [2]_.

Time factor exp(+j w t), permittivity eps' - j eps''. A permittivity of None is a perfect conductor.

References
----------
.. [1] C. F. Bohren, D. R. Huffman, Absorption and Scattering of Light by Small Particles,
   Wiley 1983, chapter 4 and appendix A.
.. [2] C.-T. Tai, Dyadic Green Functions in Electromagnetic Theory, 2nd ed., IEEE Press 1994,
   chapter 10.
"""

import numpy as np
from scipy.special import hankel1e, hankel2e, spherical_jn, spherical_yn


def order_of(size: float) -> int:
    """Number of terms for a sphere of circumference / wavelength `size` [1]_."""
    return int(size + 4.05 * size ** (1 / 3) + 10)


def riccati(n: np.ndarray, x: float) -> tuple[np.ndarray, ...]:
    """psi = x j_n, xi = x h_n^(2), and their derivatives by x."""
    j, y = spherical_jn(n, x), spherical_yn(n, x)
    dj, dy = spherical_jn(n, x, derivative=True), spherical_yn(n, x, derivative=True)
    h, dh = j - 1j * y, dj - 1j * dy
    return x * j, x * h, j + x * dj, h + x * dh


def coefficients(
    size: float, permittivity: complex | None, layer: complex | None = None, thickness: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients a_n (electric) and b_n (magnetic) of the scattered field, n = 1, 2, ... [1]_.

    The logarithmic derivatives of the core are carried through an even layer, if there is one, of
    a `thickness` in units of 1/k (section 8.1).
    """
    n = np.arange(1, order_of(size) + 1)
    psi, xi, dpsi, dxi = riccati(n, size)
    electric, magnetic = _core(n, size - thickness, permittivity)
    if layer is not None:
        index = np.sqrt(complex(layer))
        ends = index * (size - thickness), index * size
        electric = _through(n, *ends, electric[0] * index, electric[1]) / index, 1.0
        magnetic = _through(n, *ends, magnetic[0] / index, magnetic[1]) * index, 1.0
    (a, b) = ((d * psi - f * dpsi) / (d * xi - f * dxi) for d, f in (electric, magnetic))
    return a, b


def _core(n: np.ndarray, size: float, permittivity: complex | None) -> tuple[tuple, tuple]:
    """psi'/m and psi (electric), m psi' and psi (magnetic) at the core, up to a common factor."""
    if permittivity is None:
        return (0.0, 1.0), (1.0, 0.0)
    index = np.sqrt(complex(permittivity))
    inside = index * size
    # Logarithmic derivative of psi(m x), downwards from far beyond the last term.
    start = int(max(len(n), abs(inside)) + 16)
    slope = np.zeros(start + 1, complex)
    for m in range(start, 0, -1):
        slope[m - 1] = m / inside - 1 / (slope[m] + m / inside)
    slope = slope[1 : len(n) + 1]
    return (slope / index, 1.0), (slope * index, 1.0)


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


def cross_section_m2(
    radius_m: float,
    k: float,
    permittivity: complex | None,
    layer: complex | None = None,
    thickness_m: float = 0.0,
) -> float:
    """Radar cross section, square metres, of a sphere far away; a layer is within its radius."""
    a, b = coefficients(k * radius_m, permittivity, layer, k * thickness_m)
    n = np.arange(1, len(a) + 1)
    return float(np.pi / k**2 * abs(np.sum((2 * n + 1) * (-1.0) ** n * (a - b))) ** 2)


def efficiencies(radius_m: float, k: float, permittivity: complex | None) -> tuple[float, float]:
    """Extinction and scattering cross sections over that of the disc."""
    a, b = coefficients(k * radius_m, permittivity)
    n = np.arange(1, len(a) + 1)
    size2 = (k * radius_m) ** 2
    extinction = 2 / size2 * np.sum((2 * n + 1) * (a + b).real)
    scattering = 2 / size2 * np.sum((2 * n + 1) * (abs(a) ** 2 + abs(b) ** 2))
    return float(extinction), float(scattering)


def echo_per_m(
    distance_m: float, radius_m: float, k: float, permittivity: complex | None
) -> complex:
    """Echo u, 1/m, of a dipole at `distance_m` from the sphere's centre, along it and at its place.

    u is 4 pi times the scattered part of Green's function for a dipole across the line to the
    centre [2]_, which is Gamma exp(-2 j k R) / (2 R) for a plane at the distance R.
    """
    a, b = coefficients(k * radius_m, permittivity)
    n = np.arange(1, len(a) + 1)
    x = k * distance_m
    _, xi, _, dxi = riccati(n, x)
    return complex(1j * k * np.sum((2 * n + 1) / 2 * (b * (xi / x) ** 2 + a * (dxi / x) ** 2)))
