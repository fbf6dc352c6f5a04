"""Images of noise, whose voxels all have the same expected power."""

from __future__ import annotations

from functools import partial

import numpy as np

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.block_tree import image_levels
from clradar.imaging.range_profiles import RangeImager
from core import peers
from core.work import ARRAY, WAVEFORM, Work, exact_by_gemm, relative_rms_db


def noise() -> clradar.Capture:
    rng = np.random.default_rng(1)
    re, im = rng.normal(size=(2, ARRAY.n_tx, ARRAY.n_rx, WAVEFORM.n_freq)).astype(np.float32)
    return clradar.Capture(re + 1j * im, ARRAY, WAVEFORM)


def paper_volume(device: clradar.Device, planes: int) -> Work:
    """Some planes of the paper's volume, by range and by fast; the peer is given the profiles."""
    capture = noise()
    spacing_m = (1e-3, 1e-3, 0.08 / (planes - 1))
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), spacing_m)
    imager = RangeImager(capture, grid, np.ones(WAVEFORM.n_freq), device)
    bins_per_m = float(imager.bins_per_m)
    d_m = np.arange(*imager.bins(next(iter(imager.tiles())))) / bins_per_m
    k_per_m = WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    middle_per_m = WAVEFORM.center_hz / SPEED_OF_LIGHT_M_PER_S
    kernel = np.exp(2j * np.pi * np.outer(k_per_m - middle_per_m, d_m)).astype(np.complex64)
    profiles = (capture.data.reshape(-1, len(k_per_m)) @ kernel / len(k_per_m)).reshape(94, 94, -1)

    def ours(method: str) -> np.ndarray:
        return clradar.backproject(
            capture, grid, method=method, check_grid=False, device=device
        ).data

    def fast_anew() -> np.ndarray:
        image_levels.cache_clear()
        return ours("fast")

    theirs = partial(
        peers.range_backprojection, profiles, float(d_m[0]), bins_per_m, middle_per_m,
        ARRAY.tx_m, ARRAY.rx_m, grid.x_m, grid.y_m, grid.z_m,
    )  # fmt: skip
    by_range = ours("range")
    error_db, fast_db = relative_rms_db(theirs(), by_range), relative_rms_db(ours("fast"), by_range)
    fast_text = f"{fast_db:.0f} dB to the image by range"
    return Work(
        f"image, 201 x 201 x {planes}, by ",
        {
            "range": partial(ours, "range"),
            "fast, -50 dB requested": fast_anew,
            "fast, the next of the same array and grid": partial(ours, "fast"),
        },
        {"numba, all cores, blocked, profiles given": theirs},
        [f"{error_db:.0f} dB between the two", fast_text, fast_text],
        capture.data[..., 0].size * float(np.prod(grid.shape)) / 1e6, "M voxel pairs/s",
    )  # fmt: skip


def exact_image(device: clradar.Device) -> Work:
    """A plane of voxels by the sum as it stands."""
    capture = noise()
    grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.05, 0.05), (0.3, 0.3), 2e-3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    points_m = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)

    def ours() -> np.ndarray:
        return clradar.backproject(
            capture, grid, method="exact", check_grid=False, device=device
        ).data.ravel()

    theirs = partial(exact_by_gemm, capture, points_m, np.complex64)
    terms = len(points_m) * capture.data.size / 1e9
    return Work(
        f"exact sum, {terms:.1f} G terms", {"": ours},
        peers.by_numpy("complex GEMM per frequency", theirs),
        f"{relative_rms_db(ours(), theirs()):.0f} dB between the two", terms, "G terms/s",
    )  # fmt: skip
