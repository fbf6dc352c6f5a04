"""Fast factorised back-projection: the tree of blocks, and its tolerance."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from images import QAR50, SWEEP, noise, rms_db, scatterers
from nightly import nightly

import clradar
from clradar import AntennaArray, Capture, VoxelGrid, Waveform, backproject, reference
from clradar.imaging import fast
from clradar.imaging.block_tree import block_sizes, image_levels, leaf_voxels

pytestmark = pytest.mark.usefixtures("always_a_tree")

HALF = AntennaArray(QAR50.tx_m[::2], QAR50.rx_m[::2])
# Float32 sums of 10^6 terms of random phase in blocks of a hundred, and phases of 1e-6 turns.
FLOAT32_DB = -95.0


extent = VoxelGrid.from_extent
PAPER_COARSE = extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 4e-3)


def flat(n: int) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, n), np.linspace(-0.05, 0.05, n))
    return np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)


def grid_corners(grid: VoxelGrid) -> np.ndarray:
    last = np.array(grid.counts) - 1
    return np.array(np.meshgrid(*zip((0, 0, 0), last, strict=True))).reshape(3, -1).T


@lru_cache(maxsize=2)
def exact_at_voxels(capture: Capture, grid: VoxelGrid) -> tuple[np.ndarray, np.ndarray]:
    """Random voxels and all corners, and the exact image there."""
    inside = np.random.default_rng(9).integers(0, grid.counts, (60, 3))
    at = np.concatenate([grid_corners(grid), inside])
    return at, reference.backproject(capture, grid.origin_m + grid.spacing_m * at)


def error_db(capture: Capture, grid: VoxelGrid, device: clradar.Device, **options: float) -> float:
    """RMS error at random voxels and all corners, relative to the RMS of the whole image."""
    volume = backproject(capture, grid, method="fast", device=device, **options)
    at, want = exact_at_voxels(capture, grid)
    return rms_db(volume.data[at[:, 2], at[:, 1], at[:, 0]] - want, volume.data)


# The tree -----------------------------------------------------------------------------------------


def test_blocks_halve_down_to_about_a_wavelength():
    grid = extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
    leaf = leaf_voxels(grid, 3.9e-3)
    assert leaf == (4, 4, 8)
    fine = VoxelGrid(np.zeros(3), np.full(3, 1e-5), (800, 800, 800))
    assert leaf_voxels(fine, 3.9e-3) == (64, 64, 64)  # no larger than that
    sizes = block_sizes(grid.counts, leaf)
    assert sizes[0] == (256, 256, 128)
    assert sizes[-1] == leaf
    for larger, smaller in pairwise(sizes):
        assert all(a in (b, 2 * b) for a, b in zip(larger, smaller, strict=True))


def test_fine_voxels_are_interpolated_for_images_alone():
    """From an eighth of the voxels; forward and adjoint, which are each other's, sum in all."""
    array, sweep = AntennaArray(QAR50.tx_m[::2], QAR50.rx_m[::2]), Waveform.sfcw(72e9, 82e9, 9)
    grid = extent((0.01, 0.015), (0.0, 0.005), (0.295, 0.3), 0.25e-3)
    levels, skeleton = image_levels(array, sweep, grid, 3e-3)
    assert skeleton is not None
    assert np.prod(skeleton.counts) < np.prod(levels[-1].voxels) / 8
    assert image_levels(array, sweep, PAPER_COARSE, 3e-3)[1] is None
    operator = clradar.ImagingOperator(array, sweep, grid)
    rng = np.random.default_rng(0)
    rho, samples = rng.normal(size=operator.domain_shape), rng.normal(size=operator.range_shape)
    one = np.vdot(samples, operator.forward(rho))
    assert abs(one - np.vdot(operator.adjoint(samples), rho)) < 1e-5 * abs(one)


# The error ----------------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def paper_capture(kind: str) -> Capture:
    return noise(HALF, SWEEP) if kind == "noise" else scatterers(HALF, SWEEP, PAPER_COARSE)


# Both kinds after each other: the second image has the tree of the first.
@pytest.mark.parametrize(
    ("kind", "tolerance_db"),
    [
        ("scatterers", -80.0),
        *nightly([("scatterers", db) for db in (-30.0, -50.0, -65.0)]),
        *nightly([("noise", db) for db in (-30.0, -50.0, -65.0, -80.0)]),
    ],
)
def test_the_error_keeps_the_tolerance(device, kind, tolerance_db):
    error = error_db(paper_capture(kind), PAPER_COARSE, device, tolerance_db=tolerance_db)
    assert FLOAT32_DB <= error <= tolerance_db


GRIDS = {
    "a few centimetres away": extent((-0.1, 0.1), (-0.1, 0.1), (0.03, 0.05), 4e-3),
    "through the antennas": extent((-0.08, 0.08), (-0.08, 0.08), (-0.024, 0.024), 4e-3),
    "wavelengths from voxel to voxel": extent((-8.0, 9.0), (2.0, 6.0), (1.0, 12.0), 1.0),
    "off axis": extent((0.3, 0.34), (-0.2, -0.16), (0.2, 0.24), 2e-3),
    "far away": extent((-0.3, 0.3), (-0.3, 0.3), (1.9, 2.1), 2e-2),
    "fine": extent((0.01, 0.02), (0.0, 0.01), (0.295, 0.305), 0.25e-3),
    "a slice": extent((-0.1, 0.1), (-0.1, 0.1), (0.3, 0.3), 2e-3),
    "a line": extent((-0.1, 0.1), (0.02, 0.02), (0.3, 0.3), 1e-3),
    "a voxel": extent((0.01, 0.01), (0.02, 0.02), (0.3, 0.3), 1e-3),
}


AT_NIGHT = ("a line", "off axis", "far away", "a slice")


@lru_cache(maxsize=1)
def half_capture() -> Capture:
    return noise(HALF, Waveform.sfcw(72e9, 82e9, 17))


@pytest.mark.parametrize(
    ("name", "tolerance_db"),
    [(name, -50.0) for name in GRIDS if name not in AT_NIGHT]
    + nightly([*((name, -50.0) for name in AT_NIGHT), ("far away", -80.0), ("fine", -80.0)]),
)
def test_any_grid(device, name, tolerance_db):
    assert error_db(half_capture(), GRIDS[name], device, tolerance_db=tolerance_db) <= tolerance_db


RNG = np.random.default_rng(5)
ARRAYS = {
    "in space": AntennaArray(RNG.uniform(-0.07, 0.07, (30, 3)), RNG.uniform(-0.07, 0.07, (20, 3))),
    "a plane": AntennaArray(flat(11), flat(4)),
    "the same antennas twice": AntennaArray(np.tile(QAR50.tx_m[:20], (2, 1)), QAR50.rx_m[:9]),
}


@pytest.mark.parametrize("name", ["in space", *nightly(["a plane", "the same antennas twice"])])
def test_any_array(device, name):
    waveform = Waveform(np.sort(np.random.default_rng(3).uniform(70e9, 84e9, 21)))
    grid = extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 8e-3)
    assert error_db(noise(ARRAYS[name], waveform), grid, device) <= -50.0


def test_pieces_of_a_large_grid_fit_together(device, monkeypatch):
    thin = extent((-0.1, 0.1), (-0.1, 0.1), (0.3, 0.304), 4e-3)
    monkeypatch.setattr(fast, "TILE_VOXELS", 51 * 40)
    assert len(fast.grid_pieces(thin)) == 4
    assert error_db(half_capture(), thin, device) <= -50.0
