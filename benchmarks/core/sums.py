"""What a simulation sums: phasors of paths, points of a surface, a physical scene."""

from __future__ import annotations

from functools import partial

import numpy as np

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.hand import hand_mesh
from clradar.tracing.quadrature import LitQuadrature
from clradar.tracing.settings import resolve_settings
from core import peers
from core.work import ARRAY, WAVEFORM, Work, forward_by_gemm, relative_rms_db

K_PER_M = WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
PART_POINTS = 4096
"""Points of a product of the dense sum: 12 MB, which is a third faster than all at a time."""
DENSE_FREQUENCIES = 2  # of the waveform's, at which the dense sum is timed


def phasor_sum(device: clradar.Device, n_paths: int) -> Work:
    """Paths spread evenly over all pairs; finufft is given points and strengths."""
    rng = np.random.default_rng(0)
    pair = np.sort(rng.integers(0, ARRAY.n_tx * ARRAY.n_rx, n_paths))
    length_m = rng.uniform(0.5, 0.8, n_paths)
    paths = clradar.Paths(
        pair // ARRAY.n_rx, pair % ARRAY.n_rx, length_m, np.ones(n_paths), np.ones(n_paths),
        ARRAY.n_tx, ARRAY.n_rx,
    )  # fmt: skip
    start = np.searchsorted(pair, np.arange(ARRAY.n_tx * ARRAY.n_rx + 1))
    peer = peers.finufft_phasor_sum(start, K_PER_M, 1e-5, paths.length_m, paths.amplitude)

    def ours() -> np.ndarray:
        made = clradar.synthesize(paths, ARRAY, WAVEFORM, device=device).data
        return made.reshape(-1, WAVEFORM.n_freq)

    def error_db(data: np.ndarray) -> float:
        some = range(0, len(start) - 1, 400)
        rows = (paths.length_m[start[i] : start[i + 1]] for i in some)
        want = [np.exp(-2j * np.pi * np.outer(d, K_PER_M)).sum(axis=0) for d in rows]
        return relative_rms_db(data[some], np.array(want))

    return Work(
        f"phasor sum, {n_paths / 1e6:g} M paths, {len(start) - 1} pairs x {WAVEFORM.n_freq}",
        {"": ours},
        {
            "finufft type 1, 1e-5, points and strengths given": peer,
            "in two threads": partial(peer, 2),
        },
        f"against float64 {error_db(ours()):.0f} dB, finufft {error_db(peer()):.0f} dB",
    )


def forward(device: clradar.Device, n_points: int) -> Work:
    """Points of a sphere, with nothing prepared."""
    out = np.random.default_rng(3).normal(size=(n_points, 3))
    points_m = 0.05 * out / np.linalg.norm(out, axis=1)[:, None] + np.array([0, 0, 0.3])
    rho = np.ones(n_points, np.complex64)

    def ours() -> np.ndarray:
        return clradar.forward(points_m, rho, ARRAY, WAVEFORM, device=device).data

    theirs = partial(forward_by_gemm, points_m, rho, ARRAY, WAVEFORM, np.complex64)
    return Work(
        f"forward, {n_points} points of a sphere", {"": ours},
        peers.by_numpy("complex GEMM per frequency", theirs),
        f"{relative_rms_db(ours(), theirs()):.0f} dB between the two",
    )  # fmt: skip


def physical(device: clradar.Device, samples_per_mm2: float) -> Work:
    """The whole simulation of a hand of metal, against the dense sum over the points it sees.

    The peer is given lengths, angles and what is visible, and leaves out the phase over a triangle.
    """
    scene = clradar.Scene.from_mesh(hand_mesh("F"))
    settings = resolve_settings(estimator="physical", samples_per_mm2=samples_per_mm2)
    with LitQuadrature(scene, ARRAY, settings, device) as quadrature:
        lit = quadrature.lit_points()
        position_m = lit.position_m.astype(np.float64) + quadrature.middle_m
    sides = []
    for at_m, bits in ((ARRAY.tx_m, lit.tx), (ARRAY.rx_m, lit.rx)):
        seen = np.unpackbits(bits, axis=1, bitorder="little")[:, : len(at_m)]
        to = at_m - position_m[:, None]
        length = np.linalg.norm(to, axis=2)
        field = seen / length
        along = np.einsum("pxa,pa->px", to, lit.area_m2) / length
        sides.append((length, np.stack([along * field, field]).astype(np.float32)))
    chosen = np.linspace(0, WAVEFORM.n_freq - 1, DENSE_FREQUENCIES).astype(int)

    def waves(side: tuple[np.ndarray, np.ndarray], f: int, part: slice) -> np.ndarray:
        length, field = (column[..., part, :] for column in side)
        cycles = length * K_PER_M[f]
        angle = (2 * np.pi * (cycles - np.round(cycles))).astype(np.float32)
        wave = np.empty(angle.shape, np.complex64)
        wave.real, wave.imag = np.cos(angle), -np.sin(angle)
        return np.asarray(field * wave)

    def dense() -> np.ndarray:
        out = np.zeros((ARRAY.n_tx, ARRAY.n_rx, len(chosen)), np.complex64)
        for i, f in enumerate(chosen):
            for start in range(0, len(position_m), PART_POINTS):
                tx, rx = (waves(side, f, slice(start, start + PART_POINTS)) for side in sides)
                out[:, :, i] += tx.reshape(-1, ARRAY.n_tx).T @ rx[::-1].reshape(-1, ARRAY.n_rx)
        return out * np.complex64(-1j / (8 * np.pi))

    def ours() -> np.ndarray:
        return clradar.simulate(scene, ARRAY, WAVEFORM, settings=settings, device=device).data

    return Work(
        f"physical simulation of a hand, {len(position_m)} lit points", {"": ours},
        peers.by_numpy(f"sum alone, {len(chosen)} of {WAVEFORM.n_freq} frequencies timed", dense),
        f"{relative_rms_db(ours()[:, :, chosen], dense()):.0f} dB between the two",
        peer_share=len(chosen) / WAVEFORM.n_freq,
    )  # fmt: skip
