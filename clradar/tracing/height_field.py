"""Waves of a Gaussian height field: the roughness of a surface.

    eta(q) = h sqrt(2 / M) sum_m cos(K_m . q + phi_m),    K_m normal, sqrt(2) / l per component

has Gaussian heights of RMS h and the correlation exp(-r^2 / l^2) for any two points r apart, since
that is E cos(K . r) (E12 in ``docs/equations.md``; S. O. Rice, "Mathematical analysis of random
noise", Bell Syst. Tech. J. 23 (1944) 282, for the sum of waves).
"""

from __future__ import annotations

import numpy as np

from clradar.opencl import Buffers
from clradar.opencl.program import Program

WAVES = 512
"""Waves of a height field; the kurtosis of the heights is 3 - 1.5 / WAVES."""


def wave_table(
    program: Program, buffers: Buffers, seed: int, material: int, correlation_length_m: float
) -> np.ndarray:
    """Return the waves of a material, shape (WAVES, 4), float32.

    Parameters
    ----------
    program : Program
        ``roughness.cl``.
    buffers : Buffers
    seed : int
        Of the simulation. Waves depend on it and on `material` alone.
    material : int
        Index of the material in the scene: parts of one material share a height field, other
        materials have their own.
    correlation_length_m : float, metres

    Returns
    -------
    ndarray
        Wave vectors, cycles per metre, and phases, cycles in [-0.5, 0.5).
    """
    u = np.uint32
    bits = buffers.empty(32 * WAVES)
    program.launch(
        "wave_bits", (WAVES,), u(WAVES), u(material), u(seed & 0xFFFFFFFF), u(seed >> 32), bits
    )
    words = buffers.read(bits, (WAVES, 8), np.uint32)
    buffers.release(bits)
    # The middle of one of 2^23 cells of (0, 1).
    uniform = ((words >> 9).astype(np.float64) + 0.5) / 2**23
    radius, angle = np.sqrt(-2.0 * np.log(uniform[:, 0])), 2.0 * np.pi * uniform[:, 1]
    other = np.sqrt(-2.0 * np.log(uniform[:, 2])) * np.cos(2.0 * np.pi * uniform[:, 3])
    normal = np.stack([radius * np.cos(angle), radius * np.sin(angle), other], axis=1)
    cycles_per_m = np.sqrt(2.0) / correlation_length_m / (2.0 * np.pi) * normal
    phase = uniform[:, 4] - np.round(uniform[:, 4])
    return np.column_stack([cycles_per_m, phase]).astype(np.float32)
