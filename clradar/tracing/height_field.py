"""Waves of a Gaussian height field: the roughness of a surface.

    eta(q) = h sqrt(2 / M) sum_m cos(K_m . q + phi_m),    K_m normal, sqrt(2) / l per component

has Gaussian heights of RMS h and the correlation exp(-r^2 / l^2) for any two points r apart, since
that is E cos(K . r) (E12 in ``docs/equations.md``; S. O. Rice, "Mathematical analysis of random
noise", Bell Syst. Tech. J. 23 (1944) 282, for the sum of waves).
"""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from clradar.opencl import Buffers
from clradar.opencl.program import Program

TORN = 2.0
"""Edges that are longer by this factor in the coordinates of the roughness are torn: the face lies
between parts of a body that do not belong together, as two fingers that touch."""

WAVES = 512  # waves of a height field; the kurtosis of the heights is 3 - 1.5 / WAVES


def wave_table(
    program: Program, buffers: Buffers, seed: int, name: str, correlation_length_m: float
) -> np.ndarray:
    """Return the waves of a material by ``roughness.cl``, float32, shape (WAVES, 4).

    Wave vectors, cycles per metre, and phases, cycles in [-0.5, 0.5). They depend on the seed and
    the material's `name` alone: parts of one material share a height field, other materials have
    their own, whatever else there is in the scene.
    """
    u = np.uint32
    bits = buffers.empty(32 * WAVES)
    key = int.from_bytes(sha256(name.encode()).digest()[:4], "little")
    program.launch(
        "wave_bits", (WAVES,), u(WAVES), u(key), u(seed & 0xFFFFFFFF), u(seed >> 32), bits
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


def mended_texture(triangles_m: np.ndarray, texture_m: np.ndarray) -> np.ndarray:
    """Return corners in the coordinates of the roughness, (n_faces, 3, 3), without torn faces.

    On a face that is stretched over another stretch of the texture heights would follow each other
    too closely, and slopes would have no bound. It has the texture that begins at its first corner,
    unstretched, instead.
    """
    edges, stretched = (np.roll(c, -1, axis=1) - c for c in (triangles_m, texture_m))
    length_m, stretched_m = (np.linalg.norm(e, axis=2) for e in (edges, stretched))
    torn = np.flatnonzero((stretched_m > TORN * length_m).any(axis=1))
    if len(torn) == 0:
        return texture_m
    out = texture_m.copy()
    along, across = stretched[torn, 0], -stretched[torn, 2]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    across = across - np.einsum("fa,fa->f", across, along)[:, None] * along
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    first_m, third = length_m[torn, 0], -edges[torn, 2]
    x_m = np.einsum("fa,fa->f", third, edges[torn, 0]) / np.maximum(first_m, 1e-30)
    y_m = np.sqrt(np.maximum(np.einsum("fa,fa->f", third, third) - x_m**2, 0.0))
    out[torn, 1] = out[torn, 0] + first_m[:, None] * along
    out[torn, 2] = out[torn, 0] + x_m[:, None] * along + y_m[:, None] * across
    return out
