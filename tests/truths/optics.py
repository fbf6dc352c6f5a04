"""Closed forms of physical and geometrical optics: spheres, discs, plates, corners, apertures.

Echoes u in 1/m as in docs/equations.md; k in rad/m. Cross sections in square metres.

References
----------
.. [1] E. F. Knott, J. F. Shaeffer, M. T. Tuley, Radar Cross Section, 2nd ed., SciTech 2004.
.. [2] C. A. Balanis, Advanced Engineering Electromagnetics, 2nd ed., Wiley 2012, chapter 11.
.. [3] C. A. Balanis, Antenna Theory, 4th ed., Wiley 2016, chapter 6.
"""

import numpy as np
from scipy.special import fresnel


def cross_section_m2(u: np.ndarray, distance_m: float) -> np.ndarray:
    """sigma = 4 pi R^4 |u|^2."""
    return 4 * np.pi * distance_m**4 * np.abs(u) ** 2


def _beyond(k: np.ndarray, from_m: float) -> np.ndarray:
    """Integral of exp(-2 j k r) / r^2 from a distance on: E_2(2 j k r) / r.

    E_2(z) = exp(-z)/(z + 2 - 2/(z + 4 - 6/(z + 6 - 12/(...)))), the even form of Abramowitz and
    Stegun's 5.1.22; z is large here.
    """
    z = 2j * k * from_m
    tail = np.zeros(np.shape(z), complex)
    for i in range(60, 0, -1):
        tail = i * (i + 1) / (z + 2 * i + 2 - tail)
    return np.exp(-z) / (z + 2 - tail) / from_m


def _over_distance(k: np.ndarray, near_m: float, far_m: float) -> np.ndarray:
    return _beyond(k, near_m) - _beyond(k, far_m)


def sphere(distance_m: float, radius_m: float, k: np.ndarray, gamma: complex = -1.0) -> np.ndarray:
    """Physical optics of a sphere up to its sharp shadow edge, antenna at D from its centre.

    With r the distance from the antenna, dA = 2 pi a r dr / D and s.n = (T^2 - r^2) / (2 a r),
    u = (j k Gamma / 2 D) Integral (T^2 - r^2)/r^2 exp(-2 j k r) dr from D - a to the edge at
    T = sqrt(D^2 - a^2). Gamma is taken as the same at all angles.
    """
    near, edge = distance_m - radius_m, np.sqrt(distance_m**2 - radius_m**2)
    plain = (np.exp(-2j * k * edge) - np.exp(-2j * k * near)) / (-2j * k)
    total = edge**2 * _over_distance(k, near, edge) - plain
    return 1j * k * gamma / (2 * distance_m) * total


def sphere_returned_share(
    distance_m: float, radius_m: float, reach_m: float, k: float, nodes: int = 160
) -> float:
    """Power through a sphere of `reach_m` around a metal sphere over what falls on it.

    Physical optics, with sharp shadows for Tx and Rx: sums over equal steps of the longitude and
    Gauss and Legendre's nodes of the latitude, for as many directions as half of them.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    phi = 2 * np.pi * (np.arange(2 * nodes) + 0.5) / (2 * nodes)
    ring = np.sqrt(1 - x**2)
    n = np.stack(
        [np.outer(ring, np.cos(phi)), np.outer(ring, np.sin(phi)), np.outer(x, 1 + 0 * phi)]
    )
    area = radius_m**2 * np.outer(weight, np.full(2 * nodes, np.pi / nodes))

    def leg(at_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        to = at_m[:, None, None] - radius_m * n
        r = np.sqrt((to**2).sum(axis=0))
        cosine = (to * n).sum(axis=0) / r
        return np.where(cosine > 0, np.exp(-1j * k * r) / r, 0), cosine

    wave_t, cos_t = leg(np.array([0, 0, -distance_m]))
    z, z_weight = np.polynomial.legendre.leggauss(nodes // 2)
    power = 0.0
    for c, w in zip(z, z_weight, strict=True):
        wave_r, cos_r = leg(reach_m * np.array([np.sqrt(1 - c * c), 0, c]))
        u = k / (4 * np.pi) * np.sum(area * (cos_t + cos_r) * wave_t * wave_r)
        power += 2 * np.pi * w * abs(u) ** 2 * reach_m**2
    return float(power / (2 * np.pi * (1 - np.sqrt(1 - (radius_m / distance_m) ** 2))))


def fresnel_gamma(permittivity: complex, cosine: np.ndarray) -> np.ndarray:
    """Fresnel's (r_s - r_p)/2 of a half space, eps' - j eps'', r_p = -r_s at normal incidence."""
    inside = np.sqrt(permittivity - 1 + np.square(cosine))
    r_s = (cosine - inside) / (cosine + inside)
    return (r_s - (permittivity * cosine - inside) / (permittivity * cosine + inside)) / 2


def lossy_sphere(
    distance_m: float, radius_m: float, k: np.ndarray, permittivity: np.ndarray
) -> np.ndarray:
    """As `sphere`, Gamma by the angle of incidence at every point; Gauss and Legendre's nodes."""
    near, edge = distance_m - radius_m, np.sqrt(distance_m**2 - radius_m**2)
    x, weight = np.polynomial.legendre.leggauss(int(200 + 2 * k.max() * (edge - near)))
    r = (near + edge) / 2 + (edge - near) / 2 * x
    cosine = (edge**2 - r**2) / (2 * radius_m * r)
    out = [
        (edge - near) / 2 * weight @ (fresnel_gamma(e, cosine) * cosine * np.exp(-2j * q * r) / r)
        for q, e in zip(k, permittivity, strict=True)
    ]
    return 1j * k * radius_m / distance_m * np.array(out)


def plane(distance_m: float, k: np.ndarray, gamma: complex = -1.0) -> np.ndarray:
    """Physical optics of a plane without end: `image_source` but for terms of 1/(k R)."""
    return 1j * k * gamma * distance_m * _beyond(k, distance_m)


def disc(distance_m: float, radius_m: float, k: np.ndarray, gamma: complex = -1.0) -> np.ndarray:
    """Physical optics of a disc on its axis; without edge it tends to `image_source`."""
    far = np.hypot(distance_m, radius_m)
    return 1j * k * gamma * distance_m * _over_distance(k, distance_m, far)


def image_source(distance_m: float, k: np.ndarray, gamma: complex = -1.0) -> np.ndarray:
    """A plane without end at the distance R [2]_."""
    return gamma * np.exp(-2j * k * distance_m) / (2 * distance_m)


def rectangle(
    distance_m: float, sides_m: tuple[float, float], k: np.ndarray, gamma: complex = -1.0
) -> np.ndarray:
    """Rectangle on its axis with phases to second order in its size (Fresnel's approximation)."""
    product = np.ones(np.shape(k), complex)
    for side in sides_m:
        # exp(-j k x^2 / R) = exp(-j pi v^2 / 2)
        scale = np.sqrt(2 * k / (np.pi * distance_m))
        s, c = fresnel(scale * side / 2)
        product = product * 2 * (c - 1j * s) / scale
    wave = np.exp(-2j * k * distance_m) / distance_m**2
    return 1j * k / (2 * np.pi) * gamma * wave * product


def any_rectangle(
    distance_m: float,
    sides_m: tuple[float, float],
    tilt_rad: float,
    k: np.ndarray,
    nodes: int = 200,
) -> np.ndarray:
    """Rectangle at any distance, tilted about its second side, by Gauss and Legendre's nodes."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    across, along = np.meshgrid(x * sides_m[0] / 2, x * sides_m[1] / 2, indexing="ij")
    z = distance_m + across * np.sin(tilt_rad)
    r = np.sqrt((across * np.cos(tilt_rad)) ** 2 + along**2 + z**2)
    facing = distance_m * np.cos(tilt_rad)  # n.p is the same all over the plane
    area = np.outer(weight, weight) * sides_m[0] * sides_m[1] / 4
    return np.array(
        [
            -1j * q / (2 * np.pi) * np.sum(area * facing * np.exp(-2j * q * r) / r**3)
            for q in np.atleast_1d(k)
        ]
    )


def tilted_rectangle_m2(
    sides_m: tuple[float, float], tilt_rad: np.ndarray, k: np.ndarray
) -> np.ndarray:
    """Cross section far away, tilted about the second side: 4 pi A^2/lambda^2 (cos sinc)^2 [1]_."""
    area, wavelength = sides_m[0] * sides_m[1], 2 * np.pi / k
    phase = k * sides_m[0] * np.sin(tilt_rad)
    return 4 * np.pi * (area / wavelength * np.cos(tilt_rad) * np.sinc(phase / np.pi)) ** 2


def dihedral_m2(a_m: float, b_m: float, wavelength_m: float) -> float:
    """Two rectangles a x b on the bisector of their right angle [1]_."""
    return 8 * np.pi * (a_m * b_m / wavelength_m) ** 2


def square_trihedral_m2(a_m: float, wavelength_m: float) -> float:
    """Three squares on their axis [1]_."""
    return 12 * np.pi * a_m**4 / wavelength_m**2


def triangular_trihedral_m2(a_m: float, wavelength_m: float) -> float:
    """Three right triangles of legs a on their axis [1]_."""
    return 4 * np.pi * a_m**4 / (3 * wavelength_m**2)


def dirichlet(n: int, phase_rad: np.ndarray) -> np.ndarray:
    """Mean of n unit phasors in steps of `phase_rad`, centred: sin(n x/2) / (n sin(x/2)) [3]_."""
    half = np.asarray(phase_rad) / 2
    small = np.abs(np.sin(half)) < 1e-12
    return np.where(small, 1.0, np.sin(n * half) / (n * np.where(small, 1.0, np.sin(half))))
