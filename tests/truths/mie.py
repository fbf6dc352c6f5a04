"""Scattering by spheres: the Mie series, far away [1]_ and for a dipole near the sphere [2]_.

Time factor exp(+j w t), permittivity eps' - j eps''. A permittivity of None is a perfect conductor.

References
----------
.. [1] C. F. Bohren, D. R. Huffman, Absorption and Scattering of Light by Small Particles,
   Wiley 1983, chapter 4 and appendix A.
.. [2] C.-T. Tai, Dyadic Green Functions in Electromagnetic Theory, 2nd ed., IEEE Press 1994,
   chapter 10.
"""

import numpy as np
from scipy.special import spherical_jn, spherical_yn


def order_of(size: float) -> int:
    """Number of terms for a sphere of circumference / wavelength `size` [1]_."""
    return int(size + 4.05 * size ** (1 / 3) + 10)


def riccati(n: np.ndarray, x: float) -> tuple[np.ndarray, ...]:
    """psi = x j_n, xi = x h_n^(2), and their derivatives by x."""
    j, y = spherical_jn(n, x), spherical_yn(n, x)
    dj, dy = spherical_jn(n, x, derivative=True), spherical_yn(n, x, derivative=True)
    h, dh = j - 1j * y, dj - 1j * dy
    return x * j, x * h, j + x * dj, h + x * dh


def coefficients(size: float, permittivity: complex | None) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients a_n (electric) and b_n (magnetic) of the scattered field, n = 1, 2, ... [1]_."""
    n = np.arange(1, order_of(size) + 1)
    psi, xi, dpsi, dxi = riccati(n, size)
    if permittivity is None:
        return dpsi / dxi, psi / xi
    index = np.sqrt(complex(permittivity))
    inside = index * size
    # Logarithmic derivative of psi(m x), downwards from far beyond the last term.
    start = int(max(len(n), abs(inside)) + 16)
    slope = np.zeros(start + 1, complex)
    for m in range(start, 0, -1):
        slope[m - 1] = m / inside - 1 / (slope[m] + m / inside)
    slope = slope[1 : len(n) + 1]
    # dpsi and dxi by the same derivative, in the form of [1]_.
    a = (slope / index * psi - dpsi) / (slope / index * xi - dxi)
    b = (slope * index * psi - dpsi) / (slope * index * xi - dxi)
    return a, b


def cross_section_m2(radius_m: float, k: float, permittivity: complex | None) -> float:
    """Radar cross section, square metres, of a sphere far away."""
    a, b = coefficients(k * radius_m, permittivity)
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
