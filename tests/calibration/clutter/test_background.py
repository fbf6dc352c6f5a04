"""Averaging, background subtraction and range gates, on recordings with known truth."""

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from recorder import Recorder, Recording

import clradar
from calibration import average_frames, range_gate, subtract_background
from calibration.clutter import averaging_loss_db, delay_profiles, gate, path_lengths_m
from clradar import AntennaArray, Capture, Wall, Waveform
from clradar.errors import ClradarWarning, ModelError
from measurement_io import open_capture, save_capture

C = 299_792_458.0
SWEEP = Waveform.sfcw(72e9, 82e9, 128)
# Every fifth antenna: 19 x 19 pairs, so that a capture of 128 steps has 46 208 samples.
FULL = clradar.arrays.qar50()
SPARSE = AntennaArray(FULL.tx_m[::5], FULL.rx_m[::5], "sparse")
CLEAN: dict[str, Any] = {"snr_db": None, "iq_gain_db": 0, "iq_phase_rad": 0, "adc_bits": None}
# complex64 holds a sample to 2^-24 of it per component. The background is up to 25 dB above the
# object and in two captures, so the difference is good to -144 + 25 + 3 dB; -110 dB leaves room.
ROUNDING_DB = -110.0
# Mean powers of n samples vary by 1/sqrt(n) of themselves: five of them.
POWER = 5 / np.sqrt(19 * 19 * 128)
DRIFT: dict[str, Any] = {"drift_phase_rad": 0.03, "drift_gain_db": 0.05, "drift_frames": 10}
POINTS = np.random.default_rng(1).uniform([-0.06, -0.06, 0.28], [0.06, 0.06, 0.33], (30, 3))


def recorder(**settings: Any) -> Recorder:
    return Recorder(**{"points_m": POINTS, "array": SPARSE, **settings})


def power(data: np.ndarray) -> float:
    return float((np.abs(data.astype(complex)) ** 2).mean())


def remainder_db(found: Capture, ideal: Capture) -> float:
    """Power of the error relative to the object's."""
    wrong = power(found.data - ideal.data.astype(complex))
    return float(10 * np.log10(wrong / power(ideal.data) + 1e-30))


def kept_db(found: Capture, ideal: Capture) -> float:
    """Amplitude of the object that remains, by its best fit."""
    o, s = (c.data.astype(complex).ravel() for c in (ideal, found))
    return float(20 * np.log10(abs(np.vdot(o, s)) / np.vdot(o, o).real))


def echoes(ranges_m: Any, sweep: Waveform = SWEEP) -> Capture:
    """One pair for each half path length; a gate does not depend on the antennas."""
    data = np.exp(-2j * np.pi * np.outer(ranges_m, sweep.frequencies_hz) * 2 / C)
    array = AntennaArray(np.zeros((len(data), 3)), np.zeros((1, 3)))
    return Capture(data[:, None], array, sweep)


def echo(range_m: float, sweep: Waveform = SWEEP) -> Capture:
    return echoes([range_m], sweep)


# Averages


def test_the_mean_of_n_frames_has_an_nth_of_the_noise():
    made = recorder(adc_bits=None)
    silent = replace(made, snr_db=None).frame()
    for n in (1, 8):
        mean = average_frames(made.frame(i) for i in range(n))
        noise = power(mean.data - silent.data.astype(complex))
        # 10 log10 n: relative to the points' power, which the SNR of 20 dB refers to.
        assert noise == pytest.approx(0.01 / n * power(made.scene.data), rel=POWER)
        assert mean.meta["average"] == {"frames": n, "align_phase": False}


def test_common_metadata_is_kept():
    one = echo(0.3)
    frames = [replace(one, meta={"frame": i, "lab": "a", "later": i} | {str(i): 1}) for i in (0, 1)]
    mean = average_frames(frames)
    assert mean.meta == {"lab": "a", "average": {"frames": 2, "align_phase": False}}
    assert (mean.data == one.data).all()


def test_a_common_drift_of_the_phase_is_corrected():
    made = recorder(drift_common_phase_rad=0.8, **{**CLEAN, "snr_db": 20})
    silent = replace(made, snr_db=None).frame(0)
    n = 12
    blurred = replace(silent, data=np.mean([made.frame(i).data for i in range(n)], axis=0))
    aligned = average_frames((made.frame(i) for i in range(n)), align_phase=True)
    assert kept_db(blurred, silent) < -1
    # The phase of one frame is known to sqrt(noise / signal / 2 / samples) = 2e-5 rad here, far
    # below the noise of the mean.
    noise = power(aligned.data - silent.data.astype(complex))
    assert noise == pytest.approx(0.01 / n * power(made.scene.data), rel=2 * POWER)
    assert abs(kept_db(aligned, silent)) < 0.001
    factors = [np.angle(np.vdot(made.frame(i).data, silent.data)) for i in (0, 5)]
    turned = np.array(aligned.meta["average"]["turned_rad"])[[0, 5]]
    # The same phase from single frames, whose noise is that of the frame and of nothing else.
    np.testing.assert_allclose(turned, factors, atol=1e-3)


def test_the_loss_of_two_frames_is_that_of_their_mean():
    rng = np.random.default_rng(5)
    shape = (24, 24, 128)  # so many pairs that six deviations of the noise's power are 0.25 of it
    for phase_rad, snr_db in ((0.4, None), (1.2, None), (1.2, 0.0)):
        array = AntennaArray(np.zeros((24, 3)), np.zeros((24, 3)))
        wave = echoes([0.3], SWEEP).data[0, 0] * np.ones(shape)
        pair = [wave, np.exp(1j * phase_rad) * wave]
        if snr_db is not None:
            size = 10 ** (-snr_db / 20) / np.sqrt(2)
            pair = [
                one + size * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) for one in pair
            ]
        profiles = [delay_profiles(Capture(one, array, SWEEP)) for one in pair]
        loss_db, delay_bin = averaging_loss_db(*profiles)
        # |1 + exp(i phi)| / 2; noise only in the bin of the echo, 21 dB above it for each sample.
        assert loss_db == pytest.approx(-20 * np.log10(np.cos(phase_rad / 2)), abs=0.25)
        if snr_db is not None:  # else the loss is the same in all bins
            assert abs(path_lengths_m(SWEEP)[delay_bin] - 0.6) < 0.02
        assert averaging_loss_db(profiles[0], profiles[0])[0] == 0
    # Noise alone is no change, whatever its level.
    noise = [rng.normal(size=shape) + 1j * rng.normal(size=shape) for _ in range(2)]
    assert averaging_loss_db(*noise)[0] < 0.05


def test_a_frame_that_does_not_agree_is_left_out_with_a_warning():
    made = recorder(adc_bits=None, snr_db=10.0)
    frames = [made.frame(i) for i in range(4)]
    moved = Capture(-1j * frames[2].data, frames[2].array, frames[2].waveform)
    with pytest.warns(ClradarWarning, match=r"1 of 5 frames left out.*number 2, counted from 0"):
        mean = average_frames([*frames[:2], moved, *frames[2:]])
    assert mean.meta["average"]["left_out"] == [2]
    assert (mean.data == average_frames(frames).data).all()
    # A bad first frame, or two that agree with each other, do not discard the good ones.
    with pytest.warns(ClradarWarning, match=r"2 of 6 frames left out.*number 0, counted from 0"):
        mean = average_frames([moved, frames[0], moved, *frames[1:]])
    assert mean.meta["average"]["left_out"] == [0, 2]
    assert (mean.data == average_frames(frames).data).all()
    # Nor do frames of a scene that moves before it is still.
    moving = [Capture(turn * moved.data, moved.array, moved.waveform) for turn in (1, -1, -1j)]
    with pytest.warns(ClradarWarning, match="3 of 7 frames left out"):
        assert (average_frames([*moving, *frames]).data == average_frames(frames).data).all()


# Background subtraction


def test_a_common_factor_is_found():
    made = recorder(drift_common_phase_rad=0.5, drift_frames=3, **CLEAN)
    frame, empty, ideal = made.frame(), made.empty(), made.ideal()
    assert remainder_db(subtract_background(frame, empty), ideal) > 0
    found = subtract_background(frame, empty, scaling="common")
    assert remainder_db(found, ideal) < ROUNDING_DB + 10
    factor = complex(*found.meta["background"]["factor"])
    drift = made.ideal().data[0, 0, 0] / replace(made, drift_frames=0).ideal().data[0, 0, 0]
    assert factor == pytest.approx(complex(drift), rel=1e-5)


def test_factors_of_the_channels_are_found_under_the_object():
    made = recorder(**DRIFT, **CLEAN)
    frame, empty, ideal = made.frame(), made.empty(), made.ideal()
    assert remainder_db(subtract_background(frame, empty), ideal) > 0
    assert remainder_db(subtract_background(frame, empty, scaling="common"), ideal) > 0
    found = subtract_background(frame, empty, scaling="channel")
    assert remainder_db(found, ideal) < ROUNDING_DB + 10
    # Rescaling costs nothing of the object; plain least squares per pair would.
    assert abs(kept_db(found, ideal)) < 1e-4
    record = json.loads(json.dumps(found.meta["background"]))
    tx, rx = (np.array(record[f"{side}_factor"]) @ [1, 1j] for side in ("tx", "rx"))
    drift = ideal.data[:, :, 0] / replace(made, drift_frames=0).ideal().data[:, :, 0]
    np.testing.assert_allclose(np.outer(tx, rx), drift, rtol=1e-4)


def test_a_wall_at_the_objects_range_alone_determines_the_factors():
    # No coupling and one wall within the delays of the object: there is no bin without it, and
    # most bins have noise only. The factors must come from the bins with the wall all the same.
    made = recorder(
        **DRIFT,
        **{**CLEAN, "snr_db": 20},
        coupling_db=None,
        walls=(Wall([0, 0, 0.36], [0, 0, 1], 10),),
    )
    found = subtract_background(made.frame(), made.empty(), scaling="channel")
    noise = 10 * np.log10(0.02 * power(made.scene.data) / power(made.ideal().data))
    assert remainder_db(found, made.ideal()) < noise + 1.0


def test_dead_channels_have_no_weight():
    made = recorder(**DRIFT, **CLEAN)
    channels = clradar.draw_channels(SPARSE, SWEEP, seed=1, dead_tx=[0, 4], dead_rx=[7])
    made = replace(made, channels=channels)
    found = subtract_background(made.frame(), made.empty(), scaling="channel")
    assert remainder_db(found, made.ideal()) < ROUNDING_DB + 10
    assert not found.data[4].any()


# Range gates

WINDOW: dict[str, Any] = {"near_m": 0.25, "far_m": 0.42}
UNEQUAL = Waveform(72e9 + 10e9 * (np.arange(128) + 0.3 * np.sin(np.arange(128))) / 127)
# The gate's figures are the worst on a grid of an eighth of a resolution cell, where the response
# cannot change by more than this in between (the response has no structure below a cell).
PROBED_DB = 0.3


@pytest.mark.parametrize("sweep", [SWEEP, UNEQUAL], ids=["equal steps", "unequal steps"])
@pytest.mark.parametrize("clutter_db", [20.0, 40.0, 60.0])
def test_passband_and_rejection_of_a_gate(sweep, clutter_db):
    rng = np.random.default_rng(5)
    _, found = gate(sweep, **WINDOW, clutter_db=clutter_db)
    period_m = C / 2 / np.diff(sweep.frequencies_hz).max()
    target = echoes(rng.uniform(0.25, 0.42, 100), sweep)
    kept = range_gate(target, **WINDOW, clutter_db=clutter_db).data.astype(complex)
    amplitude = abs((target.data.conj() * kept).mean(axis=(1, 2)))
    assert 20 * np.log10(amplitude.min()) > found["passband_db"] - PROBED_DB
    outside_m = rng.uniform(0.42 + found["edge_m"], 0.25 - found["edge_m"] + period_m, 300)
    left = range_gate(echoes(outside_m, sweep), **WINDOW, clutter_db=clutter_db).data
    rejected = (abs(left.astype(complex)) ** 2).mean(axis=(1, 2))
    assert 10 * np.log10(rejected.max()) < -found["rejection_db"] + PROBED_DB
    # What docs/background.md states for 10 GHz, 170 mm and edges of 60 mm.
    passband_db, rejection_db = {20.0: (-0.4, 29.0), 40.0: (-0.75, 47.0), 60.0: (-1.2, 65.0)}[
        clutter_db
    ]
    assert found["passband_db"] > passband_db
    assert found["rejection_db"] > rejection_db


def test_the_gate_is_the_least_squares_map_of_its_equation():
    sweep = Waveform.sfcw(72e9, 82e9, 24)
    period_m = C / 2 / (10e9 / 23)
    near, far, edge = 0.1, 0.16, 0.02
    matrix, _ = gate(sweep, near, far, edge, clutter_db=30)
    # The same by integration over all ranges: min |G A - B|^2 + eps |G|^2. Gauss and Legendre's
    # nodes in each part, of up to 25 turns, are exact.
    x, unit = np.polynomial.legendre.leggauss(200)
    whole, wanted = 1e-3 * np.eye(24, dtype=complex), 0
    ends = (0.0, near - edge, near, far, far + edge, period_m)
    weights, shares = (1e3, 0.03, 1, 0.03, 1e3), (0, 0.5, 1, 0.5, 0)
    for (a, b), weight, share in zip(pairwise(ends), weights, shares, strict=True):
        r = (a + b) / 2 + (b - a) / 2 * x
        wave = np.exp(-4j * np.pi / C * np.outer(sweep.frequencies_hz - 77e9, r))
        part = weight * (wave * unit * (b - a) / 2 / period_m) @ wave.conj().T
        whole, wanted = whole + part, wanted + share * part
    # float64 and a condition of 1e6.
    np.testing.assert_allclose(matrix, wanted @ np.linalg.inv(whole), atol=1e-9)


OTHER_SWEEP = Waveform.sfcw(72e9, 82e9, 64)
SILENT = replace(recorder().scene, data=np.zeros((19, 19, 128)))


def gated(sweep: Waveform = SWEEP, **settings: float) -> Capture:
    return range_gate(echo(0.3, sweep), **{**WINDOW, **settings})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: average_frames([]), "at least one"),
        (lambda: average_frames([echo(0.3), "b"]), "frame 1"),
        (lambda: average_frames([echo(0.3), echo(0.3, OTHER_SWEEP)]), "frame 1.*64 from 72 to 82"),
        (lambda: average_frames([echo(0.3), SILENT]), "frame 1.*antennas"),
        (lambda: subtract_background(SILENT, echo(0.3)), "antennas"),
        (lambda: subtract_background(echo(0.3), echo(0.3, OTHER_SWEEP)), "frequencies"),
        (lambda: subtract_background(SILENT, SILENT, scaling="pair"), "scaling"),
        (lambda: subtract_background(recorder().scene, SILENT, scaling="common"), "zeros only"),
        (lambda: gated(near_m=-0.1), "near_m < far_m"),
        (lambda: gated(far_m=2.0), "at most 1.904 m"),
        (lambda: gated(near_m=0.01, far_m=1.9), "nothing is left to reject"),
        (lambda: gated(edge_m=-0.1), "edge_m"),
        (lambda: gated(clutter_db=-3), "clutter_db"),
        (lambda: gated(Waveform([77e9])), "two frequencies"),
    ],
)
def test_wrong_input_is_refused(call, message):
    with pytest.raises(ModelError, match=message):
        call()


# The command


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    made = Recorder(points_m=POINTS, waveform=Waveform.sfcw(72e9, 82e9, 24), **DRIFT)
    return made.write(tmp_path_factory.mktemp("recording"), n_frames=3)


def test_the_command_averages_subtracts_and_gates(cli, recording):
    options = "--scaling channel --average --gate-mm 150:300 -o out.h5"
    _, out, err = cli.ok(f"clean {recording.folder} --empty {recording.empty} {options}")
    assert err == ""
    assert "mean of 3 frames" in out
    assert "mean of 2 frames" in out
    assert "gated to 150 to 300 mm" in out
    found = open_capture("out.h5")
    frame = average_frames(recording.frames)
    empty = average_frames(recording.recorder.empty(i) for i in range(2))
    expected = subtract_background(frame, empty, scaling="channel")
    expected = range_gate(expected, near_m=0.15, far_m=0.3)
    np.testing.assert_array_equal(found.data, expected.data)
    assert len({entry["sha256"] for entry in found.meta["inputs"]}) == 5
    assert "frame" not in found.meta


def test_the_command_takes_files_and_single_frames(cli, recording):
    save_capture("empty.h5", recording.recorder.empty(0))
    line = f"clean {recording.folder} --empty empty.h5 -o out.h5"
    assert cli.ok(f"{line} --frame 1").err == ""
    found = open_capture("out.h5")
    expected = recording.frames[1].data - recording.recorder.empty(0).data
    np.testing.assert_allclose(found.data, expected, atol=1e-5 * abs(expected).max())
    assert [entry["file"] for entry in found.meta["inputs"]] == ["000001.npy", "empty.h5"]
    assert "subtracted already" in cli.ok(f"{line} --variant emptyfiltered --force").err
    cli.fails("clean empty.h5 --average -o mean.h5", "radar folder", status=2)


def test_frames_that_are_missing_are_left_out_of_the_mean(cli, tmp_path):
    made = Recorder(waveform=Waveform.sfcw(72e9, 82e9, 3), walls=())
    gap = made.write(tmp_path, n_frames=3, emptyfiltered=False)
    next(gap.folder.rglob("000001.npy")).unlink()
    assert "2 of 3 frames are there" in cli.ok(f"clean {gap.folder} --average -o gap.h5").err
