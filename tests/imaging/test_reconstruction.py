"""Images by iteration: what they explain, when they stop, what they refuse."""

import sys
from typing import Any

import numpy as np
import pytest
from images import centres_m, phasors

import clradar
from clradar import Capture, VoxelGrid, Waveform
from clradar.errors import MissingPackage, ModelError

Q = clradar.arrays.qar50()
ARRAY = Q.part(slice(None, None, 8), slice(None, None, 8))
WAVEFORM = Waveform.sfcw(72e9, 82e9, 6)
GRID = VoxelGrid.from_extent((-0.012, 0.012), (-0.008, 0.008), (0.3, 0.3), 2e-3)


def matrix(grid: VoxelGrid) -> np.ndarray:
    """The operator from the equation, in float64, shape (samples, voxels)."""
    tx, rx = phasors(centres_m(grid), ARRAY, WAVEFORM)
    return np.einsum("npt,npr->trnp", tx, rx).reshape(-1, tx.shape[1])


def noise(shape: tuple[int, ...], level: float) -> np.ndarray:
    rng = np.random.default_rng(3)
    return level * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def capture_of(points_m: Any, amplitudes: Any, level: float, device: Any) -> Capture:
    clean = clradar.forward(points_m, amplitudes, ARRAY, WAVEFORM, device=device)
    return Capture(clean.data + noise(clean.data.shape, level), ARRAY, WAVEFORM)


def reconstruct(capture: Capture, grid: VoxelGrid, device: Any, **options: Any) -> clradar.Volume:
    return clradar.reconstruct(capture, grid, check_grid=False, device=device, **options)


def test_damped_least_squares_are_those_of_the_normal_equations(device):
    capture = capture_of([[0, 0, 0.3], [6e-3, 2e-3, 0.3]], [1, 0.5j], 0.5, device)
    a, s = matrix(GRID), capture.data.astype(np.complex128).ravel()
    for damping_db in (0.0, 10.0):
        weight = 10 ** (damping_db / 10) * s.size
        wanted = np.linalg.solve(a.conj().T @ a + weight * np.eye(a.shape[1]), a.conj().T @ s)
        image = reconstruct(capture, GRID, device, damping_db=damping_db, iterations=200)
        # It stops where an iteration changes 0.2 %, or where the gradient is that of noise: then
        # the error is at most |A^H r| over the weight.
        residual = np.linalg.norm(s - a @ wanted)
        stopping = residual * np.sqrt(a.shape[1]) / weight + 0.02 * np.linalg.norm(wanted)
        assert np.linalg.norm(image.data.ravel() - wanted) < stopping
        assert image.meta["residual_db"] == pytest.approx(
            20 * np.log10(residual / np.linalg.norm(s)), abs=0.1
        )


def test_least_squares_stop_where_noise_is_left(device):
    level = 0.3
    capture = capture_of([[0, 0, 0.3], [6e-3, 2e-3, 0.3]], [1, 1j], level, device)
    image = reconstruct(capture, GRID, device)
    assert image.meta["stopped"] == "noise"
    left = 10 ** (image.meta["residual_db"] / 20) * np.linalg.norm(capture.data)
    # 117 voxels can explain at most that many of 864 samples' noise. The part of the residual that
    # they could explain, by singular values of sqrt(864) and more, is at most as large.
    share = 117 / 864
    found = (left / level) ** 2 / capture.data.size
    assert 1 - share - 0.1 < found < 1 / (1 - share) + 0.1  # 864 squares scatter by 0.034
    assert image.meta["iterations"] < 30
    a, s = matrix(GRID), capture.data.ravel()
    rest = s - a @ image.data.ravel()
    gradient = np.linalg.norm(a.conj().T @ rest)
    assert gradient < 1.01 * np.linalg.norm(rest) * np.sqrt(a.shape[1])


def test_sparse_images_meet_the_conditions_of_the_minimum(device, monkeypatch):
    capture = capture_of([[0, 0, 0.3], [6e-3, 2e-3, 0.3]], [1, 1j], 0.1, device)
    a, s = matrix(GRID), capture.data.ravel()
    threshold = 10 ** (-20 / 20) * np.abs(a.conj().T @ s).max()
    image = reconstruct(capture, GRID, device, method="sparse", sparsity_db=-20, iterations=2000)
    assert image.meta["stopped"] == "change"
    rho = image.data.ravel()
    gradient = a.conj().T @ (s - a @ rho)
    on = np.abs(rho) > 0.05 * np.abs(rho).max()
    # |A^H r| is the threshold where a voxel is not 0, in its phase, and less elsewhere; to the
    # change at which iterations stop.
    assert np.abs(gradient[on] / (rho[on] / np.abs(rho[on])) / threshold - 1).max() < 0.2
    assert np.abs(gradient).max() < 1.2 * threshold
    assert np.count_nonzero(rho) < rho.size / 4
    # Steps that are too long are halved: they stop elsewhere, and diverge to residuals above 0 dB.
    monkeypatch.setattr("clradar.imaging.reconstruction.NORM_MARGIN", 0.1)
    found = reconstruct(capture, GRID, device, method="sparse", sparsity_db=-20, iterations=1000)
    assert found.meta["residual_db"] == pytest.approx(image.meta["residual_db"], abs=0.3)


def test_progress_and_the_limit_of_iterations(device):
    capture = capture_of([[0, 0, 0.3]], [1], 0.1, device)
    seen: list[tuple[int, int]] = []
    image = reconstruct(
        capture, GRID, device, method="sparse", iterations=3,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert (image.meta["iterations"], image.meta["stopped"]) == (3, "iterations")


def test_silence_has_an_empty_image(device):
    silence = Capture(np.zeros((12, 12, 6)), ARRAY, WAVEFORM)
    for method in ("least-squares", "sparse"):
        image = reconstruct(silence, GRID, device, method=method)
        assert not image.data.any()
        assert image.meta["residual_db"] is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "omp"}, "method: expected one of 'least-squares', 'sparse'"),
        ({"sparsity_db": -20}, "sparsity_db: expected none with method='least-squares'"),
        ({"method": "sparse", "damping_db": 0}, "damping_db: expected none with method='sparse'"),
        ({"method": "sparse", "sparsity_db": 0}, "sparsity_db: expected below 0 dB"),
        ({"damping_db": 1e6}, "damping_db: expected within 1000 dB"),
        ({"iterations": 0}, "iterations: expected a whole number"),
    ],
)
def test_refused(options, message):
    capture = Capture(np.ones((12, 12, 6)), ARRAY, WAVEFORM)
    with pytest.raises(ModelError, match=message):
        clradar.reconstruct(capture, GRID, **options)


def test_without_pylops(monkeypatch):
    monkeypatch.setitem(sys.modules, "pylops", None)
    capture = Capture(np.ones((12, 12, 6)), ARRAY, WAVEFORM)
    with pytest.raises(MissingPackage, match=r"expected the package pylops.*pip install pylops"):
        clradar.reconstruct(capture, GRID)
