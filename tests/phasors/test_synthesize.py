"""The phasor sum against float64: sizes, blocks of path length that make room, any split."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh

import clradar
from clradar import AntennaArray, Paths, Scene, Waveform, reference, synthesize
from clradar.errors import ModelError
from clradar.phasors.length_blocks import length_blocks

# One path errs by 2e-7 where the moments end. Two phases, the carrier's and the block's, are each
# rounded to 2^-26 cycles, 9e-8 rad, and have sines and cosines to 1.1e-7. About ten roundings of
# 2^-24 remain, in x^p, products and the complex64 result. Were all of one sign, 1.2e-6; 8e-7 is
# seven times the RMS for a band in use, 1.1e-7. Relative to the sum of the pair's |amplitudes|,
# since the errors of that many paths can all have one sign.
PHASOR_ERROR = 8e-7
# Both are correctly rounded sums of the same products, in another order: one rounding to complex64.
REORDERED = 2.0**-23


@pytest.fixture(params=[1, 8], ids=["one lane", "eight lanes"])
def lanes(device: clradar.Device, request: pytest.FixtureRequest) -> clradar.Device:
    """The device with kernels of either width."""
    return clradar.open_device(device.info.selector, width=request.param)


def make_array(n_tx: int, n_rx: int) -> AntennaArray:
    sides = (np.linspace(-0.07, 0.07, n)[:, None] * [1, 0, 0] for n in (n_tx, n_rx))
    return AntennaArray(*sides)


def make_paths(pair: Any, length_m: Any, amplitude: Any, array: AntennaArray) -> Paths:
    pair = np.asarray(pair, dtype=int)
    return Paths(
        pair // array.n_rx, pair % array.n_rx, length_m, amplitude, np.ones(len(pair), int),
        array.n_tx, array.n_rx,
    )  # fmt: skip


def random_paths(n: int, array: AntennaArray, seed: int, longest_m: float = 1.0) -> Paths:
    """Paths of random pairs in no order, with lengths from 0.3 m and amplitudes of both signs."""
    rng = np.random.default_rng(seed)
    pair = rng.integers(0, array.n_tx * array.n_rx, n)
    return make_paths(pair, rng.uniform(0.3, longest_m, n), rng.normal(size=n), array)


def assert_sums(paths: Paths, array: AntennaArray, waveform: Waveform, device: Any) -> None:
    """Relative to the sum of the pair's |amplitudes|: a sum that cancels has been rounded, too."""
    data = synthesize(paths, array, waveform, device=device).data
    want = reference.synthesize(paths, array, waveform)
    total = np.bincount(paths.pair, np.abs(paths.amplitude).astype(float), data[..., 0].size)
    assert (np.abs(data - want) <= PHASOR_ERROR * total.reshape(*data.shape[:2], 1)).all()


WAVEFORMS = {
    "one": Waveform([77e9]),
    "equal": Waveform.sfcw(72e9, 82e9, 16),
    "octaves": Waveform.sfcw(10e9, 90e9, 33),
    "neighbours": Waveform([77e9, 77e9 + 0.25]),
    "seven": Waveform.sfcw(72e9, 82e9, 7),
    "nine": Waveform.sfcw(72e9, 82e9, 9),
    "prime": Waveform.sfcw(72e9, 82e9, 127),
    "unequal": Waveform(72e9 + 10e9 * np.sort(np.random.default_rng(3).uniform(0, 1, 37))),
    "wide": Waveform([1e8, 1.01e8, 5e9, 24e9, 60e9, 77e9, 140e9, 300e9, 999e9]),
}


@pytest.mark.parametrize(
    ("name", "longest_m"),
    [*((name, 1.0) for name in WAVEFORMS), ("equal", 30.0), ("octaves", 30.0)],
)
def test_random_paths_against_float64(lanes, name, longest_m):
    """The longest of so many blocks that they have to make room for each other."""
    array, waveform = make_array(5, 7), WAVEFORMS[name]
    assert_sums(random_paths(4000, array, 1, longest_m), array, waveform, lanes)
    blocks = length_blocks(waveform)
    assert longest_m == 1.0 or longest_m / blocks.block_m > 50 * blocks.n_slots


def test_one_path_per_pair_keeps_its_phase(device):
    """Which a length in float32 would turn by 1e-2 rad."""
    array, waveform = make_array(40, 50), Waveform([72e9, 77.7e9, 82e9])
    length_m = np.random.default_rng(2).uniform(0.001, 100, 2000)
    paths = make_paths(np.arange(2000), length_m, np.ones(2000), array)
    assert_sums(paths, array, waveform, device)


def test_strong_paths_that_cancel_leave_the_weak_one(device):
    array, waveform = make_array(1, 1), Waveform.sfcw(72e9, 82e9, 5)
    length = np.array([0.6, 0.7, 0.6])
    amplitude = np.array([2.0**20, 1.0, -(2.0**20)])
    zeros = np.zeros(3, int)
    paths = Paths(zeros, zeros, length, amplitude, zeros + 1, 1, 1)
    data = synthesize(paths, array, waveform, device=device).data
    weak = synthesize(make_paths([0], [0.7], [1.0], array), array, waveform, device=device).data
    # The two strong ones are the same to the bit, and a sum of two float32 holds 48 bits.
    assert np.abs(data - weak).max() <= REORDERED


def test_paths_of_another_array_are_refused(device):
    paths = random_paths(10, make_array(3, 4), seed=1)
    with pytest.raises(ModelError, match="paths of a 4 x 3 array, got 3 x 4"):
        synthesize(paths, make_array(4, 3), Waveform([1e9]), device=device)


def box_scene(alpha: float) -> Scene:
    mesh = trimesh.creation.box(extents=(0.06, 0.05, 0.02))
    mesh.apply_translation([0.01, 0.0, 0.3])
    return Scene.from_mesh(mesh, alpha=alpha)


@pytest.mark.parametrize(
    "settings",
    [
        {"samples_per_mm2": 0.5, "rays_per_sample": 3, "seed": 11},
        {"rays_per_face": 2000, "max_bounces": 2, "amplitude": "spreading", "normals": "face"},
    ],
)
def test_simulate_is_trace_and_synthesize_to_the_bit_and_says_what_it_did(device, settings):
    full = clradar.arrays.qar50()
    array = AntennaArray(full.tx_m[::9], full.rx_m[::10])
    waveform, scene = Waveform.sfcw(72e9, 82e9, 9), box_scene(0.5)
    paths = clradar.trace(scene, array, device=device, **settings)
    assert len(paths) > 1000
    want = synthesize(paths, array, waveform, device=device, meta={"note": "mine"})
    assert want.meta["note"] == "mine"
    seen: list[tuple[int, int]] = []
    capture = clradar.simulate(
        scene, array, waveform, device=device, progress=lambda *step: seen.append(step), **settings
    )
    np.testing.assert_array_equal(capture.data, want.data)
    assert capture.meta["rays"]["paths"] == len(paths)
    assert capture.meta["kind"] == "simulated"
    assert capture.meta["device"]["device"] == device.info.name
    assert settings.items() <= capture.meta["settings"].items()
    assert capture.meta["scene"]["sha256"] == scene.digest()
    assert seen[-1][0] == seen[-1][1]
    assert all(a[0] <= b[0] for a, b in pairwise(seen))


# Blocks of path length --------------------------------------------------------------------------


def test_lengths_at_the_ends_of_blocks_and_numbers(device):
    waveform = WAVEFORMS["equal"]
    block_m = length_blocks(waveform).block_m
    edges = (np.arange(200) + 0.5) * block_m
    powers = 2.0 ** np.arange(-90, 8)
    tiny = [5e-324, 1e-308, 1e-300, 1e-45, 1e-38]
    length_m = np.concatenate(
        [tiny, edges, powers]
        + [np.nextafter(v, side) for v in (edges, powers) for side in (0, np.inf)]
    )
    array = make_array(len(length_m), 1)
    paths = make_paths(np.arange(len(length_m)), length_m, np.ones(len(length_m)), array)
    assert_sums(paths, array, waveform, device)


@pytest.mark.parametrize("apart", [1, 0])
def test_blocks_in_turn_in_one_slot_do_not_drift(device, apart):
    # Every path of the first case makes room; in the second, none does.
    n, array, waveform = 200_000, make_array(1, 1), Waveform.sfcw(72e9, 82e9, 4)
    blocks = length_blocks(waveform)
    length_m = 0.6 + blocks.block_m * np.tile([0, apart * blocks.n_slots], n // 2)
    paths = make_paths(np.zeros(n), length_m, np.full(n, 0.7), array)
    data = synthesize(paths, array, waveform, device=device).data
    two = reference.synthesize(make_paths([0, 0], length_m[:2], [0.7, 0.7], array), array, waveform)
    assert np.abs(data - n / 2 * two).max() <= PHASOR_ERROR * 0.7 * n


def test_a_path_of_too_many_wavelengths_is_an_error(device):
    array = make_array(1, 1)
    limit_m = length_blocks(WAVEFORMS["equal"]).longest_m
    within = make_paths([0], [limit_m * 0.999], [1.0], array)
    assert_sums(within, array, WAVEFORMS["equal"], device)
    beyond = make_paths([0, 0], [0.5, limit_m * 1.001], [1.0, 1.0], array)
    with pytest.raises(ModelError, match=r"paths: expected lengths up to 7667\.\d+ m .*got 7674"):
        synthesize(beyond, array, WAVEFORMS["equal"], device=device)
