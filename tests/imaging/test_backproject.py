"""Images against the float64 sum and the closed form of a point; frame after frame the same."""

from functools import cache, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh
from images import QAR50, SWEEP, centres_m, noise, phasors, rms_db, scatterers
from nightly import nightly
from scipy.signal import windows

import clradar
from clradar import AntennaArray, Capture, FrameImager, VoxelGrid, Waveform, backproject, reference
from clradar.backproject import METHODS
from clradar.errors import ModelError
from clradar.imaging import fast
from clradar.imaging.exact import TX_CHUNK
from clradar.imaging.tiled import RX_CHUNK

# Every term errs by some 5e-7 (phase 4e-7 rad per antenna, sine 1.1e-7, three float32 products),
# and a float32 sum of a hundred terms by 1e-6 at most. Errors and terms both add up at random, so
# the ratio stays: -116 dB. Documented are -80 dB, but a phase from plain float32 lengths (5e-5 rad,
# -86 dB) would keep that, and must not pass.
EXACT_DB = -110.0
# Linear interpolation at 16 bins per resolution cell errs by 1.6e-3 RMS (-56 dB) over a flat band,
# and by 3.5e-3 (-49 dB) where all power is at the band's edges. The promise is -45 dB.
RANGE_DB = -45.0
# The default tolerance.
FAST_DB = -50.0
TOLERANCE_DB = {"exact": EXACT_DB, "range": RANGE_DB, "fast": FAST_DB}


SHORT = Waveform.sfcw(72e9, 82e9, 11)


pytestmark = pytest.mark.usefixtures("always_a_tree")


def random_array(n_tx: int, n_rx: int, seed: int = 0) -> AntennaArray:
    rng = np.random.default_rng(seed)
    tx, rx = (rng.uniform(-0.07, 0.07, (n, 3)) * [1, 1, 0.1] for n in (n_tx, n_rx))
    return AntennaArray(tx, rx)


@lru_cache(maxsize=1)
def direct_sum(capture: Capture, grid: VoxelGrid) -> tuple[np.ndarray, np.ndarray]:
    """Up to 20 random voxels of a grid, and the image there."""
    voxels = centres_m(grid)
    pick = np.random.default_rng(9).permutation(len(voxels))[:20]
    return pick, reference.backproject(capture, voxels[pick])


def error_db(
    capture: Capture, grid: VoxelGrid, device: clradar.Device, method: str, **options: Any
) -> float:
    """Error at random voxels against the direct sum, RMS over RMS."""
    volume = backproject(capture, grid, method=method, device=device, **options)
    assert volume.data.shape == grid.shape
    pick, want = direct_sum(capture, grid)
    return rms_db(volume.data.ravel()[pick] - want, want)


GRID = VoxelGrid.from_extent((-0.02, 0.03), (-0.04, 0.02), (0.28, 0.32), (5e-3, 1e-2, 2e-2))


# Against float64 ----------------------------------------------------------------------------------


HAND_SIZED = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 2e-2)


@cache
def of_the_imager(kind: str) -> Capture:
    return noise(QAR50, SWEEP) if kind == "noise" else scatterers(QAR50, SWEEP, HAND_SIZED, 20)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["noise", *nightly(["scatterers"])])
def test_the_imager_at_random_voxels(device, method, kind):
    error = error_db(of_the_imager(kind), HAND_SIZED, device, method)
    assert error <= TOLERANCE_DB[method]


SIX = random_array(6, 5)
BESIDE = np.array([-0.01, 0.02, 0.29]), np.array([2e-3, 3e-3, 1e-2])
GRIDS = {
    "one voxel": VoxelGrid.from_extent((0.01, 0.01), (0.02, 0.02), (0.3, 0.3), 1e-3),
    "a line along z": VoxelGrid.from_extent((0.0, 0.0), (0.0, 0.0), (0.2, 0.4), 5e-3),
    "on an antenna": VoxelGrid(SIX.tx_m[0], np.full(3, 5e-3), (2, 1, 1)),
    "behind the array": VoxelGrid.from_extent((-0.02, 0.02), (0.0, 0.01), (-0.3, -0.28), 1e-2),
    "across the array": VoxelGrid.from_extent((-0.08, 0.08), (0.0, 0.01), (-0.02, 0.02), 1e-2),
    "far away": VoxelGrid.from_extent((-1.0, 1.0), (0.0, 0.1), (20.0, 20.1), 0.1),
    "fine": VoxelGrid.from_extent((0.0, 1e-4), (0.0, 1e-5), (0.3, 0.30001), 1e-5),
}


WAVEFORMS = {
    "one": Waveform([77e9]),
    "two beside each other": Waveform([77e9, 77.001e9]),
    "unequal": Waveform(72e9 + 10e9 * np.sort(np.random.default_rng(3).uniform(0, 1, 37))),
    "a gap": Waveform(np.r_[np.linspace(60e9, 64e9, 9), np.linspace(76e9, 81e9, 8)]),
    "an ultra-wide band": Waveform(np.linspace(1e9, 82e9, 163)),
}


CHUNKS = {f"{n_tx} x {n_rx}": (n_tx, n_rx) for n_tx, n_rx in ((7, RX_CHUNK), (5, 2 * RX_CHUNK + 1))}
CASES: dict[str, tuple[AntennaArray, Waveform, VoxelGrid]] = {
    # Beside the width of a vector.
    **{f"{n} along x": (SIX, SHORT, VoxelGrid(*BESIDE, (n, 3, 2))) for n in (1, 7, 9)},
    **{name: (SIX, SHORT, grid) for name, grid in GRIDS.items()},
    **{f"{t} x {r}": (random_array(t, r), SHORT, GRID) for t, r in ((1, 1), (1, 5), (5, 1))},
    **{name: (random_array(*size), SHORT, GRID) for name, size in CHUNKS.items()},
    "one more Tx than a call takes": (random_array(TX_CHUNK + 1, 5), SHORT, GRID),
    **{name: (SIX, waveform, GRID) for name, waveform in WAVEFORMS.items()},
}
NOT_FAST = {*GRIDS, *CHUNKS, "one more Tx than a call takes"}
"""For these see test_fast.py."""


@pytest.mark.parametrize(
    ("name", "method"),
    [(name, m) for name in CASES for m in METHODS if m != "fast" or name not in NOT_FAST],
)
def test_any_array_frequencies_and_grid(device, name, method):
    array, waveform, grid = CASES[name]
    assert error_db(noise(array, waveform), grid, device, method) <= TOLERANCE_DB[method]


# Windows ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_windows_weigh_the_frequencies(device, method):
    capture, weights = noise(SIX, SHORT), windows.taylor(11, nbar=4, sll=30)
    image = backproject(capture, GRID, method=method, device=device, window="taylor").data.ravel()
    want = reference.backproject(capture, centres_m(GRID), weights)
    assert rms_db(image - want, want) <= TOLERANCE_DB[method]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "quick"}, "method: expected one of 'exact', 'range', 'fast', got 'quick'"),
        ({"window": "hamming"}, "window: expected one of 'rect', 'hann', 'taylor', got 'hamming'"),
        ({"window": np.ones(12)}, r"window: expected shape \(11,\), got shape \(12,\)"),
        ({"window": np.full(11, np.nan)}, "window: expected finite numbers"),
        ({"tolerance_db": -20}, "tolerance_db: expected -80 to -30 dB, got -20"),
        ({"tolerance_db": -50, "method": "exact"}, "tolerance_db: expected none for a method"),
    ],
)
def test_refused(device, options, message):
    with pytest.raises(ModelError, match=message):
        backproject(noise(SIX, SHORT), GRID, device=device, **options)


# Invariants ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_progress_runs_from_nothing_to_all(device, method):
    seen: list[tuple[int, int]] = []
    volume = backproject(
        noise(SIX, SHORT), GRID, method=method, device=device, window="hann",
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    assert seen[0][0] == 0
    assert seen[-1][0] == seen[-1][1]
    assert len({total for _, total in seen}) == 1
    assert all(a[0] <= b[0] for a, b in pairwise(seen))
    assert (volume.meta["method"], volume.meta["window"]) == (method, "hann")
    assert volume.meta["device"]["device"] == device.info.name


TARGETS_M = {"centre": (0.0, 0.0, 0.3), "corner": (0.07, 0.05, 0.3)}


def point_response(target_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Image of a point target: for each frequency a sum over Tx times a sum over Rx, float64."""
    here, there = (phasors(at_m, QAR50, SWEEP) for at_m in (target_m[None], points_m))
    tx, rx = ((h * t.conj()).mean(axis=2) for h, t in zip(here, there, strict=True))
    return (tx * rx).mean(axis=0)


@cache
def echo_of(name: str) -> Capture:
    return reference.point_targets(QAR50, SWEEP, np.array([TARGETS_M[name]]), np.ones(1))


@pytest.mark.parametrize("name", ["corner", *nightly(["centre"])])
@pytest.mark.parametrize(
    ("axis", "method"),
    [
        *[(0, "exact"), (2, "range"), (0, "fast")],
        *nightly([(1, "exact"), (2, "exact"), (0, "range"), (1, "fast"), (2, "fast")]),
    ],
)
def test_a_point_target_has_its_closed_form(device, name, axis, method):
    """From the peak, where every term of the sum is 1, over side lobes: to the tolerance of it, and
    the peak to 0.25 mm."""
    target_m = np.array(TARGETS_M[name])
    counts, origin_m = np.ones(3, int), target_m.copy()
    counts[axis], origin_m[axis] = 241, target_m[axis] - 0.03
    grid = VoxelGrid(origin_m, np.full(3, 0.25e-3), tuple(counts))
    image = backproject(echo_of(name), grid, method=method, device=device).data.ravel()
    want = point_response(target_m, centres_m(grid))
    assert abs(np.abs(want).max() - 1) <= 1e-12
    assert np.abs(image - want).max() <= 10 ** (TOLERANCE_DB[method] / 20)
    assert abs(int(np.abs(image).argmax()) - 120) <= 1


def test_samples_whose_sum_overflows_are_refused(device):
    capture = Capture(np.full((6, 5, 11), 3e38 - 3e38j), random_array(6, 5), SHORT)
    for method in METHODS:
        with pytest.raises(ModelError, match=r"sum complex64 holds, got .* up to 3e\+38; scale"):
            backproject(capture, GRID, method=method, device=device)


BAND = clradar.Waveform.sfcw(72e9, 82e9, 32)
THIN = clradar.AntennaArray(QAR50.tx_m[::6], QAR50.rx_m[::6])
BOX = VoxelGrid.from_extent((-0.04, 0.04), (-0.03, 0.05), (0.27, 0.31), 2e-3)


@pytest.fixture(scope="module")
def frames() -> list[Capture]:
    """Echoes of a few points at other places each, and noise."""
    rng = np.random.default_rng(3)
    made = []
    for _ in range(2):
        points_m = rng.uniform([-0.03, -0.02, 0.28], [0.03, 0.04, 0.30], (5, 3))
        made.append(clradar.room_capture(THIN, BAND, [], points_m=points_m))
    return [*made, noise(THIN, BAND, seed=5)]


@pytest.mark.parametrize(
    ("method", "window"), [("fast", "rect"), ("fast", "hann"), ("range", "rect"), ("exact", "rect")]
)
def test_frames_have_the_bits_of_single_images(frames, method, window, device):
    """Whatever was imaged before."""
    grid = BOX if method == "fast" else VoxelGrid(BOX.origin_m, BOX.spacing_m, (9, 8, 7))
    options: dict[str, Any] = {"method": method, "window": window, "device": device}
    with FrameImager(THIN, BAND, grid, **options) as imager:
        for frame in (*frames, frames[0]):
            imager.form(frame)
            alone = clradar.backproject(frame, grid, check_grid=False, **options)
            np.testing.assert_array_equal(imager.volume().data, alone.data)
            assert imager.volume().meta == alone.meta
            shown, depth = imager.depth_map(20.0), alone.depth_map(20.0)
            # The strongest voxel is found in float32 on the device.
            np.testing.assert_allclose(shown.depth_m, depth.depth_m, rtol=1e-6)
            np.testing.assert_allclose(shown.amplitude, depth.amplitude, rtol=1e-6)
            assert depth.mask.any()


def test_what_does_not_fit_is_refused(frames):
    with FrameImager(THIN, BAND, BOX) as imager:
        with pytest.raises(ModelError, match="a frame formed before"):
            imager.depth_map()
        other = THIN.part(slice(8), slice(None))
        imager.form(frames[0])
        # A refused frame leaves the last image.
        with pytest.raises(ModelError, match="one by its array and waveform"):
            imager.form(noise(other, BAND))
        assert imager.depth_map().mask.any()
        # Samples that are finite, but whose sums are not.
        huge = np.full(frames[0].data.shape, 3e38, np.complex64)
        imager.form(Capture(huge, THIN, BAND))
        for read in (imager.depth_map, imager.volume):
            with pytest.raises(ModelError, match="overflow"):
                read()
        imager.form(frames[1])
        assert imager.depth_map().mask.any()


def test_grids_of_several_pieces_are_kept_on_the_host(frames, monkeypatch):
    monkeypatch.setattr(fast, "TILE_VOXELS", 20_000)
    with FrameImager(THIN, BAND, BOX) as imager:
        imager.form(frames[0])
        alone = clradar.backproject(frames[0], BOX, check_grid=False)
        np.testing.assert_array_equal(imager.volume().data, alone.data)
        np.testing.assert_array_equal(imager.depth_map().depth_m, alone.depth_map().depth_m)


def test_a_simulation_is_imaged_where_it_is(device):
    """The image has the same bits as by way of a capture."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.015)
    scene = clradar.Scene.from_mesh(ball.apply_translation([0, 0.01, 0.29]), alpha=0.5)
    for estimator in ("expected", "physical"):
        options = {"samples_per_mm2": 2, "estimator": estimator, "seed": 1}
        with FrameImager(THIN, BAND, BOX, device=device) as imager:
            imager.form(clradar.simulate(scene, THIN, BAND, device=device, **options))
            want = imager.volume()
            clradar.simulate_image(scene, imager, **options)
            np.testing.assert_array_equal(imager.volume().data, want.data)
            assert imager.volume().meta == want.meta


def test_the_absolute_scale_is_that_of_the_captures_gains(frames, device):
    louder = clradar.AntennaArray(
        THIN.tx_m, THIN.rx_m, tx_pattern=clradar.AntennaPattern(gain_dbi=6.0)
    )
    meta = {**frames[0].meta, "absolute": True}
    frame = Capture(frames[0].data, louder, BAND, meta)
    with FrameImager(THIN, BAND, BOX, device=device) as imager:
        imager.form(frame)
        alone = clradar.backproject(frame, BOX, check_grid=False, device=device)
        np.testing.assert_array_equal(imager.volume().rcs_dbsm(), alone.rcs_dbsm())
