"""Impairments: each against its equation, its statistics or its closed form."""

import json
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import clradar
from clradar import AntennaArray, Capture, Wall, Waveform, draw_channels, impair, room_capture
from clradar.errors import ModelError
from clradar.impairments import channel_errors
from clradar.impairments.channel_errors import DRAWN, drift_factors, random_stream

C = 299_792_458.0
# complex64 rounds real and imaginary part to 2^-24 of themselves; computed in float64 before.
ROUNDING = 2.0**-23
# Phases of up to 2 pi 82e9 * 5 m / c = 8600 rad are good to 2^-53 of themselves in float64, so
# differences between two orders of operations stay far below what complex64 holds.
SAMPLES = 24 * 20 * 64
# The mean power of n complex normal samples has a relative standard deviation of 1/sqrt(n); five of
# them happen once in two million, and the seed is fixed anyway.
POWER = 5 / np.sqrt(SAMPLES)


def small_array(n_tx: int = 24, n_rx: int = 20) -> AntennaArray:
    tx = np.stack([np.full(n_tx, -0.07), np.linspace(-0.06, 0.06, n_tx), np.zeros(n_tx)], axis=1)
    rx = np.stack([np.linspace(-0.06, 0.06, n_rx), np.full(n_rx, 0.07), np.zeros(n_rx)], axis=1)
    return AntennaArray(tx, rx)


ARRAY = small_array()
SWEEP = Waveform.sfcw(72e9, 82e9, 64)


@pytest.fixture(scope="module")
def target() -> Capture:
    """A point target of amplitude 1: mean power 1."""
    return point([0.01, 0.02, 0.3])


def point(at_m: list[float]) -> Capture:
    to_tx, to_rx = (np.linalg.norm(side - at_m, axis=1) for side in (ARRAY.tx_m, ARRAY.rx_m))
    path_m = (to_tx[:, None] + to_rx)[..., None]
    return Capture(np.exp(-2j * np.pi * path_m * SWEEP.frequencies_hz / C), ARRAY, SWEEP)


def zeros() -> Capture:
    return Capture(np.zeros((ARRAY.n_tx, ARRAY.n_rx, SWEEP.n_freq)), ARRAY, SWEEP)


def power(data: np.ndarray) -> float:
    return float((np.abs(data.astype(complex)) ** 2).mean())


def close(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING * np.abs(expected).max())


def test_all_settings_are_recorded_as_json_and_calls_add_up(target):
    room = room_capture(ARRAY, SWEEP, [Wall([0, 0, 1], [0, 0, 2])])
    channels = draw_channels(ARRAY, SWEEP, seed=5, dead_tx=[3])
    first = impair(target, seed=7, frame=2, room=room, coupling_db=3, channels=channels, snr_db=20,
                   drift_phase_rad=0.1, iq_gain_db=np.linspace(0, 1, 20),
                   adc_bits=12)  # fmt: skip
    both = impair(first, snr_db=30)
    one, two = json.loads(json.dumps(dict(both.meta)))["impairments"]
    assert (one["seed"], one["frame"], one["coupling_db"], one["adc_bits"]) == (7, 2, 3.0, 12)
    assert one["room"]["meta"]["room"]["walls"][0]["normal"] == [0.0, 0.0, 1.0]
    assert one["reference_power"] == pytest.approx(1, rel=1e-6)
    assert len(one["iq_gain_db"]) == 20
    gain = np.array(one["channels"]["tx_gain"]) @ [1, 1j]
    np.testing.assert_array_equal(gain, channels.tx_gain)
    assert one["adc_full_scale"] > 1
    assert (two["snr_db"], two["channels"], two["iq_gain_db"]) == (30.0, None, 0.0)


def test_noise_has_the_stated_power_and_is_circular(target):
    noise = impair(target, snr_db=13, seed=3).data - target.data
    expected = 10**-1.3
    assert power(noise) == pytest.approx(expected, rel=POWER)
    # Both components alike and uncorrelated: E[n^2] = 0, with a deviation of 1/sqrt(n) again.
    assert abs((noise.astype(complex) ** 2).mean()) < expected * POWER
    # Neighbours along each axis have nothing in common.
    for axis in range(3):
        shifted = np.roll(noise, 1, axis=axis)
        assert abs((noise.conj() * shifted).mean(dtype=complex)) < expected * POWER


def test_noise_is_relative_to_the_given_reference(target):
    silent = impair(zeros(), snr_db=20, reference_power=4.0)
    assert power(silent.data) == pytest.approx(0.04, rel=POWER)
    with pytest.raises(ModelError, match="reference_power"):
        impair(zeros(), snr_db=20)


def test_seeds_and_frames_reproduce_and_differ(target):
    settings: dict[str, Any] = {"snr_db": 20, "drift_phase_rad": 0.1}
    one = impair(target, seed=2**63 + 1, frame=3, **settings).data
    np.testing.assert_array_equal(one, impair(target, seed=2**63 + 1, frame=3, **settings).data)
    for seed, frame in ((1, 3), (2**63 + 1, 4)):
        assert not (impair(target, seed=seed, frame=frame, **settings).data == one).any()


def test_streams_of_parts_seeds_and_frames_are_independent():
    draws = [
        random_stream(seed, part, frame).integers(2**63, size=1000)
        for seed in (0, 1)
        for part in DRAWN
        for frame in (0, 1)
    ]
    assert len(np.unique(draws)) == np.size(draws)


def test_phases_do_not_depend_on_the_spread_of_gains():
    one = draw_channels(ARRAY, SWEEP, seed=4)
    two = draw_channels(ARRAY, SWEEP, seed=4, gain_db=0, delay_s=0, dead_rx=[1])
    np.testing.assert_allclose(np.angle(two.tx_gain), np.angle(one.tx_gain), atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(two.rx_gain == 0), [1])
    np.testing.assert_allclose(abs(two.tx_gain), 1, rtol=1e-12)


def test_channel_factors_are_those_of_the_record(target):
    channels = draw_channels(ARRAY, SWEEP, seed=9, dead_rx=[7])
    found = impair(target, channels=channels).data
    turns = -2j * np.pi * (SWEEP.frequencies_hz - 77e9)
    tx = channels.tx_gain[:, None] * np.exp(turns * channels.tx_delay_s[:, None])
    rx = channels.rx_gain[:, None] * np.exp(turns * channels.rx_delay_s[:, None])
    close(found, target.data.astype(complex) * tx[:, None] * rx)
    assert not found[:, 7].any()


def test_drawn_channels_fill_their_ranges():
    many = small_array(4000, 3000)
    drawn = draw_channels(many, SWEEP, seed=1, gain_db=3, phase_rad=0.5, delay_s=20e-12)
    assert drawn.reference_hz == 77e9
    for gain, delay in ((drawn.tx_gain, drawn.tx_delay_s), (drawn.rx_gain, drawn.rx_delay_s)):
        for values, limit in (
            (20 * np.log10(abs(gain)), 3.0), (np.angle(gain), 0.5), (delay, 20e-12)
        ):  # fmt: skip
            assert (abs(values) <= limit * (1 + 1e-12)).all()
            # Uniform within +-1: mean 0, mean square 1/3; deviations sqrt(1/3n) and sqrt(4/45n).
            n = len(values)
            assert abs(values.mean()) < 5 * limit / np.sqrt(3 * n)
            assert abs((values**2).mean() / limit**2 - 1 / 3) < 5 * np.sqrt(4 / 45 / n)


@pytest.mark.parametrize(
    ("gain_db", "phase_rad"), [(1.0, 0.0), (0.0, 0.1), (np.linspace(-1, 1, 20), -0.2)]
)
def test_iq_imbalance_distorts_the_quadrature(target, gain_db, phase_rad):
    found = impair(target, iq_gain_db=gain_db, iq_phase_rad=phase_rad).data
    theta, size = np.angle(target.data.astype(complex)), abs(target.data.astype(complex))
    gain = 10 ** (np.broadcast_to(gain_db, ARRAY.n_rx)[:, None] / 20)  # of each receiver
    q = gain * np.sin(theta + phase_rad)
    close(found, size * (np.cos(theta) + 1j * q))


def test_coupling_follows_the_distance_of_the_antennas(target):
    added = impair(target, coupling_db=6, coupling_delay_s=50e-12).data.astype(complex)
    added -= target.data
    assert power(added) == pytest.approx(10**0.6, rel=1e-6)
    distance_m = np.linalg.norm(ARRAY.tx_m[:, None] - ARRAY.rx_m, axis=2)[..., None]
    delay_s = distance_m / C + 50e-12
    expected = np.exp(-2j * np.pi * SWEEP.frequencies_hz * delay_s) / distance_m
    ratio = added / expected
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=2e-6)  # target and coupling were rounded
    assert abs(np.angle(ratio.mean())) < 1e-6


def test_a_wall_is_an_image_source():
    # Oblique, so that the closed form needs more than a sign: reflect by hand at 0.6 z + 0.8 x = 1.
    wall = Wall([1.25, 5.0, 0.0], [0.8, 0.0, 0.6], -2.0)
    data = room_capture(ARRAY, SWEEP, [wall]).data.astype(complex)
    assert power(data) == pytest.approx(4.0, rel=1e-6)
    tx, rx = ARRAY.tx_m[3], ARRAY.rx_m[11]
    # The point of reflection by Fermat: the shortest way over the wall, searched for in the plane.

    def length(uv: np.ndarray) -> float:
        at = np.array([0.8, 0, 0.6]) + uv[0] * np.array([-0.6, 0, 0.8]) + uv[1] * np.eye(3)[1]
        return float(np.linalg.norm(at - tx) + np.linalg.norm(at - rx))

    shortest_m = minimize(length, [0.0, 0.0], tol=1e-14).fun
    phase = np.angle(-data[3, 11] / np.exp(-2j * np.pi * SWEEP.frequencies_hz * shortest_m / C))
    # At a minimum 1e-8 off (the limit of a search by values) the length is good to 1e-16 m; the
    # search ends at 1e-6, hence 1e-12 m: 2e-9 rad. The phase of complex64 is good to 1e-7.
    np.testing.assert_allclose(phase, 0, atol=1e-6)


def test_room_points_are_point_targets():
    data = room_capture(ARRAY, SWEEP, [], points_m=[[0.01, 0.02, 0.3]], point_amplitudes=[2j]).data
    close(data, 2j * point([0.01, 0.02, 0.3]).data.astype(complex))


def test_room_adds_up_and_passes_the_channels(target):
    room = room_capture(ARRAY, SWEEP, [Wall([0, 0, 1], [0, 0, 1])])
    close(impair(target, room=room).data, target.data.astype(complex) + room.data)
    channels = draw_channels(ARRAY, SWEEP)
    alone = impair(zeros(), room=room, channels=channels).data
    close(alone, impair(room, channels=channels).data.astype(complex))


def test_frames_of_a_drift_may_be_asked_for_in_any_order(target):
    frames = [0, 1, 700, 703]
    ascending = [impair(target, seed=5, frame=m, drift_phase_rad=0.1).data for m in frames]
    channel_errors._WALKS.clear()
    for m, data in reversed([*zip(frames, ascending, strict=True)]):
        again = impair(target, seed=5, frame=m, drift_phase_rad=0.1).data
        np.testing.assert_array_equal(again, data)


def test_frame_zero_has_not_drifted(target):
    names = ("drift_phase_rad", "drift_gain_db", "drift_common_phase_rad")
    drift: dict[str, Any] = dict.fromkeys(names, 1.0)
    np.testing.assert_array_equal(impair(target, **drift).data, target.data)
    assert not (impair(target, frame=1, **drift).data == target.data).any()


def test_drift_is_a_walk_of_factors_per_channel(target):
    many = small_array(2000, 2000)
    steps: dict[str, float] = {"phase_rad": 0.01, "gain_db": 0.02, "common_phase_rad": 0.0}
    factors = [drift_factors(many, seed=1, frame=m, **steps) for m in (4, 5, 20)]
    for side in (0, 1):
        before, after, late = (f[side] for f in factors)
        step = after / before
        n = len(step)
        # The deviation of n normal numbers is known to 1/sqrt(2n) of itself.
        spread = 5 / np.sqrt(2 * n)
        assert np.angle(step).std() == pytest.approx(0.01, rel=spread)
        assert (20 * np.log10(abs(step))).std() == pytest.approx(0.02, rel=spread)
        assert np.angle(late).std() == pytest.approx(0.01 * np.sqrt(20), rel=spread)
    common = drift_factors(many, seed=1, frame=5, phase_rad=0.0, gain_db=0.0, common_phase_rad=0.3)
    assert np.ptp(np.angle(common[0])) == 0
    assert common[0][0] != 1
    np.testing.assert_array_equal(common[1], 1)
    tx, rx = drift_factors(ARRAY, seed=8, frame=3, **steps)
    found = impair(target, seed=8, frame=3, drift_phase_rad=0.01, drift_gain_db=0.02).data
    close(found, tx[:, None, None] * rx[:, None] * target.data.astype(complex))


def test_quantisation_rounds_to_steps_and_clips(target):
    found = impair(target, adc_bits=4, adc_full_scale=0.8).data
    step = 0.1
    for got, want in ((found.real, target.data.real), (found.imag, target.data.imag)):
        codes = got / step
        np.testing.assert_allclose(codes, np.rint(codes), atol=1e-5)
        assert (codes.min(), codes.max()) == (pytest.approx(-8), pytest.approx(7))
        inside = (want > -0.8) & (want < 0.7)
        assert abs(got - want)[inside].max() <= step / 2 * (1 + 1e-6)
    assert not impair(zeros(), adc_bits=8).data.any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seed": 2**64}, "seed"),
        ({"frame": 1.5}, "frame"),
        ({"snr_db": 1e6}, "snr_db"),
        ({"reference_power": 0.0}, "reference_power"),
        ({"coupling_delay_s": 1e-9}, "coupling_db"),
        ({"drift_phase_rad": -0.1}, "drift_phase_rad"),
        ({"drift_gain_db": 250.0, "frame": 100}, "drift_gain_db"),
        ({"iq_gain_db": [1.0, 2.0]}, "iq_gain_db"),
        ({"iq_phase_rad": 4.0}, "iq_phase_rad"),
        ({"adc_bits": 1}, "adc_bits"),
        ({"adc_full_scale": 1.0}, "adc_bits"),
        ({"adc_bits": 8, "adc_full_scale": -1.0}, "adc_full_scale"),
        ({"channels": 1.0}, "ChannelResponse"),
        ({"channels": draw_channels(small_array(3, 20), SWEEP)}, "3, 20"),
        ({"room": "walls"}, "Capture"),
        ({"coupling_db": 290.0, "reference_power": 1e300}, "finite numbers"),
    ],
)
def test_invalid_settings_are_refused(target, settings, message):
    with pytest.raises(ModelError, match=message):
        impair(target, **settings)


def test_a_room_of_another_radar_is_refused(target):
    for array, sweep in ((small_array(24, 19), SWEEP), (ARRAY, Waveform.sfcw(72e9, 81e9, 64))):
        room = room_capture(array, sweep, [Wall([0, 0, 1], [0, 0, 1])])
        with pytest.raises(ModelError, match="impair: room"):
            impair(target, room=room)
    one_place = AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    with pytest.raises(ModelError, match="apart"):
        impair(Capture(np.ones((1, 1, 64)), one_place, SWEEP), coupling_db=0)


TWO_OF_ONE: dict[str, Any] = {"points_m": [[0, 0, 1.0]], "point_amplitudes": [1.0, 2.0]}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Wall([0, 0, 1], [0, 0, 0]), "normal"),
        (lambda: room_capture(ARRAY, SWEEP, []), "at least one"),
        (lambda: room_capture(ARRAY, SWEEP, [Wall([0, 0, 0], [1, 0, 0])]), "one side"),
        (lambda: room_capture(ARRAY, SWEEP, [], **TWO_OF_ONE), "point_amplitudes"),
        (lambda: draw_channels(ARRAY, SWEEP, gain_db=-1), "gain_db"),
        (lambda: draw_channels(ARRAY, SWEEP, dead_tx=[24]), "dead_tx"),
        (lambda: clradar.draw_channels("array", SWEEP), "AntennaArray"),
    ],
)
def test_invalid_rooms_and_channels_are_refused(call, message):
    with pytest.raises(ModelError, match=message):
        call()
