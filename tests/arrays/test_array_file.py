"""Files of antenna arrays: every rule, poses, patterns, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

import clradar
from clradar.arrays import qar50, read_array
from clradar.arrays.array_file import array_of, array_record, array_text
from clradar.errors import ClradarWarning, MeasurementError

LINE = "line = { first_m = [-0.03, 0, 0], last_m = [0.03, 0, 0], n = 4 }"


def read(tmp_path: Path, text: str) -> clradar.AntennaArray:
    path = tmp_path / "lab.toml"
    path.write_text(text, encoding="utf-8")
    return read_array(path)


def test_every_rule_places_antennas(tmp_path):
    said = "mixed: antennas at the same place all count, 16 Rx at 14 places"
    text = f"""
        name = "mixed"
        [[tx]]
        {LINE}
        [[tx]]
        points_m = [[0, 0.05, 0], [0, 0.06, 0]]
        [[rx]]
        cross = {{ length_m = 0.04, n = 3, center_m = [0.1, 0, 0] }}
        [[rx]]
        plane = {{ size_m = [0.02, 0.04], n = [3, 2] }}
        [[rx]]
        ring = {{ radius_m = 0.02, n = 4, first_deg = 90 }}
        [[antennas]]
        points_m = [[0.2, 0.2, 0]]
        """
    with pytest.warns(ClradarWarning, match=said):
        array = read(tmp_path, text)
    assert array.name == "mixed"
    line = [[-0.03, 0, 0], [-0.01, 0, 0], [0.01, 0, 0], [0.03, 0, 0]]
    both = [0.2, 0.2, 0]
    np.testing.assert_allclose(array.tx_m, [*line, [0, 0.05, 0], [0, 0.06, 0], both], atol=1e-15)
    cross = [[0.08, 0, 0], [0.1, 0, 0], [0.12, 0, 0], [0.1, -0.02, 0], [0.1, 0.02, 0]]
    plane = [[x, y, 0] for y in (-0.02, 0.02) for x in (-0.01, 0, 0.01)]
    ring = [[0, 0.02, 0], [-0.02, 0, 0], [0, -0.02, 0], [0.02, 0, 0]]
    np.testing.assert_allclose(array.rx_m, [*cross, *plane, *ring, both], atol=1e-15)
    even = read(tmp_path, "[[antennas]]\ncross = { length_m = 0.03, n = 4 }")
    assert even.n_tx == even.n_rx == 8  # which has no middle


def test_poses_place_copies_of_a_known_array(tmp_path):
    array = read(
        tmp_path,
        """
        copy_of = "qar50"
        [[pose]]
        plane = { size_m = [0.2, 0], n = [2, 1] }
        [[pose]]
        points_m = [[0, 0.3, 0]]
        rotation_deg = [0, 0, 90]
        """,
    )
    one = qar50()
    assert (array.n_tx, array.n_rx) == (3 * 94, 3 * 94)
    np.testing.assert_allclose(array.tx_m[:94], one.tx_m - np.array([0.1, 0, 0]))
    np.testing.assert_allclose(array.tx_m[94:188], one.tx_m + np.array([0.1, 0, 0]))
    turned = np.stack([-one.rx_m[:, 1], one.rx_m[:, 0] + 0.3, one.rx_m[:, 2]], axis=1)
    np.testing.assert_allclose(array.rx_m[188:], turned, atol=1e-15)


def test_gains_and_boresights_of_single_antennas(tmp_path):
    array = read(
        tmp_path,
        f"""
        [[tx]]
        {LINE}
        gain_db = [0, -6, 0, -20]
        phase_deg = 90
        [[tx]]
        points_m = [[0, 0, 0]]
        [[rx]]
        {LINE}
        boresight = [0, 0.6, 0.8]
        [rx_pattern]
        exponent = 2
        [[pose]]
        points_m = [[0, 0, 0]]
        rotation_deg = [0, 90, 0]
        """,
    )
    level = 10 ** (np.array([0, -6, 0, -20]) / 20)
    np.testing.assert_allclose(array.tx_gain, [*1j * level, 1], atol=1e-15)
    np.testing.assert_allclose(array.rx_boresight, np.tile([0.8, 0.6, 0], (4, 1)), atol=1e-15)
    assert array.rx_gain is None
    assert array.rx_pattern == clradar.AntennaPattern(exponent=2.0)
    assert array.tx_boresight is None  # without a pattern nothing depends on it
    again = array_of(array_record(array), "record", "another")
    assert_same(again, array)
    (tmp_path / "again.toml").write_text(array_text(array), encoding="utf-8")
    assert_same(read_array(tmp_path / "again.toml"), array)
    part = array.part([0, 1, 4], slice(2), "part")
    np.testing.assert_array_equal(part.tx_gain, array.tx_gain[[0, 1, 4]])
    assert part.rx_boresight.shape == (2, 3)


def assert_same(got: clradar.AntennaArray, want: clradar.AntennaArray) -> None:
    assert (got.name, got.tx_pattern, got.rx_pattern) == (
        want.name, want.tx_pattern, want.rx_pattern
    )  # fmt: skip
    for name in ("tx_m", "rx_m", "tx_gain", "rx_gain", "tx_boresight", "rx_boresight"):
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"tx: expected \[\[tx\]\] or \[\[antennas\]\]"),
        ("[[antennas]]\n", "antennas\\[0\\]: expected one of points_m, line.* got none"),
        (f"[[antennas]]\n{LINE}\npoints_m = [[0, 0, 0]]", "got points_m and line"),
        (f"antenas = 1\n[[antennas]]\n{LINE}", "antenas: unknown key.*did you mean 'antennas'"),
        ("[[antennas]]\nline = { first_m = [0, 0, 0], n = 3 }", "line.last_m: expected .*metres"),
        ("[[antennas]]\nring = { radius_m = -1, n = 3 }", "radius_m: expected a length above 0"),
        ("[[antennas]]\nring = { radius_m = 1, n = 3.5 }", "n: expected a whole number"),
        ("[[antennas]]\npoints_m = [[0, 0]]", "rows of three numbers, got rows of 2"),
        ("[[antennas]]\nplane = { size_m = [1, 1], n = [1000, 1000] }", "at most 20000 antennas"),
        ("[[antennas]]\nplane = { size_m = [1, 1], n = [1, 99999] }", "n_y., each a whole"),
        ("[[antennas]]\nplane = { n = [3, 3] }", "plane.size_m: expected .width, height."),
        ("[[antennas]]\nring = { radius_m = 70, n = 9 }", "an aperture"),
        ('copy_of = "qar5"', "one of .*did you mean 'qar50'"),
        (f'copy_of = "qar50"\n[[tx]]\n{LINE}', "copy_of: expected no tx, rx, antennas beside"),
        ('copy_of = "qar50"\npose = 3', r"pose: expected tables \[\[pose\]\]"),
        (f"[[antennas]]\n{LINE}\ngain_db = {2**64}", "tx_gain: expected finite numbers, got"),
        (f"[[antennas]]\n{LINE}\ngain_db = [1, 2]", "gain_db: expected one number, or one for"),
        (f"[[antennas]]\n{LINE}\nboresight = [0, 1]", "boresight: expected one row of 3 num"),
        (f"[[antennas]]\n{LINE}\nboresight = [0, 1, 0]", r"tx: expected \[tx_pattern\]"),
        (f"[[antennas]]\n{LINE}\ngain = [1, 0]\ngain_db = 3", "no gain_db and no phase_deg"),
        ('copy_of = "qar50"\npairs = "some"', "pairs: expected one of .all., .cluster."),
        (f'copy_of = "qar50"\npairs = "cluster"\n[[pose]]\n{LINE}', r"pairs: .* got 4 clusters"),
        ('copy_of = "qar50"\n[tx_pattern]\nexponent = -1', "tx_pattern.exponent: expected 0 to"),
        ("copy_of =", "expected an antenna array"),
    ],
)
def test_one_error_names_the_file_and_the_key(tmp_path, text, words):
    with pytest.raises(MeasurementError, match=rf"(?s)lab\.toml: .*{words}"):
        read(tmp_path, text)
