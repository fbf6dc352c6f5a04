"""Channel calibration: known errors are found, other targets and invalid arguments refused."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from comparisons import same_record
from matplotlib.figure import Figure
from nightly import nightly
from recorded_targets import DEAD_RX, DEAD_TX, HALF, QAR50, SMALL, Instrument, instrument

import clradar
from calibration import CornerReflector, FlatPlate, Sphere, correct, estimate_channels, response
from calibration.channels import figure
from calibration.channels.targets import Target
from calibration.clutter import range_gate
from clradar import AntennaArray, Capture, ChannelCalibration, Waveform
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import CalibrationError, MeasurementError, ModelError, OutputError
from measurement_io import (
    check_file,
    describe,
    open_capture,
    open_channels,
    save_capture,
    save_channels,
)

# Out of five standard deviations falls one of two million.
SIGMAS = 5.0

TRUE: dict[str, Target] = {
    "plate": FlatPlate(0.300, 0.8, -0.5),
    "sphere": Sphere([0.004, -0.003, 0.335], 0.05),
    "corner": CornerReflector([0.006, 0.004, 0.306]),
}
SAID: dict[str, Target] = {
    "plate": FlatPlate(0.308),
    "sphere": Sphere([0.0, 0.0, 0.330], 0.05),
    "corner": CornerReflector([0.0, 0.0, 0.300]),
}
KINDS = list(TRUE)
FLAT = [kind for kind in KINDS if kind != "sphere"]
"""Those whose path lengths need no root finder: ten times as fast."""


def live(calibration: ChannelCalibration, side: str) -> np.ndarray:
    return np.flatnonzero(getattr(calibration.response, f"{side}_gain") != 0)


def product_error(
    found: ChannelCalibration, truth: Instrument, target: Target | None = None
) -> np.ndarray:
    """Estimated over true response of all live pairs, (tx, rx, freq), but for a common factor.

    With a target, its path is part of either: a sum of a Tx and an Rx segment can be in the
    channels instead.
    """
    frequencies_hz = truth.waveform.frequencies_hz
    pairs = np.ix_(live(found, "tx"), live(found, "rx"))
    ratio = 1.0
    for sign, source in ((1, found.response), (-1, truth.channels)):
        tx, rx = source.tx_response(frequencies_hz), source.rx_response(frequencies_hz)
        ratio = ratio * (tx[pairs[0]] * rx[pairs[1]]) ** sign
    if target is not None:
        there = target.placed(np.array(list(found.target_position.values())))
        for sign, place in ((1, there), (-1, target)):
            length_m = place.echo(truth.array).length_m[pairs][:, :, None]
            turns = length_m * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
            ratio = ratio * np.exp(-2j * np.pi * sign * turns)
    return ratio / np.exp(np.log(np.abs(ratio)).mean() + 1j * np.angle(ratio.sum()))


# What is found, and how well ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", [*FLAT, *nightly(["sphere"])])
def test_errors_are_those_that_are_reported(kind):
    truth = instrument(2, HALF, dead_tx=DEAD_TX[:1], dead_rx=DEAD_RX)
    found = estimate_channels(truth.record_target(TRUE[kind]), SAID[kind])
    off = TRUE[kind].parameters - np.array(list(found.target_position.values()))
    std = np.array(list(found.target_std.values()))
    assert list(found.target_position) == list(TRUE[kind].parameter_names)
    assert (np.abs(off) < SIGMAS * std).all()
    said_off = np.abs(TRUE[kind].parameters - SAID[kind].parameters)
    # Only the scatter of the delays, 20 ps, makes a corner's position observable: some millimetres.
    assert (std < (0.5 if kind == "corner" else 0.1) * said_off).all()
    # White noise of -20 dB of an echo with unit gains, averaged over the frequencies. The mean of
    # all pairs that work is good to 0.1 dB, and the parameters take as much.
    gains = [getattr(truth.channels, f"{side}_gain") for side in ("tx", "rx")]
    echo_db = sum(10 * np.log10(np.mean(np.abs(gain[gain != 0]) ** 2)) for gain in gains)
    noise_db = -20 - 10 * np.log10(truth.waveform.n_freq) - echo_db
    assert found.residual_db == pytest.approx(noise_db, abs=0.6)
    assert found.residual_db == pytest.approx(found.noise_residual_db, abs=0.5)
    for noise, alive in ((found.tx_noise, live(found, "tx")), (found.rx_noise, live(found, "rx"))):
        assert np.median(noise[alive]) == pytest.approx(0.1, rel=0.1)


def test_gain_and_phase_errors_have_their_standard_deviation():
    truth = instrument(seed=3)
    exact = {"position_tolerance_m": 1e-6, "tilt_tolerance_deg": 1e-4}
    found = estimate_channels(truth.record_target(TRUE["plate"]), TRUE["plate"], **exact)
    error = product_error(found, truth)[:, :, truth.waveform.n_freq // 2]
    variance = found.tx_phase_std_rad[:, None] ** 2 + found.rx_phase_std_rad[None] ** 2
    # Some 188 independent estimates: their RMS is within a fifth of what it should be.
    for part in (np.log(np.abs(error)), np.angle(error)):
        assert np.sqrt(np.mean(part**2 / variance)) == pytest.approx(1.0, abs=0.2)
    delay = found.response.tx_delay_s - truth.channels.tx_delay_s
    scaled = (delay - delay.mean()) / found.tx_delay_std_s
    assert np.sqrt(np.mean(scaled**2)) == pytest.approx(1.0, abs=0.25)
    assert found.target_std["distance_m"] < 1e-6


@pytest.mark.parametrize("kind", ["plate", *nightly(["sphere"])])
def test_covariance_of_the_position(kind):
    scaled = []
    for seed in range(5):
        truth = instrument(seed, SMALL, n_freq=16)
        found = estimate_channels(truth.record_target(TRUE[kind]), SAID[kind])
        off = TRUE[kind].parameters - np.array(list(found.target_position.values()))
        scaled.append(off @ np.linalg.solve(found.target_covariance, off))
    # Chi square with 15 degrees of freedom: outside of these in 2 of 1000 cases.
    assert 3.5 < sum(scaled) < 37.7


def test_gauge():
    truth = instrument(seed=4, array=SMALL, dead_tx=(0,))
    ideal = 7.0 * response(TRUE["corner"], SMALL, truth.waveform)
    capture = truth.record(ideal)
    found = estimate_channels(capture, TRUE["corner"])
    alive = {side: live(found, side) for side in ("tx", "rx")}
    assert found.dead_tx.tolist() == [0]
    means, level = {}, 7.0
    for side, own in alive.items():
        gain = getattr(found.response, f"{side}_gain")[own]
        assert np.log(np.abs(gain)).mean() == pytest.approx(0.0, abs=1e-12)
        means[side] = getattr(found.response, f"{side}_delay_s")[own].mean()
        level *= np.exp(np.log(np.abs(getattr(truth.channels, f"{side}_gain")[own])).mean())
    assert means["tx"] == pytest.approx(means["rx"], abs=1e-18)
    assert np.angle(found.response.tx_gain[alive["tx"][0]]) == pytest.approx(0.0, abs=1e-12)
    assert found.response.tx_delay_s[0] == 0
    assert found.response.reference_hz == pytest.approx(77e9)
    assert found.target_amplitude == pytest.approx(level, rel=1e-3)
    # By the mean gain, levels stay.
    kept = np.abs(correct(capture, found).data[1:])
    shift = np.log(kept).mean() - np.log(np.abs(capture.data[1:])).mean()
    assert shift == pytest.approx(np.log(24 / 23), abs=0.01)


def test_common_delay():
    shift_s = 60e-12
    truth = instrument(seed=8, array=SMALL, common_delay_s=shift_s)
    # The distance of a plate is observable, whatever is assumed about the delays.
    for assumed in ("zero", "free"):
        capture = truth.record_target(TRUE["plate"])
        found = estimate_channels(capture, SAID["plate"], common_delay=assumed)
        total = found.response.tx_delay_s.mean() + found.response.rx_delay_s.mean()
        want = truth.channels.tx_delay_s.mean() + truth.channels.rx_delay_s.mean()
        off_s = 2 * SIGMAS * found.target_std["distance_m"] / SPEED_OF_LIGHT_M_PER_S
        assert total == pytest.approx(want, abs=off_s)
    # A corner does not: its distance absorbs the delay, or keeps its nominal value.
    capture = truth.record_target(TRUE["corner"])
    found = estimate_channels(capture, TRUE["corner"], common_delay="zero")
    moved = found.target_position["z_m"] - TRUE["corner"].parameters[2]
    assert moved == pytest.approx(shift_s * SPEED_OF_LIGHT_M_PER_S / 2, rel=0.15)
    free = estimate_channels(capture, TRUE["corner"], common_delay="free")
    assert abs(free.target_position["z_m"] - 0.306) < 5e-3
    assert free.target_std["z_m"] > 8e-3  # about as uncertain as its prior


# Dead, noisy, outliers ----------------------------------------------------------------------------


def loud(capture: Capture, tx: int, rx: int, level: float) -> Capture:
    rng = np.random.default_rng(99)
    data = np.array(capture.data)
    for part in (data[tx], data[:, rx]):
        part += level * (rng.normal(size=part.shape) + 1j * rng.normal(size=part.shape))
    return replace(capture, data=data)


@pytest.mark.parametrize("kind", [*FLAT, *nightly(["sphere"])])
def test_noisy_channels_are_found_and_harm_no_other(kind):
    truth = instrument(seed=10, array=SMALL, dead_tx=(3, 22), dead_rx=(17,))
    quiet = truth.record_target(TRUE[kind])
    found = estimate_channels(loud(quiet, tx=20, rx=10, level=1.0), SAID[kind])
    assert found.noisy_tx.tolist() == [20]
    assert found.noisy_rx.tolist() == [10]
    assert found.dead_tx.tolist() == [3, 22]
    assert found.dead_rx.tolist() == [17]
    # 1.0 times sqrt 2, relative to an echo of about 1.
    assert found.tx_noise[20] == pytest.approx(np.sqrt(2), rel=0.5)
    good = np.ones((SMALL.n_tx, SMALL.n_rx), dtype=bool)
    good[20], good[:, 10] = False, False
    good = good[np.ix_(live(found, "tx"), live(found, "rx"))]
    alone = estimate_channels(quiet, SAID[kind])
    errors = [np.abs(np.log(np.abs(product_error(f, truth)[good]))).max() for f in (found, alone)]
    assert errors[0] < 1.5 * errors[1]


@pytest.mark.parametrize("level", [0.1, 1.0])
def test_dead_channels_whatever_they_record(level):
    truth = instrument(seed=11, array=SMALL, dead_tx=(0, 5), dead_rx=(23,))
    capture = truth.record_target(TRUE["plate"])
    data = np.array(capture.data)
    for part in (data[0], data[5], data[:, 23]):
        part[...] = level * truth.noise(part.shape)
    found = estimate_channels(replace(capture, data=data), SAID["plate"])
    assert found.dead_tx.tolist() == [0, 5]
    assert found.dead_rx.tolist() == [23]


def test_exact_data_has_no_noisy_channels():
    truth = instrument(seed=12, array=SMALL.part(slice(None, None, 2), slice(None, None, 2)))
    found = estimate_channels(truth.record_target(TRUE["sphere"], snr_db=300.0), SAID["sphere"])
    assert found.noisy_tx.size == found.noisy_rx.size == 0
    # complex64 has 6e-8 of the echo in every sample.
    assert found.residual_db < -130
    assert np.abs(np.angle(product_error(found, truth, TRUE["sphere"]))).max() < 1e-5


def test_outlying_pairs_have_little_weight():
    truth = instrument(seed=13, array=SMALL)
    capture = truth.record_target(TRUE["plate"])
    data = np.array(capture.data)
    rng = np.random.default_rng(0)
    for i, k in zip(*np.divmod(rng.choice(data[:, :, 0].size, 25, replace=False), 24), strict=True):
        data[i, k] *= 3j
    found = estimate_channels(replace(capture, data=data), SAID["plate"])
    assert np.abs(np.angle(product_error(found, truth, TRUE["plate"]))).max() < 0.05
    assert found.meta["outlying_pairs"] == pytest.approx(25 / 576, abs=0.01)
    off = found.target_position["distance_m"] - 0.300
    assert abs(off) < SIGMAS * found.target_std["distance_m"]


# Other echoes -------------------------------------------------------------------------------------


def with_coupling_and_wall(truth: Instrument, target: Target) -> Capture:
    array, frequencies_hz = truth.array, truth.waveform.frequencies_hz
    apart_m = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
    turns = apart_m[:, :, None] * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    others = 2 * np.exp(-2j * np.pi * turns) + response(FlatPlate(0.6), array, truth.waveform)
    return truth.record(response(target, array, truth.waveform) + others, snr_db=50.0)


def test_gate_shuts_out_coupling_and_wall():
    truth = instrument(seed=14, array=HALF, n_freq=64)
    capture = with_coupling_and_wall(truth, TRUE["plate"])
    worst = []
    gated = range_gate(capture, near_m=0.2, far_m=0.42, clutter_db=60.0)
    for seen in (capture, gated):
        found = estimate_channels(seen, SAID["plate"])
        worst.append(np.abs(np.angle(product_error(found, truth, TRUE["plate"]))).max())
    # 2 : 1 and 30 to 46 cells away, of which the first side lobes of the band have percents.
    assert worst[1] < 0.005
    assert worst[1] < worst[0] / 5


def test_echoes_beyond_noise_are_a_warning():
    """A faint ball beside the plate, far above the noise."""
    truth = instrument(seed=14, array=SMALL, n_freq=32)
    both = response(TRUE["plate"], truth.array, truth.waveform)
    both = both + 0.05 * response(Sphere([0.03, 0.0, 0.32], 0.02), truth.array, truth.waveform)
    with pytest.warns(clradar.ClradarWarning, match=r"\d+ dB more is left .*range_gate"):
        estimate_channels(truth.record(both, snr_db=60.0), SAID["plate"])


# What is refused ----------------------------------------------------------------------------------


PLATE, CORNER = FlatPlate(0.3), CornerReflector([0, 0, 0.3])
BALL, NEAR = Sphere([0, 0, 0.35], 0.05), Sphere([0, 0, 0.335], 0.05)


@pytest.mark.parametrize(
    ("seed", "true", "said"),
    [
        # Another shape at the same range. This seed once had a third of the pairs left out as
        # outliers, and the rest explained.
        (1, BALL, CORNER), (1, CORNER, PLATE), (1, PLATE, CORNER),
        *nightly([(1, PLATE, BALL), (1, BALL, PLATE), (1, CORNER, BALL)]),
        # The same elsewhere.
        (16, PLATE, FlatPlate(0.34)), (16, PLATE, FlatPlate(0.3, 15.0)),
        (16, NEAR, Sphere([0, 0, 0.385], 0.05)), (16, Sphere([0, 0, 0.335], 0.03), NEAR),
        (16, CORNER, CornerReflector([0, 0, 0.36])), (16, CORNER, CornerReflector([0.1, 0, 0.3])),
    ],
)  # fmt: skip
def test_another_target_is_refused(seed, true, said):
    truth = instrument(seed, array=SMALL)
    with pytest.raises(CalibrationError, match=r"^estimate_channels: ") as caught:
        estimate_channels(truth.record_target(true), said)
    if isinstance(said, CornerReflector) and said.position_m[0]:
        assert "x 100 mm within 30 mm, the fit leads -30 mm away" in str(caught.value)


def test_captures_without_an_echo():
    truth = instrument(seed=17, array=SMALL)
    shape = (SMALL.n_tx, SMALL.n_rx, truth.waveform.n_freq)
    empty = Capture(np.zeros(shape), SMALL, truth.waveform)
    with pytest.raises(CalibrationError, match="zero everywhere"):
        estimate_channels(empty, SAID["plate"])
    for scale in (1e-20, 1.0, 1e20):
        with pytest.raises(CalibrationError, match="estimate_channels: "):
            estimate_channels(replace(empty, data=scale * truth.noise(shape)), SAID["plate"])


def test_plate_too_small_for_all_channels():
    truth = instrument(seed=18, array=SMALL)
    tiny = FlatPlate(0.3, size_m=(0.06, 0.06))
    with pytest.raises(CalibrationError, match="larger one"):
        estimate_channels(truth.record_target(tiny), tiny)
    # Each row of a cross-shaped layout sees only its own half of such a plate's pairs.
    enough = FlatPlate(0.3, size_m=(0.12, 0.12))
    assert not enough.echo(SMALL).seen.all()
    found = estimate_channels(truth.record_target(enough), enough)
    assert np.abs(np.angle(product_error(found, truth, FlatPlate(0.3)))).max() < 0.1


FEW = {"array": AntennaArray(SMALL.tx_m[:2], SMALL.rx_m), "n_freq": 32}


@pytest.mark.parametrize(
    ("radar", "changed", "error", "message"),
    [
        ({}, {"capture": None}, ModelError, "a Capture"),
        ({}, {"target": "plate"}, ModelError, "a FlatPlate or Sphere or CornerReflector"),
        ({}, {"position_tolerance_m": 0.0}, ModelError, "positive"),
        ({}, {"max_delay_s": 1e-6}, ModelError, "unambiguous"),
        ({}, {"common_delay": "none"}, ModelError, "'zero', 'free'"),
        ({"n_freq": 3}, {}, ModelError, "at least 4 frequencies"),
        (FEW, {}, CalibrationError, "fewer"),
    ],
)
def test_invalid_arguments(radar, changed, error, message):
    truth = instrument(**{"seed": 19, "array": SMALL, "n_freq": 16, **radar})
    arguments = {"capture": truth.record_target(TRUE["plate"]), "target": SAID["plate"]}
    with pytest.raises(error, match=message):
        estimate_channels(**{**arguments, **changed})


# Correction ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def truth() -> Instrument:
    return instrument(seed=21, array=SMALL, n_freq=16, dead_tx=(2,))


@pytest.fixture(scope="module")
def found(truth: Instrument) -> ChannelCalibration:
    capture = loud(truth.record_target(TRUE["plate"]), tx=4, rx=7, level=0.7)
    return estimate_channels(replace(capture, meta={"day": "today"}), SAID["plate"])


def test_correction_divides_and_masks(truth, found):
    capture = truth.record_target(TRUE["corner"])
    corrected = correct(capture, found)
    frequencies_hz = truth.waveform.frequencies_hz
    tx = found.response.tx_response(frequencies_hz)
    rx = found.response.rx_response(frequencies_hz)
    tx[[2, 4]], rx[7] = np.inf, np.inf
    want = capture.data / tx[:, None] / rx[None]
    level = (24 / 22) * (24 / 23)  # the remaining pairs are scaled to the sum of all
    assert np.abs(corrected.data - level * want).max() < 1e-6 * level * np.abs(want).max()
    record = corrected.meta["channels"]
    assert (record["masked_tx"], record["masked_rx"]) == ([2, 4], [7])
    assert record["live_share"] == pytest.approx(22 / 24 * 23 / 24)
    assert record["factor"] == pytest.approx(level)
    kept = correct(capture, found, mask=["dead"])
    assert kept.data[4].any()
    assert not kept.data[2].any()
    for mask in ("dead", ["noisy"], ["live"]):
        with pytest.raises(ModelError, match="correct: mask"):
            correct(capture, found, mask=mask)


def test_another_instrument_is_refused(truth, found):
    tx_m, rx_m, waveform = np.array(SMALL.tx_m), SMALL.rx_m, truth.waveform
    tx_m[5, 1] += 1.5e-3
    for array, sweep, message in (
        (AntennaArray(tx_m, rx_m), waveform, "Tx 5 is 1.5 mm away"),
        (AntennaArray(SMALL.tx_m, rx_m[::-1]), waveform, "Rx 0 is"),
        (AntennaArray(SMALL.tx_m[:-1], rx_m), waveform, "23 Tx in place of 24"),
        (SMALL, Waveform.sfcw(72e9, 82e9, 15), "frequencies 15 from 72 to 82 GHz in place"),
        (SMALL, Waveform.sfcw(72e9, 81e9, 16), "72 to 81 GHz"),
    ):
        data = np.ones((array.n_tx, array.n_rx, sweep.n_freq))
        with pytest.raises(CalibrationError, match=message):
            correct(Capture(data, array, sweep), found)


# The record and its file --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"dead_tx": [2, 3]}, "gain 0"),
        ({"noisy_tx": [2]}, "which is dead"),
        ({"noisy_rx": [24]}, "ascending indices"),
        ({"tx_noise": np.full(24, -1.0)}, "not negative"),
        ({"rx_noise": np.ones(23)}, "shape"),
        ({"target_position": {"distance_m": "far"}}, "number"),
        ({"residual_db": float("nan")}, "finite"),
        ({"array": QAR50}, "94 channels"),
    ],
)
def test_record_is_checked(found, changed, message):
    with pytest.raises(ModelError, match=message):
        replace(found, **changed)


def test_file_round_trip(tmp_path, found):
    path = tmp_path / "channels.h5"
    save_channels(path, found)
    read = open_channels(path)
    assert same_record(read, found)
    assert dict(read.meta["capture"]) == {"day": "today"}
    report = check_file(path)
    assert report.ok, report.problems
    text = str(describe(path))
    for words in ("native channels", "dead Tx", "plate distance", "residual", "±"):
        assert words in text
    with pytest.raises(OutputError, match="exists already"):
        save_channels(path, found)
    save_channels(path, found, force=True)


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data["tx_state"].__setitem__(0, 9),
        lambda data: data["tx_state"].__setitem__(0, 1),
        lambda data: data.attrs.__setitem__("target", "sphere"),
        lambda data: data.attrs.__setitem__("target_parameters", "a_m,a_m,b_m"),
    ],
)
def test_damaged_files(tmp_path, found, damage):
    path = tmp_path / "channels.h5"
    save_channels(path, found)
    with h5py.File(path, "r+") as file:
        damage(file["entry/data"])
    with pytest.raises(MeasurementError, match=r"channels\.h5: ") as caught:
        open_channels(path)
    assert "\n" not in str(caught.value)
    assert not check_file(path).ok


# The command line ---------------------------------------------------------------------------------


def test_commands(cli, truth, monkeypatch):
    for name in ("plate", "corner"):
        save_capture(f"{name}.h5", truth.record_target(TRUE[name]))
    # Not drawn, which would take most of the time.
    own_figure, drawn = figure.channels_figure, []
    monkeypatch.setattr(figure, "channels_figure", lambda *a: drawn.append(a) or Figure())
    options = "--target plate --distance-mm 305 -o channels.h5 --plot channels.png"
    _, out, err = cli.ok(f"channels plate.h5 {options}")
    assert err == ""
    axes = own_figure(*drawn[0]).axes
    labels = [one.get_ylabel() for one in axes[::2]]
    assert labels == ["gain (dB)", "phase (degrees)", "delay (ps)"]
    assert "1 dead" in axes[0].get_title()
    for words in ("23 of 24", "plate distance  ", "plate tilt_x ", "channels.png"):
        assert words in out
    channels = open_channels("channels.h5")
    assert channels.meta["command"] == "channels"
    assert channels.meta["inputs"][0]["file"] == "plate.h5"
    assert Path("channels.png").read_bytes().startswith(b"\x89PNG")
    _, out, err = cli.ok("clean corner.h5 --channels channels.h5 -o corrected.h5")
    assert err == ""
    assert "without 1 Tx and 0 Rx" in out
    corrected = open_capture("corrected.h5")
    want = correct(open_capture("corner.h5"), channels)
    np.testing.assert_array_equal(corrected.data, want.data)
    assert [item["file"] for item in corrected.meta["inputs"]] == ["corner.h5", "channels.h5"]
    cli.ok("inspect channels.h5 --check")
