"""Blocks of path length with Chebyshev moments: a type-3 nonuniform Fourier transform by series.

Within a block the phase over the band is a short Jacobi-Anger series in the path length, so a few
moments of a block give all frequencies (E7 in ``docs/equations.md``, ``synthesize.cl``). Expansion
about centres by moments is that of fast multipole methods and of A. Dutt and V. Rokhlin, "Fast
Fourier transforms for nonequispaced data", SIAM J. Sci. Comput. 14 (1993) 1368.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.polynomial import chebyshev

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import Waveform
from clradar.opencl.buffers import hi_lo

MOMENTS = 8  # moments per block: degree 7 in the position within the block
EDGE_PHASE_RAD = 1.0
"""Phase between a block's centre and its edge at the band's edge. With eight moments the error of a
path is 2 (J_8(1) + J_9(1) + ...) = 2.0e-7 at most."""

MOST_SLOTS = 64
"""Blocks that a pair keeps. Fewer for few frequencies, for which a block is cheap to add."""

MOST_CYCLES = 2**21
"""Longest path in cycles of the highest frequency. The kernels count cycles, and blocks, of which
there are up to 1.75 per cycle, in float32 up to 2^22."""

SERIES_TERMS = 12
"""Of the power series of a Bessel function at `EDGE_PHASE_RAD`: the next is below 1e-20."""

NARROWEST_HZ = 1e6
"""Narrower bands have the blocks of this one, 191 m: in longer ones the powers of a short path's
position would underflow, which is slow on a CPU."""

_POWERS = np.zeros((MOMENTS, MOMENTS))  # column p: T_p in powers of x
for _p in range(MOMENTS):
    _POWERS[: _p + 1, _p] = chebyshev.cheb2poly([0.0] * _p + [1.0])


@dataclass(frozen=True, slots=True, eq=False)
class LengthBlocks:
    """Blocks of path length for one waveform: block b is centred at b `block_m`.

    `table` has the weight of each moment at each frequency; then the wavenumbers relative to the
    centre's as hi and lo, cycles per metre.
    """

    block_m: float  # exact in float32
    per_half_block: float  # 1/m, exact in float32: scales the distance from the centre to -1 to 1
    wavenumber: float  # of the band's centre, cycles per metre
    table: np.ndarray  # (MOMENTS + 2, n_freq), float32
    n_slots: int  # blocks that each pair keeps at a time, a power of two
    longest_m: float  # path that can be summed


def length_blocks(waveform: Waveform) -> LengthBlocks:
    """Blocks for a waveform."""
    f_hz, span_hz = waveform.frequencies_hz, max(waveform.span_hz, NARROWEST_HZ)
    kappa = (f_hz - waveform.center_hz) / SPEED_OF_LIGHT_M_PER_S
    block_m = np.float32(2 * EDGE_PHASE_RAD / np.pi * SPEED_OF_LIGHT_M_PER_S / span_hz)
    per_half_block = np.float32(2.0 / np.float64(block_m))
    table = np.concatenate(
        [_coefficients(2 * np.pi * kappa / np.float64(per_half_block)), np.stack(hi_lo(kappa))]
    )
    return LengthBlocks(
        block_m=float(block_m),
        per_half_block=float(per_half_block),
        wavenumber=waveform.center_hz / SPEED_OF_LIGHT_M_PER_S,
        table=table.astype(np.float32),
        n_slots=min(MOST_SLOTS, 1 << (-(-len(f_hz) // 2) - 1).bit_length()),
        longest_m=MOST_CYCLES * SPEED_OF_LIGHT_M_PER_S / float(f_hz[-1]),
    )


def _coefficients(edge_phase_rad: np.ndarray) -> np.ndarray:
    """c, shape (MOMENTS, n), with exp(-j z x) = sum_p c_p (-j)^(p mod 2) x^p for |x| <= 1.

    The first terms of the Jacobi-Anger series, exp(-j z x) = J_0(z) + 2 sum_p (-j)^p J_p(z) T_p(x),
    written in powers of x.
    """
    order = np.arange(MOMENTS)[:, None]
    terms = np.where(order == 0, 1, 2) * (-1) ** (order // 2) * _bessel(edge_phase_rad)
    return _POWERS @ terms


def _bessel(z: np.ndarray) -> np.ndarray:
    """J_p(z) of the first orders, shape (MOMENTS, n), for |z| up to `EDGE_PHASE_RAD`.

    By its power series, which needs few terms there; ``scipy.special`` is slow to import.
    """
    squared = -((z / 2) ** 2)
    rows = []
    for p in range(MOMENTS):
        tail = np.ones_like(z)
        for k in range(SERIES_TERMS, 0, -1):
            tail = 1 + squared / (k * (k + p)) * tail
        rows.append((z / 2) ** p / factorial(p) * tail)
    return np.stack(rows)
