"""The imaging operator: over the paper's volume against the image, at points against numpy."""

from __future__ import annotations

import numpy as np

import clradar
from core import peers
from core.images import PAPER, noise
from core.timing import ARRAY, WAVEFORM, Row, interleaved_s, relative_rms_db


def operators(device: clradar.Device, repeats: int, planes: int, n_points: int) -> list[Row]:
    """Forward of all voxels, as a grid and as points, against the fast image; all prepared."""
    spacing = (1e-3, 1e-3, 0.08 / (planes - 1))
    grid = clradar.VoxelGrid.from_extent(**PAPER, spacing_m=spacing)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    voxels_m = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    capture = noise()
    re, im = np.random.default_rng(2).normal(size=(2, len(voxels_m))).astype(np.float32)
    rho = re + 1j * im
    on_grid = clradar.ImagingOperator(ARRAY, WAVEFORM, grid, device=device)
    at_points = clradar.ImagingOperator(ARRAY, WAVEFORM, voxels_m, device=device)
    volume = rho.reshape(grid.shape)
    difference = relative_rms_db(at_points.forward(rho), on_grid.forward(volume))
    times_s = interleaved_s(
        [
            lambda: on_grid.forward(volume),
            lambda: at_points.forward(rho),
            lambda: clradar.backproject(capture, grid, check_grid=False, device=device),
        ],
        repeats,
    )
    grid_s, points_s, image_s = np.median(times_s, axis=0)
    ratios = np.median(times_s[:, 2:] / times_s[:, :2], axis=0)
    peer = f"image by fast of the same grid, {image_s:.2f} s"
    check = f"{difference:.0f} dB between the two"
    return [
        Row(f"forward, 201 x 201 x {planes}, -50 dB requested", f"{grid_s:.2f} s", peer,
            float(ratios[0]), check),
        Row(f"the same as {len(voxels_m)} points", f"{points_s:.2f} s", peer, float(ratios[1]),
            check),
        _dense(device, repeats, n_points),
    ]  # fmt: skip


def _dense(device: clradar.Device, repeats: int, n_points: int) -> Row:
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
