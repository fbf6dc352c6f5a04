"""Images by each method: range profiles and fast against numba, the exact sum against numpy."""

from __future__ import annotations

from functools import partial

import numpy as np

import clradar
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.imaging.block_tree import image_levels
from clradar.imaging.range_profiles import RangeImager
from core import peers
from core.timing import ARRAY, WAVEFORM, Row, interleaved_s, relative_rms_db

PAPER = {"x_m": (-0.1, 0.1), "y_m": (-0.1, 0.1), "z_m": (0.26, 0.34)}


def noise() -> clradar.Capture:
    """A capture of noise: all voxels of its images have the same expected power."""
    rng = np.random.default_rng(1)
    re, im = rng.normal(size=(2, ARRAY.n_tx, ARRAY.n_rx, WAVEFORM.n_freq)).astype(np.float32)
    return clradar.Capture(re + 1j * im, ARRAY, WAVEFORM)


class PaperVolume:
    """The paper's volume with some of its planes, of one capture, and the peer's profiles of it."""

    def __init__(self, device: clradar.Device, capture: clradar.Capture, planes: int) -> None:
        spacing = (1e-3, 1e-3, 0.08 / (planes - 1))
        self.device, self.capture = device, capture
        self.grid = clradar.VoxelGrid.from_extent(**PAPER, spacing_m=spacing)
        imager = RangeImager(capture, self.grid, np.ones(WAVEFORM.n_freq), device)
        first, stop = imager.bins(next(iter(imager.tiles())))
        self.bins_per_m = float(imager.bins_per_m)
        d_m = np.arange(first, stop) / self.bins_per_m
        self.first_m = float(d_m[0])
        f = WAVEFORM.frequencies_hz
        self.k = WAVEFORM.center_hz / SPEED_OF_LIGHT_M_PER_S
        kernel = np.exp(2j * np.pi * np.outer(f / SPEED_OF_LIGHT_M_PER_S - self.k, d_m)).astype(
            np.complex64
        )
        self.profiles = (capture.data.reshape(-1, len(f)) @ kernel / len(f)).reshape(94, 94, -1)

    @property
    def voxel_pairs(self) -> int:
        return int(np.prod(self.grid.shape)) * ARRAY.n_tx * ARRAY.n_rx

    def ours(self, method: str) -> np.ndarray:
        return clradar.backproject(
            self.capture, self.grid, method=method, check_grid=False, device=self.device
        ).data

    def theirs(self) -> np.ndarray:
        return peers.range_backprojection(
            self.profiles, self.first_m, self.bins_per_m, self.k, ARRAY.tx_m, ARRAY.rx_m,
            self.grid.x_m, self.grid.y_m, self.grid.z_m,
        )  # fmt: skip


def images(
    device: clradar.Device, repeats: int, capture: clradar.Capture, planes: int
) -> list[Row]:
    """By range and by fast, against the same peer.

    The first image by fast chooses antennas and frequencies, the next has them already.
    """
    image = PaperVolume(device, capture, planes)
    ours, fast = partial(image.ours, "range"), partial(image.ours, "fast")

    def fast_anew() -> np.ndarray:
        image_levels.cache_clear()
        return fast()

    by_range = ours()
    error = relative_rms_db(image.theirs(), by_range)
    fast_error = relative_rms_db(fast(), by_range)
    times_s = interleaved_s([ours, fast_anew, fast, image.theirs], repeats)
    ours_s, fast_s, again_s, theirs_s = np.median(times_s, axis=0)
    ratio, fast_ratio, again_ratio = np.median(times_s[:, 3:] / times_s[:, :3], axis=0)
    work = image.voxel_pairs
    peer = f"numba, two threads, blocked, {work / theirs_s / 1e6:.0f} M/s (profiles given)"
    return [
        Row(
            work=f"image by range, 201 x 201 x {planes}",
            ours=f"{ours_s:.1f} s, {work / ours_s / 1e6:.0f} M voxel pairs/s",
            peer=peer,
            ratio=float(ratio),
            check=f"{error:.0f} dB between the two",
        ),
        Row(
            work=f"image by fast, 201 x 201 x {planes}, -50 dB requested",
            ours=f"{fast_s:.2f} s, and {again_s:.2f} s for the next of the same array and grid",
            peer=peer,
            ratio=float(fast_ratio),
            check=f"{again_ratio:.1f} x for the next; {fast_error:.0f} dB to the image by range",
        ),
    ]


class ExactImage:
    """A plane of voxels by the sum as it stands, and the peer's."""

    def __init__(self, device: clradar.Device, capture: clradar.Capture) -> None:
        self.device, self.capture = device, capture
        self.grid = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.05, 0.05), (0.3, 0.3), 2e-3)
        z, y, x = np.meshgrid(self.grid.z_m, self.grid.y_m, self.grid.x_m, indexing="ij")
        self.points_m = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)

    @property
    def terms(self) -> int:
        return len(self.points_m) * self.capture.data.size

    def ours(self) -> np.ndarray:
        return clradar.backproject(
            self.capture, self.grid, method="exact", check_grid=False, device=self.device
        ).data.ravel()

    def theirs(self) -> np.ndarray:
        return peers.exact_by_gemm(self.capture, self.points_m)


def exact_image(device: clradar.Device, repeats: int, capture: clradar.Capture) -> Row:
    image = ExactImage(device, capture)
    error = relative_rms_db(image.ours(), image.theirs())
    times_s = interleaved_s([image.ours, image.theirs], repeats)
    ours_s, theirs_s = np.median(times_s, axis=0)
    return Row(
        work=f"exact sum, {image.terms / 1e9:.1f} G terms",
        ours=f"{image.terms / ours_s / 1e9:.1f} G terms/s",
        peer=f"numpy, complex GEMM per frequency, {image.terms / theirs_s / 1e9:.1f} G/s",
        ratio=float(np.median(times_s[:, 1] / times_s[:, 0])),
        check=f"{error:.0f} dB between the two",
    )
