"""How certain a fit of a hand is, and the closed loop by simulations that takes its bias away."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hand_renderings import TIPS, fitter_on, rendered_depth, state_of

from calibration import HandFit, fit_hand
from calibration.hand_fit import closed_loop
from calibration.hand_fit.agreement import range_ratio, smoothed_ratio
from calibration.hand_fit.certainty import (
    COVARIANCE_RATIO,
    Information,
    certainty,
    information_at,
    joints_at,
    leaving_untold,
    with_spread,
)
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
from calibration.hand_fit.hand_rendering import ANGLES, N_GEOMETRY, N_PARAMETERS, SHAPE, stepped
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, HandState, pose_with
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.range_scatter import RANGE_STD_M, range_scatter_m, roughness_m
from calibration.registration.mesh_fit import initial_log_brightness
from calibration.registration.mesh_rendering import MeasuredImage
from calibration.registration.radar import Radar
from clradar import DepthMap, Waveform, arrays
from clradar.errors import ClradarWarning, CompareError
from clradar.hand import POSES, pose_by_name
from clradar.opencl import open_device

STEP_M = 4e-3
"""Pixels are about a resolution cell then: their noise is independent."""

N_DRAWS = 6


@pytest.fixture(scope="module")
def fitter() -> HandFitter:
    """Of a bent hand without limits near, in its own rendering."""
    model = ParametricHand("right", "pocl")
    return fitter_on(rendered_depth(model, truth(), STEP_M), model)


def truth() -> HandState:
    state = state_of(pose_by_name("flat"), ParametricHand("right", "pocl"))
    return state.with_angles(state.angles_rad + np.radians(12.0))


def prior_about(angles_rad: np.ndarray) -> Prior:
    state = truth()
    return Prior.about(
        replace(state, pose=pose_with(state.pose, angles_rad)), angle_covariance(12.0)
    )


@pytest.mark.slow
def test_errors_in_speckle_are_as_large_as_the_covariance_says(fitter):
    """Pictures with exponential speckle, ranges with noise, and a prior that is drawn, too.

    Errors of one step of the scoring from the truth. Their variance is below that stated: of the
    prior it is 1, of brightness 0.41 (E (r w)^2 / E w, r exponential less 1, w its weight), of
    ranges 0.25 to 0.5, since in simulations neighbouring cells err together, which those drawn here
    do not, and since the scatter that the image shows is an upper bound.
    """
    rng = np.random.default_rng(3)
    state, picture = truth(), fitter.picture(FINE)
    picture.draw_surface(state)
    brightness = fitter.scaled(state, initial_log_brightness(), FINE)
    power, range_m = picture.power.copy(), picture.measured.range_m.copy()
    angles_rad = state.angles_rad
    spread = np.linalg.cholesky(angle_covariance(12.0))
    squares = []
    for draw in range(N_DRAWS):
        picture.power[:] = power * rng.exponential(size=power.shape)
        picture.measured.range_m[:] = range_m + RANGE_STD_M * rng.standard_normal(power.shape)
        prior = prior_about(angles_rad + spread @ rng.standard_normal(23))
        picture.draw_surface(state, draw)
        information, score, centre_m = fitter.scoring(state, brightness, prior, FINE)
        own = np.flatnonzero(fitter.fitted)
        step = np.zeros(N_PARAMETERS)
        step[own] = np.linalg.solve(information[np.ix_(own, own)], score[own])
        there = stepped(state, 1e-2 * step[:37], centre_m)  # linear
        errors_m = 1e2 * (joints_at(fitter, there) - joints_at(fitter, state))
        squares.append((errors_m[TIPS] ** 2).sum(axis=1))
    known = certainty(fitter, Fitted(state, brightness, 0.0, 0.0), prior, N_DRAWS)
    picture.power[:], picture.measured.range_m[:] = power, range_m
    ratio = COVARIANCE_RATIO**2 * np.mean(squares, axis=0) / known.joint_std_m[TIPS] ** 2
    assert 0.2 < ratio.mean() < 0.8


def test_what_is_not_told_has_the_mean_of_the_prior_given_the_rest(fitter):
    state = truth()
    knuckle, spread, middle, last = range(23)[ANGLES_OF_DIGIT["index"]]
    moved = state.angles_rad.copy()
    moved[middle] += np.radians(20.0)
    moved[last] -= np.radians(15.0)
    moved[spread] += np.radians(3.0)
    prior = prior_about(state.angles_rad)
    measured = np.zeros((N_PARAMETERS, N_PARAMETERS))
    told = np.r_[0:6, ANGLES.start + middle, 37:N_PARAMETERS]
    measured[told, told] = 1e6
    known = Information(measured, prior.information, np.flatnonzero(fitter.fitted), np.zeros(3))
    assert np.flatnonzero(known.told()).tolist() == [middle]
    found = Fitted(
        replace(state, pose=pose_with(state.pose, moved)), initial_log_brightness(), 0.0, np.inf
    )
    left = leaving_untold(fitter, found, prior, known, seed=0)
    change_deg = np.degrees(left.state.angles_rad - state.angles_rad)
    covariance = angle_covariance(12.0)
    expected_deg = 20.0 * covariance[middle] / covariance[middle, middle]
    assert expected_deg[[knuckle, last]] == pytest.approx([12.0, 40.0 / 3.0])
    assert change_deg == pytest.approx(expected_deg, abs=1e-2)
    # A picture that contradicts is believed.
    contradicted = replace(found, deviance=left.deviance - 10.0)
    assert leaving_untold(fitter, contradicted, prior, known, seed=0) is contradicted


@pytest.fixture(scope="module")
def known(fitter) -> Information:
    """At the truth."""
    state = truth()
    found = Fitted(state, initial_log_brightness(), 0.0, 0.0)
    return information_at(fitter, found, prior_about(state.angles_rad), 0)


def test_the_pattern_of_the_samples_is_no_information(fitter, known):
    """Products of two surfaces have less than the squares of one, but for the noise of samples, and
    tell all of an open hand."""
    assert known.told().all()
    fitter.picture(FINE).draw_surface(truth(), 0)
    slopes = fitter.linearised(truth(), initial_log_brightness(), FINE)[1]
    single = (slopes**2).sum(axis=1)[ANGLES]
    shared = COVARIANCE_RATIO**2 * np.diag(known.measured)[ANGLES]
    assert (shared < 1.08 * single).all()
    assert (shared / single).min() > 0.5


def test_averaged_residuals_have_the_variance_of_independent_ones():
    width, ones = np.array([3.0, 4.0]), np.ones((160, 200))
    # Constant ones keep theirs, z^2, and independent ones 1 / (4 pi 3 * 4) of it, but for the edge.
    ratio = smoothed_ratio(0.5 * ones, ones, width, 2.0)
    assert ratio == pytest.approx(0.25 * 4.0 * np.pi * 12.0 / 2.0, rel=0.08)
    alone = np.zeros_like(ones)
    alone[30, 40] = 0.7
    assert smoothed_ratio(3.0 * ones, alone, width, 2.0) == pytest.approx(9.0 / 2.0, rel=1e-3)
    assert smoothed_ratio(ones, 0.0 * ones, width, 2.0) == 0.0


def test_a_hand_whose_ranges_disagree_is_uncertain(fitter, known):
    """The true state is as certain as information says, one with bent fingers is not."""
    state, picture = truth(), fitter.picture(FINE)
    prior = prior_about(state.angles_rad)
    assert known.widening == 1.0
    bent = state.with_angles(state.angles_rad + np.radians(20.0))
    picture.draw_surface(bent)
    brightness = fitter.scaled(bent, initial_log_brightness(), FINE)
    found = Fitted(bent, brightness, 0.0, 0.0)
    of_bent = information_at(fitter, found, prior, 0)
    ratio = range_ratio(picture, picture.render(bent, brightness))
    assert of_bent.widening == pytest.approx(ratio, rel=0.2)
    assert of_bent.widening > 4.0
    narrow, wide = (
        certainty(fitter, found, prior, 0, replace(of_bent, widening=w)) for w in (1.0, 4.0)
    )
    assert wide.angle_std_rad == pytest.approx(2.0 * narrow.angle_std_rad)
    assert wide.covariance == pytest.approx(4.0 * narrow.covariance)
    assert wide.untold == narrow.untold


def test_another_solution_that_is_as_likely_widens(fitter):
    joints_m = joints_at(fitter, truth())
    own = np.tile(1e-6 * np.eye(3), (25, 1, 1))
    other_m = joints_m.copy()
    other_m[TIPS[1]] += [0.0, 20e-3, 0.0]
    joints_m[3] = other_m[3] = np.nan
    as_likely = with_spread(own, joints_m, [(other_m, 0.0)])
    assert as_likely[TIPS[1]] == pytest.approx(own[0] + np.diag([0.0, 2e-4, 0.0]))
    assert as_likely[TIPS[0]] == pytest.approx(own[0])
    assert np.isnan(as_likely[3]).all()
    assert with_spread(own, joints_m, [(other_m, 100.0)])[TIPS[1]] == pytest.approx(own[0])
    assert with_spread(own, joints_m, []) == pytest.approx(own)


def test_ranges_scatter_more_where_the_measured_ones_do():
    axis_m = np.arange(20) * 2e-3
    x, y = np.meshgrid(axis_m, axis_m)
    plane_m = 0.3 + 0.5 * x - 0.2 * y
    step_m = plane_m + np.where(x > 0.019, 15e-3, 0.0)
    images = [
        MeasuredImage(axis_m, axis_m, np.ones((20, 20)), range_m, (2e-3, 2e-3))
        for range_m in (plane_m, step_m)
    ]
    assert roughness_m(images[0]).max() < 1e-7
    flat, edge = (range_scatter_m(image) for image in images)
    assert flat == pytest.approx(RANGE_STD_M, rel=0.08)
    assert edge[:, 9:11].min() > 4e-3
    assert edge[:, :3] == pytest.approx(flat[:, :3], rel=1e-3)


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
def blank() -> HandFitter:
    """On a blank image of few pixels, by few antennas."""
    axis_m = np.arange(-12, 13) * 8e-3
    depth = DepthMap(np.full((25, 25), 0.3), np.ones((25, 25)), axis_m, axis_m, 20.0)
    return fitter_on(depth, shape=True, levels=(FINE,))


@pytest.fixture
def loop(monkeypatch, blank, state):
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
        return close_loop(blank, found, prior, NOTHING_MISSED, given, progress), calls

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


def test_a_round_simulates_the_hand_and_finds_it_where_it_is(blank, state):
    """With its few antennas the image is poor: the fit to it stays within some millimetres."""
    found = Fitted(state, initial_log_brightness(), 0.0, 0.0)
    prior = Prior.about(state, angle_covariance())
    given = LoopSettings(RADAR, None, 3, open_device("pocl"))
    one = closed_loop._round(
        blank, blank.depth, state, 0.5, found, prior, NOTHING_MISSED, given, CENTRE_M
    )
    assert one.alpha == 0.5
    assert one.scene.alpha.max() == one.scene.alpha.min() == 0.5
    assert one.capture.meta["rays"]["paths"] > 0
    assert np.isfinite(one.features).all()
    assert np.abs(one.bias).max() > 0
    assert np.linalg.norm(one.bias[3:6]) < 10e-3
    volume = closed_loop.image_of(one.capture, blank.depth, one.scene, given.device)
    assert volume.grid.shape[1:] == blank.depth.depth_m.shape
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
