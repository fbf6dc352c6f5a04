"""Arrays: files of every rule, poses and patterns; widths and lobes against closed forms."""

from pathlib import Path

import numpy as np
import pytest

import clradar
from clradar.arrays import array_figures, qar50, read_array
from clradar.arrays.array_file import array_of, array_record, array_text
from clradar.arrays.lobes import ghosts
from clradar.arrays.point_spread import response
from clradar.constants import SPEED_OF_LIGHT_M_PER_S as C
from clradar.errors import ClradarWarning, MeasurementError, ModelError
from clradar.plot.array import array_figure

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
        ("[[antennas]]\nplane = { size_m = [140, 0], n = [9, 1] }", "an aperture"),
        ('copy_of = "qar5"', "one of .*did you mean 'qar50'"),
        (f'copy_of = "qar50"\n[[tx]]\n{LINE}', "copy_of: expected no tx, rx, antennas beside"),
        ('copy_of = "qar50"\npose = 3', r"pose: expected tables \[\[pose\]\]"),
        (f"[[antennas]]\n{LINE}\ngain_db = {2**64}", "tx_gain: expected finite numbers, got"),
        (f"[[antennas]]\n{LINE}\ngain_db = [1, 2]", "gain_db: expected a number, or one for"),
        (f"[[antennas]]\n{LINE}\nboresight = [0, 1]", "boresight: expected a row of 3 num"),
        (f"[tx_pattern]\n[[rx]]\n{LINE}\n[[tx]]\n{LINE}\nboresight = [0, 1e200, 0]", "inf"),
        (f"[[antennas]]\n{LINE}\nboresight = [0, 1, 0]", r"tx: expected \[tx_pattern\]"),
        (f"[[antennas]]\n{LINE}\ngain = [1, 0]\ngain_db = 3", "no gain_db and no phase_deg"),
        ('copy_of = "qar50"\npairs = "some"', "pairs: expected one of .all., .cluster."),
        (f'copy_of = "qar50"\npairs = "cluster"\n[[pose]]\n{LINE}', r"pairs: .* got 4 clusters"),
        ('copy_of = "qar50"\n[tx_pattern]\nexponent = -1', r"tx_pattern.exponent: .*\[0, 10000\]"),
        ("copy_of =", "expected an antenna array"),
    ],
)
def test_one_error_names_the_file_and_the_key(tmp_path, text, words):
    with pytest.raises(MeasurementError, match=rf"(?s)lab\.toml: .*{words}"):
        read(tmp_path, text)


FAR_M = 20.0


def line(n: int, spacing_m: float) -> clradar.AntennaArray:
    """One Tx in the middle of n Rx along x."""
    rx_m = (np.arange(n) - (n - 1) / 2)[:, None] * [spacing_m, 0.0, 0.0]
    return clradar.AntennaArray([[0.0, 0.0, 0.0]], rx_m, name="line")


def wall(n: int, width_m: float) -> clradar.AntennaArray:
    """One Tx in the middle of n x n Rx."""
    x_m, y_m = np.meshgrid(*2 * [np.linspace(-width_m / 2, width_m / 2, n)])
    rx_m = np.stack([x_m.ravel(), y_m.ravel(), np.zeros(n * n)], axis=1)
    return clradar.AntennaArray([[0.0, 0.0, 0.0]], rx_m, name="wall")


def test_a_line_far_away_has_the_width_and_the_sidelobes_of_theory():
    """Balanis, Antenna Theory, chapter 6: sin(N x) / (N sin x), x = pi d / lambda * sine."""
    n, spacing_m, hz = 16, 2e-3, 75e9
    found = array_figures(
        line(n, spacing_m), clradar.Waveform.sfcw(hz, hz, 1), (0, 0, FAR_M), level_db=-14
    )
    x = np.linspace(1e-9, np.pi / n, 100_000)
    factor = np.abs(np.sin(n * x) / (n * np.sin(x)))
    half = x[np.argmax(factor < np.sqrt(0.5))] * C / hz / (np.pi * spacing_m)
    width_m = 2 * FAR_M * np.tan(np.arcsin(half))
    # Widths are interpolated between points 3 % apart.
    np.testing.assert_allclose(found.widths_m[0], width_m, rtol=2e-3)
    first = np.linspace(np.pi / n, 2 * np.pi / n, 100_000)
    levels = np.abs(np.sin(n * first) / (n * np.sin(first)))
    lobe = np.rad2deg(np.arcsin(first[levels.argmax()] * C / hz / (np.pi * spacing_m)))
    assert [abs(own.azimuth_deg) for own in found.lobes] == pytest.approx([lobe, lobe], abs=0.05)
    expected_db = 20 * np.log10(levels.max())
    assert [own.level_db for own in found.lobes] == pytest.approx(2 * [expected_db], abs=0.01)
    assert not any(own.grating for own in found.lobes)


def test_the_virtual_aperture_is_drawn_in_the_unit_of_its_axes():
    array, band = line(8, 6e-3), clradar.Waveform.sfcw(77e9, 77e9, 1)
    shown = array_figure(array, band, array_figures(array, band, (0, 0, 1))).axes[1]
    assert shown.get_xlabel().endswith("x (mm)")
    assert np.ptp(shown.lines[0].get_xdata()) == pytest.approx(21.0)


def test_a_lobe_along_y_has_no_azimuth():
    hz, n = 24e9, 8
    tx_m = np.roll(line(n, C / hz).rx_m, 1, axis=1)
    array = clradar.AntennaArray(tx_m, line(n, 0.45 * C / hz).rx_m)
    found = array_figures(array, clradar.Waveform.sfcw(hz, hz, 1), (0, 0, FAR_M), level_db=-1)
    angles = [(own.azimuth_deg, own.elevation_deg) for own in found.lobes]
    assert np.array(angles) == pytest.approx(np.array([[0, -90], [0, 90]]), abs=0.1)


@pytest.mark.parametrize(
    ("sine", "n", "spacing_m"),
    [(0.0, 12, 6e-3), (0.3, 12, 6e-3), pytest.param(0.0, 9, C / 75e9 / 0.994, id="horizon")],
)
def test_grating_lobes_are_where_the_grating_equation_has_them(sine, n, spacing_m):
    hz = 75e9
    focus_m = FAR_M * np.array([sine, 0.0, np.sqrt(1 - sine**2)])
    band = clradar.Waveform.sfcw(hz, hz, 1)
    found = array_figures(line(n, spacing_m), band, focus_m, level_db=-1)
    sines = sorted(s for m in (-2, -1, 1, 2) if abs(s := sine + m * C / hz / spacing_m) < 1)
    seen = sorted(np.sin(np.deg2rad(own.azimuth_deg)) for own in found.lobes if own.grating)
    assert seen == pytest.approx(sines, abs=2e-4)
    assert [own.level_db for own in found.lobes] == pytest.approx(len(sines) * [0.0], abs=0.01)


def test_arrays_of_a_band_have_the_lobes_and_the_range_of_theory():
    """A band of 2 %: sin = lambda / d at its middle, and the level of the sum over the band of the
    array factors there, which the lobe's own range makes as large as it can be."""
    hz, wavelengths, n = 24e9, 1.2, 8
    spacing_m = wavelengths * C / hz
    band = clradar.Waveform.sfcw(0.99 * hz, 1.01 * hz, 16)
    found = array_figures(line(n, spacing_m), band, (0, 0, FAR_M), level_db=-3)
    strongest = found.lobes[0]
    sine = abs(np.sin(np.deg2rad(strongest.azimuth_deg)))
    assert sine == pytest.approx(1 / wavelengths, abs=0.01)
    x_m = spacing_m * (np.arange(n) - (n - 1) / 2)
    phase = 2 * np.pi / C * np.outer(band.frequencies_hz - hz, x_m) / wavelengths
    level = np.abs(np.exp(1j * phase).mean())
    assert strongest.level_db == pytest.approx(20 * np.log10(level), abs=0.1)
    assert found.unambiguous_range_m == pytest.approx(C / (2 * 0.02 * hz / 15), rel=1e-9)


def test_the_width_in_range_is_that_of_the_band():
    """sinc: 0.886 c / (2 B), with B of the whole steps that the sum stands for."""
    one = clradar.AntennaArray([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]])
    band = clradar.Waveform.sfcw(72e9, 82e9, 32)
    found = array_figures(one, band, (0, 0, 0.5))
    steps_hz = band.span_hz * 32 / 31
    np.testing.assert_allclose(found.widths_m[2], 0.8859 * C / (2 * steps_hz), rtol=2e-3)
    assert found.unambiguous_range_m == band.unambiguous_range_m
    assert found.lobes == ()


def test_patterns_lower_the_lobes():
    """cos^1 of each side: the lobe at 60 degrees loses cos 60 of the Rx only, 6.0 dB."""
    hz = 75e9
    rows = line(12, C / hz / np.sin(np.deg2rad(60)))
    rx_only = clradar.AntennaArray(
        rows.tx_m, rows.rx_m, rx_pattern=clradar.AntennaPattern(gain_dbi=3.0, exponent=1.0)
    )
    band = clradar.Waveform.sfcw(hz, hz, 1)
    lobes = array_figures(rx_only, band, (0, 0, FAR_M), level_db=-7).lobes
    assert [own.level_db for own in lobes] == pytest.approx(2 * [20 * np.log10(0.5)], abs=0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"focus_m": (0, 0, -1)}, "focus_m: expected z above 0 m"),
        ({"level_db": 1}, r"level_db: .* in \[-1000, 0\] dB"),
        ({"array": None}, "array: expected"),
    ],
)
def test_bad_arguments_are_named(change, words):
    given: dict[str, object] = {
        "array": clradar.arrays.qar50(),
        "waveform": clradar.Waveform.sfcw(72e9, 82e9, 8),
        "focus_m": (0, 0, 0.3),
    }
    with pytest.raises(ModelError, match=words):
        array_figures(**{**given, **change})


def clusters(n: int, pitch_m: float) -> list[clradar.AntennaArray]:
    """Three Tx 6 mm apart, three Rx 2 mm apart, all along x; n times."""
    own = np.arange(-1, 2)[:, None] * [1.0, 0.0, 0.0]
    at_m = (np.arange(n) - (n - 1) / 2)[:, None] * [pitch_m, 0.0, 0.0]
    return [clradar.AntennaArray(6e-3 * own + at, 2e-3 * own + at, f"cluster {at}") for at in at_m]


def test_clusters_count_by_their_pairs():
    """Of 4 pairs and of 9: the sum over all of them, divided by 13."""
    both, band = [line(4, 3e-3), wall(3, 0.02)], np.array([70e9, 75e9])
    focus_m, at_m = np.array([0, 0, 0.3]), np.array([[0.01, 0.004, 0.29], [-0.02, 0, 0.3]])

    def lengths_m(place_m: np.ndarray) -> np.ndarray:
        pairs = [(one.tx_m[:, None], one.rx_m) for one in both]
        legs = [
            np.linalg.norm(place_m - tx, axis=2) + np.linalg.norm(place_m - rx, axis=1)
            for tx, rx in pairs
        ]
        return np.concatenate([leg.ravel() for leg in legs])

    off_m = np.array([lengths_m(place) - lengths_m(focus_m) for place in at_m])
    phasors = np.exp(2j * np.pi * off_m[..., None] * band / C)
    wanted = np.abs(phasors.mean(axis=(1, 2)))
    np.testing.assert_allclose(response(both, band, focus_m, at_m), wanted, atol=1e-5)


def test_clusters_have_the_lobes_of_their_pitch_below_the_pattern_of_each():
    """sin = m lambda / (2 pitch), since Tx and Rx are shifted; the level is one cluster's own."""
    n, pitch_m, hz = 3, 60e-3, 77e9
    band = clradar.Waveform.sfcw(hz, hz, 1)
    focus_m = (0.0, 0.0, 100.0)
    found = array_figures(clusters(n, pitch_m), band, focus_m, level_db=-7)
    k, sines = 2 * np.pi * hz / C, np.arange(1, 5) * C / hz / (2 * pitch_m)
    each = [np.abs(1 + 2 * np.cos(k * d * sines)) / 3 for d in (6e-3, 2e-3)]
    levels_db = 20 * np.log10(each[0] * each[1])
    right = sorted(
        (own for own in found.lobes if 0 < own.azimuth_deg < 8), key=lambda o: -o.level_db
    )
    assert np.sin(np.deg2rad([o.azimuth_deg for o in right])) == pytest.approx(sines, rel=0.01)
    assert [o.level_db for o in right] == pytest.approx(levels_db, abs=0.1)
    (searched,) = ghosts(clusters(n, pitch_m), band, np.array(focus_m), lambda p: p[:, 0] > 0)
    assert [o.level_db for o in searched] == pytest.approx(
        [o.level_db for o in right if o.level_db >= -3], abs=1e-3
    )


def test_a_focus_next_to_the_antennas_is_most_likely_in_another_unit():
    band, array = clradar.Waveform.sfcw(72e9, 82e9, 2), clradar.arrays.qar50()
    few = clradar.AntennaArray(array.tx_m[::12], array.rx_m[::12])
    with pytest.warns(clradar.ClradarWarning, match=r"focus is [\d.]+ mm .* if in inch, not mm"):
        array_figures(few, band, (0, 0, 3e-3))
    array_figures(few, band, (0, 0, 0.06))
