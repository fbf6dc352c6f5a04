"""The closed loop of the fit of a hand, and whole fits of what is none or half of one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hand_renderings import fitter_on, rendered_depth, state_of

from calibration import HandFit, fit_hand
from calibration.hand_fit import closed_loop
from calibration.hand_fit.closed_loop import (
    ALPHA_FIRST,
    ALPHA_HIGH,
    CORRECTED_SHARE,
    MAX_ROUNDS,
    LoopSettings,
    Round,
    _difference,
    close_loop,
)
from calibration.hand_fit.descent import FINE, Fitted, HandFitter, Missed
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_rendering import N_GEOMETRY, SHAPE
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.registration.mesh_fit import initial_log_brightness
from calibration.registration.radar import Radar
from clradar import DepthMap, Waveform, arrays
from clradar.errors import ClradarWarning, CompareError
from clradar.hand import POSES, pose_by_name
from clradar.opencl import open_device

CENTRE_M = np.array([0.01, 0.0, 0.3])

RADAR = Radar.of(
    "test",
    arrays.qar50().part(slice(None, None, 8), slice(None, None, 8)),
    Waveform.sfcw(72e9, 82e9, 16),
)
NOTHING_MISSED = Missed(*np.zeros((2, N_GEOMETRY, 625)))


@pytest.fixture
def state() -> HandState:
    return state_of(pose_by_name("B"), ParametricHand("right", "pocl"))


@pytest.fixture
def fitter() -> HandFitter:
    """On a blank image of few pixels, by few antennas."""
    axis_m = np.arange(-12, 13) * 8e-3
    depth = DepthMap(np.full((25, 25), 0.3), np.ones((25, 25)), axis_m, axis_m, 20.0)
    return fitter_on(depth, shape=True, levels=(FINE,))


@pytest.fixture
def loop(monkeypatch, fitter, state):
    """The loop with made-up simulations: a constant bias, features of a true alpha of 0.4."""
    bias = np.zeros(N_GEOMETRY)
    bias[5], bias[9], bias[SHAPE.start] = 2e-3, 0.05, 0.02
    calls = []

    def made_up(fitter, measured, state, alpha, found, prior, missed, settings, centre_m) -> Round:
        calls.append(SimpleNamespace(state=state, alpha=alpha, seed=settings.seed))
        features = np.full(11, 10.0 * (alpha - 0.4))
        return Round(state, alpha, None, None, 0.9 - abs(alpha - 0.4), features, bias)

    monkeypatch.setattr(closed_loop, "_round", made_up)
    monkeypatch.setattr(closed_loop, "_features", lambda *_: np.zeros(11))
    found = Fitted(state, initial_log_brightness(), 0.0, 0.0)
    prior = Prior.about(state, angle_covariance())

    def run(alpha: float | None, progress=None):
        given = LoopSettings(RADAR, alpha, 3, open_device("pocl"))
        return close_loop(fitter, found, prior, NOTHING_MISSED, given, progress), calls

    return run, bias


def test_the_loop_corrects_a_share_of_a_bias_that_stays_and_finds_alpha(loop, state):
    run, bias = loop
    seen: list[tuple[int, int]] = []
    found, calls = run(None, lambda done, total: seen.append((done, total)))
    moved = _difference(found.best.state, state, CENTRE_M)
    # About another centre; but the bias has no rotation.
    np.testing.assert_allclose(moved, -CORRECTED_SHARE * bias, atol=1e-9)
    assert found.best.alpha == pytest.approx(0.4)
    assert found.converged
    assert [call.alpha for call in calls[:2]] == [ALPHA_FIRST, ALPHA_HIGH]
    assert len({call.seed for call in calls}) == len(calls)
    assert seen[-1] == (MAX_ROUNDS, MAX_ROUNDS)
    assert sorted(seen) == seen


def test_a_round_simulates_the_hand_and_finds_it_where_it_is(fitter, state):
    """With its few antennas the image is poor: the fit to it stays within some millimetres."""
    found = Fitted(state, initial_log_brightness(), 0.0, 0.0)
    prior = Prior.about(state, angle_covariance())
    given = LoopSettings(RADAR, None, 3, open_device("pocl"))
    one = closed_loop._round(
        fitter, fitter.depth, state, 0.5, found, prior, NOTHING_MISSED, given, CENTRE_M
    )
    assert one.alpha == 0.5
    assert one.scene.alpha.max() == one.scene.alpha.min() == 0.5
    assert one.capture.meta["rays"]["paths"] > 0
    assert np.isfinite(one.features).all()
    assert np.abs(one.bias).max() > 0
    assert np.linalg.norm(one.bias[3:6]) < 10e-3
    volume = closed_loop.image_of(one.capture, fitter.depth, one.scene, given.device)
    assert volume.grid.shape[1:] == fitter.depth.depth_m.shape
    assert closed_loop.shared(volume.depth_map(20.0), volume.depth_map(20.0)) == pytest.approx(1.0)


def seen(letter: str) -> DepthMap:
    """The rendering's own picture of a letter."""
    hand = ParametricHand("right", "pocl")
    return rendered_depth(hand, state_of(POSES[letter], hand))


def fitted(depth: DepthMap, start: str) -> HandFit:
    return fit_hand(depth, start, closed_loop=False, device="pocl")


@pytest.mark.slow
def test_noise_is_no_hand():
    axis_m = 2e-3 * np.arange(-50, 51)
    rng = np.random.default_rng(0)
    amplitude = rng.rayleigh(size=(101, 101))
    depth = DepthMap(rng.uniform(0.28, 0.32, (101, 101)), amplitude, axis_m, axis_m, 20.0)
    with pytest.raises(CompareError, match=r"^could not fit the hand, because .* it shows noise"):
        fitted(depth, "F")


@pytest.mark.slow
def test_of_half_a_hand_the_rest_is_as_in_the_start():
    whole = seen("B")
    kept = whole.x_m < 0.0  # thumb, index and middle finger
    half = replace(
        whole, x_m=whole.x_m[kept], depth_m=whole.depth_m[:, kept],
        amplitude=whole.amplitude[:, kept],
    )  # fmt: skip
    with pytest.warns(ClradarWarning, match=r"outside of the measured image.*ring, pinky \("):
        fit = fitted(half, "B")
    untold = [name for name in fit.untold if name.startswith("pinky-finger-phalanx")]
    assert len(untold) == 4
    assert not fit.told_tips[4]
    start = POSES["B"].angles("pinky-finger-phalanx-intermediate").flexion_rad
    found = fit.pose.angles("pinky-finger-phalanx-intermediate").flexion_rad
    assert found == pytest.approx(start, abs=np.radians(3.0))
