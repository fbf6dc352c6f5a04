"""Rough plates with Gaussian heights and correlation in Kirchhoff's approximation.

q = k (s_t + s_r): q_z across the mean plane, q_t along it. g = h^2 q_z^2.

References
----------
.. [1] P. Beckmann, A. Spizzichino, The Scattering of Electromagnetic Waves from Rough Surfaces,
   Pergamon 1963, chapters 3 and 5.
.. [2] E. I. Thorsos, J. Acoust. Soc. Am. 83 (1988) 78.
.. [3] J. W. Goodman, Speckle Phenomena in Optics, Roberts 2007, chapters 2 and 3.
"""

from math import lgamma

import numpy as np


def coherent(g: np.ndarray) -> np.ndarray:
    """Mean field over that of the smooth plate [1]_."""
    return np.exp(-g / 2)


def coherent_of_waves(g: np.ndarray, n_waves: int) -> np.ndarray:
    """The same for heights made of `n_waves` cosines of random phase: J_0(sqrt(2 g/M))^M."""
    from scipy.special import j0

    return j0(np.sqrt(2 * np.asarray(g) / n_waves)) ** n_waves


def sigma0(q_z: float, q_t: float, k: float, rms_m: float, correlation_m: float) -> float:
    """Incoherent cross section per area of a plate without end, perfect conductor [1]_ [2]_."""
    g = (rms_m * q_z) ** 2
    m = np.arange(1, int(g + 8 * np.sqrt(g) + 40))
    log = m * np.log(g) - np.array([lgamma(i + 1) for i in m]) - np.log(m)
    series = np.exp(log - g - (q_t * correlation_m) ** 2 / (4 * m)).sum()
    f = (q_z**2 + q_t**2) / (k * q_z)
    return float(k**2 * correlation_m**2 * f**2 / 4 * series)


def sigma0_of_rectangle(
    q: np.ndarray, k: float, rms_m: float, correlation_m: float, sides_m: tuple[float, float]
) -> float:
    """The same for a rectangle, far away: its edges cut the correlated area.

    sigma0 = (1/4 pi) Integral (1 - |x|/a)(1 - |y|/b) [chi E - chi_inf q_z^2] exp(j q_t.tau) dtau,
    chi = exp(-g (1 - rho)), with the covariance of the factors (q_z - q_t.grad eta) and the phase
    exp(j q_z (eta - eta')) of jointly Gaussian heights and slopes:
    E = q_z^2 + 2 j q_z^2 h^2 q_t.grad rho - h^2 (q_t.grad)^2 rho - q_z^2 h^4 (q_t.grad rho)^2.
    """
    q_x, q_y, q_z = q
    g = (rms_m * q_z) ** 2
    reach = 4.5 * correlation_m
    step = min(correlation_m / 16, np.pi / (8 * max(np.hypot(q_x, q_y), 1e-9)))
    n = int(np.ceil(reach / step))
    axis = np.arange(-n, n + 1) * (reach / n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    rho = np.exp(-(x**2 + y**2) / correlation_m**2)
    along = q_x * x + q_y * y
    slope = -2 * along / correlation_m**2 * rho  # q_t.grad rho
    bend = (4 * along**2 / correlation_m**4 - 2 * (q_x**2 + q_y**2) / correlation_m**2) * rho
    h2 = rms_m**2
    e = q_z**2 + 2j * q_z**2 * h2 * slope - h2 * bend - q_z**2 * h2**2 * slope**2
    window = np.clip(1 - np.abs(x) / sides_m[0], 0, 1) * np.clip(1 - np.abs(y) / sides_m[1], 0, 1)
    inner = np.exp(-g * (1 - rho)) * e - np.exp(-g) * q_z**2
    total = np.sum(window * inner * np.exp(1j * along)) * (reach / n) ** 2
    return float(total.real / (4 * np.pi))


def contrast(
    coherent_power: float, variance: float, pseudo: complex, phase: complex = 1.0
) -> float:
    """Standard deviation over mean of |A + v|^2, v complex normal [3]_.

    `variance` is E|v|^2 and `pseudo` E v^2 conj(phase)^2, phase = A/|A|; without pseudo it is
    Rice's sqrt(1 + 2 K)/(1 + K), K = |A|^2 / E|v|^2.
    """
    p = pseudo * np.conj(phase) ** 2
    spread = variance**2 + abs(p) ** 2 + 2 * coherent_power * (variance + p.real)
    return float(np.sqrt(spread) / (coherent_power + variance))
