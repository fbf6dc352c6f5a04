"""Diagnosis of conventions: each of the eight is found, up to symmetries of array and scene."""

import json
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from command_line import Cli
from matplotlib.figure import Figure
from nightly import nightly

import clradar
from calibration import Hypothesis, apply_convention, diagnose
from clradar import AntennaArray, Capture, VoxelGrid, Waveform, reference
from clradar.errors import ModelError
from measurement_io import open_capture, save_capture

C = 299_792_458.0
QAR50 = clradar.arrays.qar50()
SHORT = Waveform.sfcw(72e9, 82e9, 64)

LINE = np.r_[0:47:6, 46]
THIN = AntennaArray(QAR50.tx_m[np.r_[LINE, 47 + LINE]], QAR50.rx_m[np.r_[LINE, 47 + LINE]], "thin")
"""18 x 18 of the imager's antennas, with the four end elements."""


def scattered(n_tx: int, n_rx: int) -> AntennaArray:
    """Antennas without any symmetry."""
    rng = np.random.default_rng(4)
    tx, rx = (np.c_[rng.uniform(-0.07, 0.07, (n, 2)), np.zeros(n)] for n in (n_tx, n_rx))
    return AntennaArray(tx, rx)


def points(array: AntennaArray, n: int, waveform: Waveform = SHORT) -> Capture:
    rng = np.random.default_rng(3)
    where = rng.uniform([-0.07, -0.07, 0.28], [0.07, 0.07, 0.34], (n, 3))
    return reference.point_targets(array, waveform, where, np.ones(n))


def noise(capture: Capture, seed: int = 0) -> np.ndarray:
    """Circular Gaussian, as strong as the capture or of variance 1 where it is zero."""
    rng = np.random.default_rng(seed)
    rms = np.sqrt((np.abs(capture.data) ** 2).mean()) or 1.0
    re, im = rng.normal(size=(2, *capture.data.shape))
    return rms * (re + 1j * im) / np.sqrt(2)


def coupling(capture: Capture) -> np.ndarray:
    """Straight from Tx to Rx, 30 times as strong as the echo where antennas are 5 cm apart."""
    array = capture.array
    path_m = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)[..., None]
    rms = np.sqrt((np.abs(capture.data) ** 2).mean())
    k = 2 * np.pi * capture.waveform.frequencies_hz / C
    return 30 * rms * (0.05 / path_m) * np.exp(-1j * k * path_m)


def made(name: str, array: AntennaArray) -> Capture:
    if name == "one point":
        return reference.point_targets(array, SHORT, [[0.03, -0.05, 0.3]], [1.0])
    if name == "points in noise of 0 dB":
        clean = points(array, 5)
        return replace(clean, data=clean.data + noise(clean))
    clean = points(array, 3)
    return replace(clean, data=clean.data + coupling(clean) + 0.3 * noise(clean))


SCENES = ("one point", "points in noise of 0 dB", "points and coupling")

ALL = [Hypothesis(*flags) for flags in product((False, True), repeat=4)]


def unmirrored(h: Hypothesis) -> Hypothesis:
    return replace(h, mirrored=False)


def swapped_too(h: Hypothesis) -> set[Hypothesis]:
    return {replace(h, swapped=s, mirrored=False) for s in (False, True)}


# --- the conventions themselves


def written(h: Hypothesis, point_m: np.ndarray, array: AntennaArray, tx: int, rx: int) -> complex:
    """From the definitions: the first sample of one entry of a file, of one point."""
    if h.swapped:
        tx, rx = rx, tx
    x = np.array([-1.0 if h.mirrored else 1.0, 1.0, 1.0])
    segments_m = [float(np.linalg.norm(point_m - a * x)) for a in (array.tx_m[tx], array.rx_m[rx])]
    f = SHORT.frequencies_hz[-1 if h.reversed else 0]
    return complex(np.exp((1j if h.conjugated else -1j) * 2 * np.pi * f * sum(segments_m) / C))


# complex64 phases of a unit phasor, formed in float64: rounding of either part.
ROUNDING = 2e-7


@pytest.mark.parametrize("h", ALL, ids=lambda h: h.label)
def test_undoing_gives_the_capture_of_the_definition(h):
    array, point_m = scattered(5, 5), np.array([0.03, -0.05, 0.3])
    # The file has these positions, and data according to the hypothesis.
    file = np.zeros((5, 5, SHORT.n_freq), dtype=complex)
    for tx, rx in product(range(5), repeat=2):
        file[tx, rx, 0] = written(h, point_m, array, tx, rx)
    fixed = apply_convention(Capture(file, array, SHORT), h)
    at = -1 if h.reversed else 0
    f = SHORT.frequencies_hz[at]
    segments_m = [np.linalg.norm(point_m - a, axis=1) for a in (fixed.array.tx_m, fixed.array.rx_m)]
    want = np.exp(-2j * np.pi * f * (segments_m[0][:, None] + segments_m[1][None]) / C)
    assert np.abs(fixed.data[..., at] - want).max() <= ROUNDING


# --- diagnoses


# Of all sixteen two that take all choices both ways, and nightly six in which every two choices
# occur in all four combinations.
@pytest.mark.parametrize(
    ("h", "scene"),
    [
        *zip(ALL[5:11:5], SCENES[1:], strict=True),
        *nightly((h, scene) for scene in SCENES for h in ALL[::3]),
    ],
    ids=lambda value: getattr(value, "label", value),
)
def test_an_array_without_symmetry_leaves_the_mirror_image_only(h, scene, device):
    result = diagnose(apply_convention(made(scene, scattered(16, 16)), h), device=device)
    assert result.candidates == (unmirrored(h),)
    assert result.decided
    assert not result.mirror_known
    assert "only a known target tells" in result.recommendation


def test_the_imagers_symmetry_leaves_swapped_axes(device):
    """A mirror at the diagonal maps nearly every Tx on an Rx: both images are as sharp."""
    h = Hypothesis(swapped=True, conjugated=True)
    capture = apply_convention(made("one point", THIN), h)
    result = diagnose(capture, device=device)
    assert set(result.candidates) == swapped_too(h)
    assert result.best == Hypothesis(conjugated=True)  # the least that has to be changed
    assert not result.decided
    known = diagnose(capture, expected_m=(0.035, -0.06, 0.31), device=device)
    assert known.candidates == (h,)


def test_unequal_numbers_of_antennas_rule_swapped_axes_out(device):
    """Also of antennas that are not at z = 0."""
    h, at_m = Hypothesis(reversed=True), np.array([0.03, -0.05, 0.05])
    array = scattered(12, 10)
    moved = AntennaArray(*(side - np.array([0, 0, 0.25]) for side in (array.tx_m, array.rx_m)))
    capture = reference.point_targets(moved, SHORT, [at_m], [1.0])
    result = diagnose(apply_convention(capture, h), device=device)
    assert result.candidates == (h,)
    assert [score.hypothesis.swapped for score in result.scores] == [False] * 4
    (score,) = (score for score in result.scores if score.hypothesis == h)
    grid_m = 0.01  # half the diagonal of a voxel of the coarse grid, generously
    assert np.linalg.norm(score.peak_m - at_m) < grid_m
    row, column = np.unravel_index(score.image.amplitude.argmax(), score.image.amplitude.shape)
    drawn_m = score.image.x_m[column], score.image.y_m[row]
    assert np.abs(drawn_m - at_m[:2]).max() < grid_m


@pytest.mark.parametrize(
    ("waveform", "h", "candidates"),
    [
        (Waveform([77e9]), Hypothesis(conjugated=True), 2),  # a single one has no order
        # 2 GHz resolve ranges 15 cm apart, and tell signs, but no order.
        (Waveform.sfcw(76e9, 78e9, 3), Hypothesis(reversed=True), None),
    ],
)
def test_few_frequencies_need_a_grid(waveform, h, candidates, device):
    capture = reference.point_targets(scattered(12, 12), waveform, [[0.03, -0.05, 0.3]], [1.0])
    grid = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), (4e-3, 4e-3, 2e-2))
    result = diagnose(apply_convention(capture, h), grid=grid, device=device)
    assert h in result.candidates
    assert candidates is None or (result.best, len(result.candidates)) == (h, candidates)
    with pytest.raises(ModelError, match=rf"a grid, since .* \({waveform.n_freq}\) show"):
        diagnose(capture, device=device)


def test_antennas_are_left_out_where_a_grid_is_large(device, monkeypatch):
    monkeypatch.setattr(sys.modules[diagnose.__module__], "MOST_TERMS", 2e8)
    h = Hypothesis(conjugated=True)
    assert diagnose(apply_convention(made("one point", THIN), h), device=device).best == h


def test_where_both_orders_are_alike_neither_is_chosen(device):
    # At half the ambiguous path the delays of either sign are alike: 0.95 m for 64 steps.
    capture = reference.point_targets(THIN, SHORT, [[0.02, 0.03, 0.46]], [1.0])
    result = diagnose(apply_convention(capture, Hypothesis(conjugated=True)), device=device)
    assert result.best is None
    assert {(c.conjugated, c.reversed) for c in result.candidates} == {(True, False), (True, True)}


def test_what_is_undecidable_is_said_to_be(device):
    array = scattered(12, 12)
    one = made("one point", array)
    zero = replace(one, data=0 * one.data)
    rng = np.random.default_rng(1)
    tx, rx = (np.exp(2j * np.pi * rng.random(12)) for _ in range(2))
    captures = {
        "zero": zero,
        "coupling in noise": replace(one, data=coupling(one) + noise(one)),
        "channels without calibration": replace(
            one, data=one.data * tx[:, None, None] * rx[:, None]
        ),
        "a pair of antennas": made("one point", AntennaArray([[0, 0, 0]], [[0.01, 0, 0]])),
        "noise": replace(zero, data=noise(zero)),
    }
    for name, capture in captures.items():
        result = diagnose(capture, device=device)
        assert (result.best, result.decided) == (None, False), name
        assert result.recommendation.startswith("Undecidable"), name
        assert "not calibrated" in result.recommendation or not name.startswith("channels")


# --- expected positions, grids


def test_a_known_target_decides_the_mirror(device):
    h = Hypothesis(conjugated=True, mirrored=True)
    capture = apply_convention(made("one point", scattered(12, 12)), h)
    near = diagnose(capture, expected_m=(0.035, -0.06, 0.31), device=device)
    assert (near.candidates, near.mirror_known) == ((h,), True)
    # Its own mirror image, and a place where nothing is.
    for place in ((0.0, -0.05, 0.3), (0.05, 0.2, 0.6)):
        other = diagnose(capture, expected_m=place, device=device)
        assert (other.candidates, other.mirror_known) == ((unmirrored(h),), False)
        assert "does not tell" in other.recommendation


def test_a_known_target_decides_the_mirror_of_antennas_in_a_line(device):
    line = AntennaArray(*(side * [1.0, 0.0, 0.0] for side in (THIN.tx_m, THIN.rx_m)))
    capture = apply_convention(made("one point", line), Hypothesis(mirrored=True))
    assert diagnose(capture, expected_m=(0.035, -0.06, 0.31), device=device).best.mirrored


def test_wrong_arguments(device):
    capture = made("one point", scattered(5, 4))
    for place, message in (((0, 0, -0.3), "z > 0"), ((0, 0.3), "shape")):
        with pytest.raises(ModelError, match=message):
            diagnose(capture, expected_m=place, device=device)
    with pytest.raises(ModelError, match="5 Tx and 4 Rx"):
        apply_convention(capture, Hypothesis(swapped=True))


# --- command line


@pytest.fixture
def files(cli: Cli, device: clradar.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLRADAR_DEVICE", device.info.selector)
    h = Hypothesis(swapped=True, conjugated=True, mirrored=True)
    wrong = apply_convention(made("one point", scattered(12, 12)), h)
    save_capture("wrong.h5", Capture(wrong.data, wrong.array, wrong.waveform))
    save_capture("zero.h5", Capture(0 * wrong.data, wrong.array, wrong.waveform))


@pytest.mark.usefixtures("files")
def test_command(cli, monkeypatch):
    drawn = []  # the figure would take most of the time
    monkeypatch.setattr("clradar.plot.panels_figure", lambda *a: drawn.append(a) or Figure())
    options = "-o all.png --json all.json --fix-to fixed.h5 --expect-mm 30,-50,300"
    out = cli.ok(f"diagnose wrong.h5 {options}").out
    assert "exp(+j 2 pi f d / c)" in out
    assert "the axes are [rx, tx, freq]" in out
    ((rows, _),) = drawn
    assert sum(map(len, rows)) == 8
    record = json.loads(Path("all.json").read_text())
    assert record["best"] == "swapped, conjugated, mirrored"
    assert len(record["hypotheses"]) == 8
    right, want = open_capture("fixed.h5"), made("one point", scattered(12, 12))
    assert np.array_equal(right.data, want.data)
    assert np.array_equal(right.array.tx_m, want.array.tx_m)
    assert right.meta["conventions_applied"] == ["swapped, conjugated, mirrored"]
    outcome = cli.ok("diagnose wrong.h5 --fix-to fixed.h5 --force")
    assert "the mirror image cannot be ruled out" in outcome.err
    assert "x may be mirrored" in outcome.out


@pytest.mark.usefixtures("files")
def test_command_on_undecidable_captures(cli):
    outcome = cli.ok("diagnose zero.h5 -o none.png")
    assert "Undecidable: the capture is zero everywhere" in outcome.out
    assert "not drawn" in outcome.err
    cli.fails("diagnose zero.h5 --fix-to fixed.h5")
    assert {path.name for path in Path().iterdir()} == {"wrong.h5", "zero.h5"}
