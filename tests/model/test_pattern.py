"""Antenna patterns: gain over angle, refused values, and where an array carries them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import clradar
from clradar import AntennaArray, AntennaPattern
from clradar.errors import ModelError
from clradar.model.range_profile import antenna_subset

# Cosines, roots and powers of float64, a few units in the last place.
ROUNDING = 1e-14
TABLE = {"angle_deg": [0.0, 90.0, 180.0], "field": [1.0, 0.5, 0.0]}


def cosines(*angles_deg: float) -> np.ndarray:
    return np.cos(np.deg2rad(angles_deg))


def test_power_of_the_cosine_is_zero_behind():
    pattern = AntennaPattern(gain_dbi=20.0, exponent=2.0)
    found = pattern.amplitude(np.array([[1.0, 0.5], [0.0, -0.5]]))
    assert np.allclose(found, [[10, 2.5], [0, 0]], atol=ROUNDING)


def test_table_is_linear_over_angle():
    found = AntennaPattern(gain_dbi=6.0, **TABLE).amplitude(cosines(0, 45, 90, 135, 180))
    assert np.allclose(found, 10**0.3 * np.array([1, 0.75, 0.5, 0.25, 0]), atol=10 * ROUNDING)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"gain_dbi": 200}, "gain_dbi: expected within 100 dB"),
        ({"exponent": -1}, "exponent: expected 0 to 10000, got -1"),
        ({"exponent": 1, **TABLE}, "exponent: expected 0 beside a table"),
        ({"angle_deg": [0, 180]}, "expected both or neither"),
        ({"angle_deg": [0, 90], "field": [1, 0]}, "from 0 to 180 degrees, got 0 to 90"),
        ({"angle_deg": [0, 90, 90, 180], "field": [1, 1, 1, 0]}, "strictly ascending"),
        ({**TABLE, "field": [1, 0]}, r"field: expected shape \(3,\)"),
        ({**TABLE, "field": [0, 0, 0]}, "amplitudes >= 0, not all of them 0"),
    ],
)
def test_refused(fields, message):
    with pytest.raises(ModelError, match=message):
        AntennaPattern(**fields)


def test_equal_by_value():
    patterns = [
        AntennaPattern(),
        AntennaPattern(gain_dbi=3),
        AntennaPattern(exponent=1),
        AntennaPattern(**TABLE),
        AntennaPattern(**{**TABLE, "field": [1.0, 0.5, 0.1]}),
    ]
    for i, one in enumerate(patterns):
        copy = pickle.loads(pickle.dumps(one))
        assert [copy == other for other in patterns] == [i == j for j in range(len(patterns))]
        assert hash(copy) == hash(one)
    assert AntennaPattern() != 1


def patterned() -> AntennaArray:
    q = clradar.arrays.qar50()
    return AntennaArray(
        q.tx_m[::12], q.rx_m[::12], "few", AntennaPattern(3.0, 1.0), AntennaPattern(**TABLE)
    )


def test_array_keeps_its_patterns():
    array = patterned()
    plain = replace(array, tx_pattern=None, rx_pattern=None)
    assert array.same_positions(plain)
    assert (plain.has_patterns, array.has_patterns) == (False, True)
    capture = clradar.Capture(np.ones((8, 8, 3)), array, clradar.Waveform.sfcw(72e9, 82e9, 3))
    part = array.part([True] * 4 + [False] * 4, slice(2))
    for other in (pickle.loads(pickle.dumps(array)), part, antenna_subset(capture, 16).array):
        assert other.name == "few"
        assert (other.tx_pattern, other.rx_pattern) == (array.tx_pattern, array.rx_pattern)
    assert part.tx_m.tolist() == array.tx_m[:4].tolist()
    assert part.rx_m.tolist() == array.rx_m[:2].tolist()


def test_estimators_without_patterns_refuse_them():
    scene = clradar.Scene([[0, 0, 0.3], [0.1, 0, 0.3], [0, 0.1, 0.3]], [[0, 1, 2]], alpha=0.0)
    array, waveform = patterned(), clradar.Waveform.sfcw(72e9, 82e9, 3)
    paths = clradar.Paths([0], [0], [0.6], [1.0], [1], n_tx=8, n_rx=8)
    for run in (
        lambda: clradar.simulate(scene, array, waveform),
        lambda: clradar.simulate(scene, array, waveform, estimator="expected"),
        lambda: clradar.trace(scene, array),
        lambda: clradar.synthesize(paths, array, waveform),
    ):
        with pytest.raises(ModelError, match="only estimator='physical' takes"):
            run()
