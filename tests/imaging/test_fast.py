"""Images, forward sums and adjoints over the tree of blocks: tolerance, and adjointness."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from images import QAR50, SWEEP, centres_m, noise, phasors, rms_db, scatterers
from nightly import nightly
from scipy.sparse.linalg import lsqr

import clradar
from clradar import (
    AntennaArray,
    Capture,
    ImagingOperator,
    VoxelGrid,
    Waveform,
    backproject,
    reference,
)
from clradar.errors import ModelError
from clradar.imaging import fast
from clradar.imaging.block_tree import block_sizes, leaf_voxels

pytestmark = pytest.mark.usefixtures("always_a_tree")

HALF = AntennaArray(QAR50.tx_m[::2], QAR50.rx_m[::2])
# Float32 sums of 10^6 terms of random phase in blocks of a hundred, and phases of 1e-6 turns.
FLOAT32_DB = -95.0


extent = VoxelGrid.from_extent
PAPER_COARSE = extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 4e-3)


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
    """Forward and adjoint, which are each other's, sum in all."""
    grid = extent((0.01, 0.015), (0.0, 0.005), (0.295, 0.3), 0.25e-3)
    operator = ImagingOperator(HALF, Waveform.sfcw(72e9, 82e9, 9), grid)
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
    "a voxel": extent((0.01, 0.01), (0.02, 0.02), (0.3, 0.3), 1e-3),
}


AT_NIGHT = ("off axis", "far away", "a slice")


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
    "the same antennas twice": AntennaArray(np.tile(QAR50.tx_m[:20], (2, 1)), QAR50.rx_m[:9]),
}


@pytest.mark.parametrize("name", ["in space", *nightly(["the same antennas twice"])])
def test_any_array(device, name):
    waveform = Waveform(np.sort(np.random.default_rng(3).uniform(70e9, 84e9, 21)))
    grid = extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 8e-3)
    assert error_db(noise(ARRAYS[name], waveform), grid, device) <= -50.0


# Float32 phasors and sums, a few hundred terms in a row: some 1e-7 each.
SUMMED_DB = -120.0

SMALL = AntennaArray(QAR50.tx_m[::11], QAR50.rx_m[::9])  # 9 x 11: odd against blocks and lanes
DRAWN = np.random.default_rng(7)
UNEVEN = Waveform(np.sort(DRAWN.uniform(70e9, 84e9, 11)))
GRID = VoxelGrid.from_extent((-0.02, 0.02), (-0.03, 0.03), (0.2, 0.21), 5e-3)


def complex_noise(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    re, im = np.random.default_rng(seed).normal(size=(2, *shape)).astype(np.float32)
    return re + 1j * im


def forward_sum(
    points_m: np.ndarray, rho: np.ndarray, array: AntennaArray, waveform: Waveform
) -> np.ndarray:
    tx, rx = phasors(points_m, array, waveform)
    return np.einsum("p,npt,npr->trn", rho.astype(complex), tx, rx, optimize=True)


def adjoint_sum(
    points_m: np.ndarray, samples: np.ndarray, array: AntennaArray, waveform: Waveform
) -> np.ndarray:
    tx, rx = phasors(points_m, array, waveform)
    return np.einsum("npt,trn,npr->p", tx.conj(), samples.astype(complex), rx.conj(), optimize=True)


def sphere(n: int, radius_m: float = 0.05) -> np.ndarray:
    out = np.random.default_rng(n).normal(size=(n, 3))
    return radius_m * out / np.linalg.norm(out, axis=1)[:, None] + np.array([0.02, 0, 0.3])


@pytest.fixture
def summed_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums over few points."""
    monkeypatch.setattr(fast, "FEW_TERMS", 10**6)


# Term by term -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("array", "n"), [(SMALL, 7), (SMALL, 300), (AntennaArray([[0, 0, 0]], [[0.01, 0, 0]]), 1)]
)
def test_both_ways_are_the_sum(device, summed_directly, array, n):
    points_m = np.random.default_rng(n).uniform((-0.1, -0.1, -0.1), (0.1, 0.1, 0.4), (n, 3))
    points_m[0] = array.tx_m[0]
    operator = ImagingOperator(array, UNEVEN, points_m, device=device)
    rho, samples = complex_noise((n,)), complex_noise(operator.range_shape)
    want = forward_sum(points_m, rho, array, UNEVEN)
    assert rms_db(operator.forward(rho) - want, want) <= SUMMED_DB
    want = adjoint_sum(points_m, samples, array, UNEVEN)
    assert rms_db(operator.adjoint(samples) - want, want) <= SUMMED_DB


@pytest.mark.usefixtures("summed_directly")
@pytest.mark.parametrize(("n", "share", "error_db"), [(40, 0.3, SUMMED_DB), (1500, 0.01, -50.0)])
def test_a_pair_has_no_echo_of_points_that_it_does_not_see(
    device, summed_directly, n, share, error_db
):
    """Of few points all are summed directly; of many, those that all antennas see by a tree."""
    rng = np.random.default_rng(3)
    points_m = sphere(n)
    tx_visible, rx_visible = (rng.random((n, m)) > share for m in (SMALL.n_tx, SMALL.n_rx))
    seen = {"tx_visible": tx_visible, "rx_visible": rx_visible}
    operator = ImagingOperator(SMALL, UNEVEN, points_m, **seen, device=device)
    tx, rx = phasors(points_m, SMALL, UNEVEN)
    tx, rx = tx * tx_visible, rx * rx_visible
    rho, samples = complex_noise((n,)), complex_noise(operator.range_shape)
    want = np.einsum("p,npt,npr->trn", rho, tx, rx, optimize=True)
    assert rms_db(operator.forward(rho) - want, want) <= error_db
    want = np.einsum("npt,trn,npr->p", tx.conj(), samples, rx.conj(), optimize=True)
    assert rms_db(operator.adjoint(samples) - want, want) <= error_db


# The tree -----------------------------------------------------------------------------------------

SWEEP_17 = Waveform.sfcw(72e9, 82e9, 17)


POINTS_M = {
    "a sphere": sphere(3000),
    "one": np.array([[0.01, 0.02, 0.3]]),
    "a thousand in one place and one far away": np.append(
        np.tile([[0.01, 0.02, 0.3]], (1500, 1)), [[0.0, 0.0, 10.0]], axis=0
    ),
    "at the antennas": np.concatenate([HALF.tx_m, HALF.rx_m]),
    "before, behind and among the antennas": np.random.default_rng(2).uniform(-0.2, 0.2, (900, 3)),
    "metres apart": np.random.default_rng(4).uniform((-6, -6, 1), (6, 6, 12), (300, 3)),
    "on the borders of blocks": np.stack(
        np.meshgrid(*[np.linspace(-0.03, 0.03, 9)] * 3), axis=-1
    ).reshape(-1, 3) + np.array([0, 0, 0.2]),
}  # fmt: skip


POINTS_AT_NIGHT = ("before, behind and among the antennas", "one", "metres apart")


@pytest.mark.parametrize("tolerance_db", [-70.0, *nightly([-40.0])])
@pytest.mark.parametrize(
    "name", [*(name for name in POINTS_M if name not in POINTS_AT_NIGHT), *nightly(POINTS_AT_NIGHT)]
)
def test_points_anywhere_keep_the_tolerance(device, name, tolerance_db):
    """All points together, and the outermost one alone."""
    points_m = POINTS_M[name]
    operator = ImagingOperator(HALF, SWEEP_17, points_m, tolerance_db=tolerance_db, device=device)
    rho, samples = complex_noise((len(points_m),)), complex_noise(operator.range_shape)
    pairs = AntennaArray(HALF.tx_m[::5], HALF.rx_m[::7])
    alone = np.zeros_like(rho)
    alone[points_m[:, 0].argmax()] = 1.0
    for values in (rho, alone):
        want = forward_sum(points_m, values, pairs, SWEEP_17)
        error = operator.forward(values)[::5, ::7] - want
        assert rms_db(error, want) <= tolerance_db
    some = np.unique(np.linspace(0, len(points_m) - 1, 100).astype(int))
    want = adjoint_sum(points_m[some], samples, HALF, SWEEP_17)
    assert rms_db(operator.adjoint(samples)[some] - want, want) <= tolerance_db


# Both sides are float32 sums of the same products in another order: some 1e6 products of random
# sign, so 2^-24 of their norm, and phasors that differ by as much.
DOT_TOLERANCE = 1e-6


@pytest.mark.parametrize("where", ["a sphere", "at the antennas", "grid"])
def test_dot(device, where):
    """The pair is adjoint far below the tolerance of -30 dB."""
    at = GRID if where == "grid" else POINTS_M[where]
    operator = ImagingOperator(HALF, SWEEP_17, at, tolerance_db=-30, device=device)
    rho, samples = complex_noise(operator.domain_shape), complex_noise(operator.range_shape)
    captured, image = operator.forward(rho), operator.adjoint(samples)
    one = np.vdot(samples, captured.astype(complex))
    other = np.vdot(image, rho.astype(complex))
    assert abs(one - other) <= DOT_TOLERANCE * np.linalg.norm(samples) * np.linalg.norm(captured)


def test_the_adjoint_of_a_grid_is_the_fast_image(device):
    grid = VoxelGrid.from_extent((-0.05, 0.05), (-0.04, 0.04), (0.2, 0.21), 2e-3)
    capture = clradar.Capture(complex_noise((HALF.n_tx, HALF.n_rx, 17)), HALF, SWEEP_17)
    image = clradar.backproject(capture, grid, check_grid=False, device=device).data
    adjoint = ImagingOperator(HALF, SWEEP_17, grid, device=device).adjoint(capture)
    np.testing.assert_array_equal((adjoint.view(np.float32) / capture.data.size), image.view("f4"))


def test_pieces_and_parts_make_up_the_whole(device, monkeypatch):
    """Five pieces of the points, nine of the grid along y and z, and four parts of the array."""
    monkeypatch.setattr(fast, "TILE_VOXELS", 60)
    monkeypatch.setattr(fast, "MAX_ANTENNAS", 6)
    some_m = POINTS_M["a sphere"][:300]
    assert (len(fast.grid_pieces(GRID)), len(fast.point_pieces(some_m))) == (9, 5)
    for where, points_m in ((GRID, centres_m(GRID)), (some_m, some_m)):
        operator = ImagingOperator(SMALL, UNEVEN, where, device=device)
        rho, samples = complex_noise(operator.domain_shape), complex_noise(operator.range_shape)
        want = forward_sum(points_m, rho.ravel(), SMALL, UNEVEN)
        assert rms_db(operator.forward(rho) - want, want) <= -50.0
        want = adjoint_sum(points_m[::7], samples, SMALL, UNEVEN)
        assert rms_db(operator.adjoint(samples).ravel()[::7] - want, want) <= -50.0


# Records and vectors ------------------------------------------------------------------------------


def test_forward_gives_a_capture(device, summed_directly):
    points_m = DRAWN.uniform((-0.1, -0.1, 0.2), (0.1, 0.1, 0.4), (20, 3))
    steps: list[tuple[int, int]] = []
    capture = clradar.forward(
        points_m, np.arange(20), SMALL, UNEVEN, tolerance_db=-60, device=device,
        progress=lambda *step: steps.append(step),
    )  # fmt: skip
    want = forward_sum(points_m, np.arange(20), SMALL, UNEVEN)
    assert rms_db(capture.data - want, want) <= SUMMED_DB
    assert capture.meta["tolerance_db"] == -60
    assert steps[-1][0] == steps[-1][1]


def test_scipy_takes_the_pair(device, summed_directly):
    """Least squares finds the reflectivity again: 7 points that are told apart."""
    points_m = DRAWN.uniform((-0.1, -0.1, 0.2), (0.1, 0.1, 0.4), (7, 3))
    operator = ImagingOperator(SMALL, UNEVEN, points_m, device=device)
    linear = operator.as_linear_operator()
    assert linear.shape == operator.shape == (9 * 11 * 11, 7)
    assert linear.dtype == np.complex64
    rho = complex_noise((7,))
    samples = operator.forward(rho)
    np.testing.assert_array_equal(linear @ rho, samples.ravel())
    np.testing.assert_array_equal(linear.H @ samples.ravel(), operator.adjoint(samples))
    found = lsqr(linear, samples.ravel(), atol=1e-7, btol=1e-7)[0]
    np.testing.assert_allclose(found, rho, atol=1e-4)


# Wrong arguments ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("where", "options", "message"),
    [
        (np.zeros((0, 3)), {}, "grid_or_points: expected at least one element"),
        (np.zeros((4, 2)), {}, r"grid_or_points: expected shape \(N, 3\), got shape \(4, 2\)"),
        ([[0, 0, 300.0]], {}, "ImagingOperator: expected a distance of the farthest point"),
        ([[0, 0, 0.3]], {"tx_visible": np.ones((1, 3))}, r"tx_visible: expected shape \(1, 9\)"),
        ([[0, 0, 0.3]], {"rx_visible": 2 * np.ones((1, 11))}, "expected True and False"),
        (GRID, {"tx_visible": np.ones((1, 9))}, "visibility: expected points"),
    ],
)
def test_wrong_points_are_refused(where, options, message):
    with pytest.raises(ModelError, match=message):
        ImagingOperator(SMALL, UNEVEN, where, **options)


def test_wrong_values_are_refused(device):
    operator = ImagingOperator(SMALL, UNEVEN, GRID, device=device)
    other = VoxelGrid.from_extent((0, 0.02), (0, 0.02), (0.2, 0.21), 5e-3)
    volume = clradar.Volume(np.ones(other.shape), other)
    capture = clradar.Capture(np.ones((9, 11, 3)), SMALL, Waveform([1e10, 2e10, 3e10]))
    huge = np.full(GRID.shape, 3e38)
    for call, given, message in (
        (operator.forward, np.ones(5), "forward: reflectivity: expected shape"),
        (operator.forward, volume, "expected a volume on the operator's grid"),
        (operator.forward, huge, "whose sum complex64 holds, got an overflow"),
        (operator.adjoint, np.ones((9, 11)), "adjoint: samples: expected shape"),
        (operator.adjoint, capture, "expected a capture by the operator's array and waveform"),
    ):
        with pytest.raises(ModelError, match=message):
            call(given)
    own = clradar.Volume(complex_noise(GRID.shape), GRID)
    np.testing.assert_array_equal(operator.forward(own), operator.forward(own.data))
