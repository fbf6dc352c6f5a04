"""The phasor sum's blocks of path length: moments, blocks that make room, any split into calls."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import clradar
from clradar import AntennaArray, Paths, Waveform, synthesize
from clradar.errors import ModelError
from clradar.phasors.length_blocks import (
    EDGE_PHASE_RAD,
    MOMENTS,
    NARROWEST_HZ,
    length_blocks,
)

C_M_PER_S = 299_792_458.0

# 2 (J_8(1) + J_9(1) + ...), and coefficients rounded to float32: 2^-25 of their sum, e.
MOMENT_ERROR = 2.0e-7 + 2.0**-25 * np.exp(EDGE_PHASE_RAD)
# Of one path relative to its amplitude; derived in test_synthesize.py.
PHASOR_ERROR = 8e-7

WAVEFORMS = {
    "one": Waveform([77e9]),
    "two": Waveform([72e9, 82e9]),
    "equal": Waveform.sfcw(72e9, 82e9, 16),
    "unequal": Waveform(72e9 + 10e9 * np.array([0, 1e-6, 0.001, 0.5, 0.51, 0.98, 1])),
    "octaves": Waveform.sfcw(10e9, 90e9, 33),
    "baseband": Waveform([1e8, 1e8 + 1, 1e9]),
    "neighbours": Waveform([77e9, 77e9 + 0.25]),
}


def make_array(n_tx: int, n_rx: int) -> AntennaArray:
    def line(n: int) -> np.ndarray:
        return np.stack([np.linspace(-0.07, 0.07, n), np.zeros(n), np.zeros(n)], axis=1)

    return AntennaArray(line(n_tx), line(n_rx))


def make_paths(pair: Any, length_m: Any, amplitude: Any, array: AntennaArray) -> Paths:
    pair = np.asarray(pair, dtype=int)
    return Paths(
        pair // array.n_rx, pair % array.n_rx, length_m, amplitude, np.ones(len(pair), int),
        array.n_tx, array.n_rx,
    )  # fmt: skip


def random_paths(n: int, array: AntennaArray, longest_m: float, seed: int) -> Paths:
    """Paths of random pairs in no order."""
    rng = np.random.default_rng(seed)
    pair = rng.integers(0, array.n_tx * array.n_rx, n)
    return make_paths(pair, rng.uniform(0.3, longest_m, n), rng.normal(size=n), array)


def summed(paths: Paths, waveform: Waveform) -> tuple[np.ndarray, np.ndarray]:
    """The sum in float64 and that of the |amplitudes|, both by pair."""
    phasor = np.exp(-2j * np.pi * np.outer(paths.length_m, waveform.frequencies_hz / C_M_PER_S))
    total = np.zeros((paths.n_tx * paths.n_rx, waveform.n_freq), complex)
    np.add.at(total, paths.pair, paths.amplitude[:, None] * phasor)
    weight = np.bincount(paths.pair, np.abs(paths.amplitude).astype(float), len(total))
    shape = (paths.n_tx, paths.n_rx, -1)
    return total.reshape(shape), weight.reshape(shape)


def assert_sums(paths: Paths, array: AntennaArray, waveform: Waveform, device: Any) -> None:
    data = synthesize(paths, array, waveform, device=device).data
    want, weight = summed(paths, waveform)
    # A sum that cancels still has been rounded at the size of its terms.
    assert (np.abs(data - want) <= PHASOR_ERROR * weight).all()


@pytest.mark.parametrize("name", WAVEFORMS)
def test_moments_make_the_phasor_everywhere_in_a_block(name):
    waveform = WAVEFORMS[name]
    blocks = length_blocks(waveform)
    x = np.linspace(-1, 1, 301)[:, None]
    p = np.arange(MOMENTS)[:, None, None]
    got = ((-1j) ** (p % 2) * blocks.table[:MOMENTS, None].astype(float) * x**p).sum(axis=0)
    kappa = (waveform.frequencies_hz - waveform.center_hz) / C_M_PER_S
    want = np.exp(-2j * np.pi * kappa * x / blocks.per_half_block)
    assert np.abs(got - want).max() <= MOMENT_ERROR


@pytest.mark.parametrize("name", WAVEFORMS)
def test_blocks_are_as_long_as_the_band_allows(name):
    waveform = WAVEFORMS[name]
    blocks = length_blocks(waveform)
    edge_rad = np.pi * waveform.span_hz / C_M_PER_S * blocks.block_m / 2
    # Rounded to float32, and shorter only for a narrow band.
    assert edge_rad <= EDGE_PHASE_RAD * (1 + 2.0**-23)
    if waveform.span_hz >= NARROWEST_HZ:
        assert edge_rad >= EDGE_PHASE_RAD * (1 - 2.0**-23)
    assert blocks.block_m == np.float32(blocks.block_m)
    assert blocks.per_half_block == np.float32(2 / blocks.block_m)
    np.testing.assert_allclose(
        blocks.table[MOMENTS].astype(float) + blocks.table[MOMENTS + 1],
        (waveform.frequencies_hz - waveform.center_hz) / C_M_PER_S,
        rtol=2.0**-47,
    )
    assert blocks.longest_m * waveform.frequencies_hz[-1] / C_M_PER_S == pytest.approx(2**21)


@st.composite
def cases(draw: st.DrawFn) -> tuple[Paths, AntennaArray, Waveform]:
    array = make_array(draw(st.integers(1, 3)), draw(st.integers(1, 3)))
    lowest = draw(st.floats(1e8, 3e11))
    gaps = draw(st.lists(st.floats(1e-9, 1.0), max_size=20))
    span = draw(st.sampled_from([1e-3, 1e6, 1e9, 1e10, 8e10]))
    waveform = Waveform(np.unique(lowest + span * np.cumsum([0.0, *gaps]) / (sum(gaps) or 1)))
    n = draw(st.integers(1, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    # Some at one length, some close together, some over the whole range.
    longest_m = draw(st.sampled_from([1e-3, 1.0, 30.0, 1000.0]))
    spread = draw(st.sampled_from([0.0, 1e-6, 0.1, 1.0]))
    length_m = longest_m * (1 - spread * rng.uniform(0, 0.9999, n))
    amplitude = rng.normal(size=n) * 10.0 ** rng.uniform(-3, 3, n)
    pair = rng.integers(0, array.n_tx * array.n_rx, n)
    return make_paths(pair, length_m, amplitude, array), array, waveform


@settings(max_examples=40, deadline=None, derandomize=True)
@given(case=cases(), width=st.sampled_from([1, 8]))
def test_any_paths_and_frequencies(case, width):
    assert_sums(*case, clradar.open_device("pocl", width=width))


@pytest.mark.parametrize("name", WAVEFORMS)
@pytest.mark.parametrize("longest_m", [0.8, 30.0])
def test_evicted_blocks(device, name, longest_m):
    array, waveform = make_array(2, 3), WAVEFORMS[name]
    paths = random_paths(4000, array, longest_m, seed=1)
    assert_sums(paths, array, waveform, device)
    blocks = length_blocks(waveform)
    if name in ("equal", "octaves") and longest_m == 30.0:
        assert longest_m / blocks.block_m > 50 * blocks.n_slots


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
    two, _ = summed(make_paths([0, 0], length_m[:2], [0.7, 0.7], array), waveform)
    assert np.abs(data - n / 2 * two).max() <= PHASOR_ERROR * 0.7 * n


def test_a_path_of_too_many_wavelengths_is_an_error(device):
    array = make_array(1, 1)
    limit_m = length_blocks(WAVEFORMS["equal"]).longest_m
    within = make_paths([0], [limit_m * 0.999], [1.0], array)
    assert_sums(within, array, WAVEFORMS["equal"], device)
    beyond = make_paths([0, 0], [0.5, limit_m * 1.001], [1.0, 1.0], array)
    with pytest.raises(ModelError, match=r"paths: expected lengths up to 7667\.\d+ m .*got 7674"):
        synthesize(beyond, array, WAVEFORMS["equal"], device=device)
