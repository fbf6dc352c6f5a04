"""The imaging operator at points of a sphere against numpy."""

from __future__ import annotations

import numpy as np

import clradar
from core import peers
from core.timing import ARRAY, WAVEFORM, Row, interleaved_s, relative_rms_db


def forward(device: clradar.Device, repeats: int, n_points: int) -> Row:
    """Forward at points of a sphere against one matrix product per frequency; both anew."""
    out = np.random.default_rng(3).normal(size=(n_points, 3))
    points_m = 0.05 * out / np.linalg.norm(out, axis=1)[:, None] + np.array([0, 0, 0.3])
    rho = np.ones(n_points, np.complex64)

    def ours() -> np.ndarray:
        return clradar.forward(points_m, rho, ARRAY, WAVEFORM, device=device).data

    def theirs() -> np.ndarray:
        return peers.forward_by_gemm(points_m, rho, ARRAY, WAVEFORM)

    error = relative_rms_db(ours(), theirs())
    times_s = interleaved_s([ours, theirs], repeats)
    ours_s, theirs_s = np.median(times_s, axis=0)
    return Row(
        work=f"forward, {n_points} points of a sphere, nothing prepared",
        ours=f"{ours_s:.2f} s",
        peer=f"numpy, complex GEMM per frequency, {theirs_s:.1f} s",
        ratio=float(np.median(times_s[:, 1] / times_s[:, 0])),
        check=f"{error:.0f} dB between the two",
    )
