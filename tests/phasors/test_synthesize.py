"""The phasor sum against float64, at every size that could go wrong."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh

import clradar
from clradar import AntennaArray, Paths, Scene, Waveform, reference, synthesize
from clradar.errors import ModelError

# One path errs by 2e-7 where the moments end. Two phases, the carrier's and the block's, are each
# rounded to 2^-26 cycles, 9e-8 rad, and have sines and cosines to 1.1e-7. About ten roundings of
# 2^-24 remain, in x^p, products and the complex64 result. Were all of one sign, 1.2e-6; 8e-7 is
# seven times the RMS for a band in use, 1.1e-7. Relative to the sum of the pair's |amplitudes|,
# since the errors of that many paths can all have one sign.
PHASOR_ERROR = 8e-7
# The accuracy that is promised: -80 dB of the strongest pair.
PROMISED_DB = -80.0
# Both are correctly rounded sums of the same products, in another order: one rounding to complex64.
REORDERED = 2.0**-23


@pytest.fixture(params=[1, 8], ids=["one lane", "eight lanes"])
def lanes(device: clradar.Device, request: pytest.FixtureRequest) -> clradar.Device:
    """The device with kernels of either width."""
    return clradar.open_device(device.info.selector, width=request.param)


def line(n: int, z_m: float = 0.0) -> np.ndarray:
    return np.stack([np.linspace(-0.07, 0.07, n), np.zeros(n), np.full(n, z_m)], axis=1)


def make_array(n_tx: int, n_rx: int) -> AntennaArray:
    return AntennaArray(line(n_tx), line(n_rx))


def random_paths(n: int, array: AntennaArray, seed: int, **columns: Any) -> Paths:
    """Paths of random pairs, sorted, with lengths of 0.4 to 1 m and amplitudes of both signs."""
    rng = np.random.default_rng(seed)
    pair = np.sort(rng.integers(0, array.n_tx * array.n_rx, n))
    values = {
        "tx": pair // array.n_rx,
        "rx": pair % array.n_rx,
        "length_m": rng.uniform(0.4, 1.0, n),
        "amplitude": rng.normal(size=n),
        "bounces": np.ones(n, int),
    }
    return Paths(**{**values, **columns}, n_tx=array.n_tx, n_rx=array.n_rx)


def picked(paths: Paths, rows: np.ndarray | slice) -> Paths:
    return Paths(
        paths.tx[rows], paths.rx[rows], paths.length_m[rows], paths.amplitude[rows],
        paths.bounces[rows], paths.n_tx, paths.n_rx,
    )  # fmt: skip


def pair_total(paths: Paths) -> np.ndarray:
    """Sum of |amplitude| of every pair, shape (n_tx, n_rx, 1)."""
    weights = np.abs(paths.amplitude).astype(np.float64)
    return np.bincount(paths.pair, weights, paths.n_tx * paths.n_rx).reshape(
        paths.n_tx, paths.n_rx, 1
    )


def decibel(data: np.ndarray, want: np.ndarray) -> float:
    """Largest error of any element relative to the strongest element."""
    return float(20 * np.log10(np.abs(data - want).max() / np.abs(want).max() + 1e-30))


WAVEFORMS = {
    "one": Waveform([77e9]),
    "two": Waveform([72e9, 82e9]),
    "seven": Waveform.sfcw(72e9, 82e9, 7),
    "eight": Waveform.sfcw(72e9, 82e9, 8),
    "nine": Waveform.sfcw(72e9, 82e9, 9),
    "prime": Waveform.sfcw(72e9, 82e9, 127),
    "unequal": Waveform(72e9 + 10e9 * np.sort(np.random.default_rng(3).uniform(0, 1, 37))),
    "wide": Waveform([1e8, 1.01e8, 5e9, 24e9, 60e9, 77e9, 140e9, 300e9, 999e9]),
}


@pytest.mark.parametrize("name", WAVEFORMS)
def test_random_paths_against_float64(lanes, name):
    array, waveform = make_array(5, 7), WAVEFORMS[name]
    paths = random_paths(3000, array, seed=1)
    capture = synthesize(paths, array, waveform, device=lanes)
    want = reference.synthesize(paths, array, waveform)
    assert capture.data.shape == (5, 7, waveform.n_freq)
    assert (np.abs(capture.data - want) <= PHASOR_ERROR * pair_total(paths)).all()
    assert decibel(capture.data, want) <= PROMISED_DB


@pytest.mark.parametrize("longest_m", [1e-3, 1.0, 100.0])
def test_one_path_per_pair_keeps_its_phase(lanes, longest_m):
    array, waveform = make_array(40, 50), Waveform([72e9, 77.7e9, 82e9])
    length = np.random.default_rng(2).uniform(0.001, 1, 2000) * longest_m
    tx, rx = (index.ravel() for index in np.indices((40, 50)))
    paths = Paths(tx, rx, length, np.ones(2000), np.ones(2000, int), 40, 50)
    data = synthesize(paths, array, waveform, device=lanes).data
    want = reference.synthesize(paths, array, waveform)
    assert np.abs(data - want).max() <= PHASOR_ERROR
    # A plain float32 length must fail the same tolerance.
    short = synthesize(
        Paths(tx, rx, length.astype(np.float32), np.ones(2000), np.ones(2000, int), 40, 50),
        array, waveform, device=lanes,
    ).data  # fmt: skip
    if longest_m >= 1:
        assert np.abs(short - want).max() > 10 * PHASOR_ERROR


def test_strong_paths_that_cancel_leave_the_weak_one(device):
    array, waveform = make_array(1, 1), Waveform.sfcw(72e9, 82e9, 5)
    length = np.array([0.6, 0.7, 0.6])
    amplitude = np.array([2.0**20, 1.0, -(2.0**20)])
    zeros = np.zeros(3, int)
    paths = Paths(zeros, zeros, length, amplitude, zeros + 1, 1, 1)
    data = synthesize(paths, array, waveform, device=device).data
    weak = synthesize(picked(paths, slice(1, 2)), array, waveform, device=device).data
    # The two strong ones are the same to the bit, and a sum of two float32 holds 48 bits.
    assert np.abs(data - weak).max() <= REORDERED


def test_no_paths_and_empty_pairs(lanes):
    array, waveform = make_array(3, 5), Waveform.sfcw(72e9, 82e9, 9)
    nothing = Paths([], [], [], [], [], 3, 5)
    assert not synthesize(nothing, array, waveform, device=lanes).data.any()
    ends = Paths([0, 2], [0, 4], [0.5, 0.6], [1, 1], [1, 1], 3, 5)
    data = synthesize(ends, array, waveform, device=lanes).data
    np.testing.assert_allclose(np.abs(data[[0, 2], [0, 4]]), 1.0, rtol=PHASOR_ERROR)
    data = data.copy()
    data[[0, 2], [0, 4]] = 0
    assert not data.any()


def test_paths_of_another_array_are_refused(device):
    paths = random_paths(10, make_array(3, 4), seed=1)
    with pytest.raises(ModelError, match="paths of a 4 x 3 array, got 3 x 4"):
        synthesize(paths, make_array(4, 3), Waveform([1e9]), device=device)


def test_meta_names_the_device_and_keeps_the_callers(device):
    array = make_array(1, 1)
    paths = Paths([0], [0], [0.6], [1], [1], 1, 1)
    capture = synthesize(paths, array, Waveform([77e9]), device=device, meta={"note": "mine"})
    assert capture.meta["note"] == "mine"
    assert capture.meta["device"]["device"] == device.info.name


def box_scene(alpha: float) -> Scene:
    mesh = trimesh.creation.box(extents=(0.06, 0.05, 0.02))
    mesh.apply_translation([0.01, 0.0, 0.3])
    return Scene.from_mesh(mesh, alpha=alpha)


SETTINGS = [
    {"samples_per_mm2": 0.5, "rays_per_sample": 3, "seed": 11},
    {"rays_per_face": 2000, "max_bounces": 2, "amplitude": "spreading", "normals": "face"},
]


@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize("limit_bytes", [None, 800_000])
def test_simulate_is_trace_and_synthesize_to_the_bit(device, settings, limit_bytes):
    full = clradar.arrays.qar50()
    array = AntennaArray(full.tx_m[::9], full.rx_m[::10])
    waveform = Waveform.sfcw(72e9, 82e9, 9)
    scene = box_scene(0.5)
    paths = clradar.trace(scene, array, device=device, **settings)
    assert len(paths) > 1000
    want = synthesize(paths, array, waveform, device=device).data
    used = device
    if limit_bytes is not None:
        used = clradar.open_device(device.info.selector, memory_limit_bytes=limit_bytes)
    capture = clradar.simulate(scene, array, waveform, device=used, **settings)
    np.testing.assert_array_equal(capture.data, want)
    assert capture.meta["rays"]["paths"] == len(paths)
    assert capture.meta["kind"] == "simulated"
    for name, value in settings.items():
        assert capture.meta["settings"][name] == value
    assert capture.meta["scene"]["sha256"] == scene.digest()


@pytest.mark.filterwarnings("ignore:.* received no ray", "ignore:no ray reached")
def test_simulate_reports_progress(device):
    seen: list[tuple[int, int]] = []
    clradar.simulate(
        box_scene(1.0), make_array(2, 2), Waveform([77e9]), rays_per_face=10, device=device,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    assert seen
    assert seen[-1] == (120, 120)
    assert all(a[0] <= b[0] for a, b in pairwise(seen))
