"""Renderings of hands, their derivatives, and the descent on a hand's own rendering."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hand_renderings import TIPS, fitter_on, rendered_depth, state_of
from scipy.spatial import KDTree

from calibration.hand_fit.bone_rates import bone_rates
from calibration.hand_fit.descent import (
    BRIGHTNESS,
    FINE,
    MIDDLE,
    Fitted,
    HandFitter,
    fitted_parameters,
)
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_rendering import N_GEOMETRY, N_PARAMETERS, SHAPE, stepped
from calibration.hand_fit.hand_shape_vector import vector_of
from calibration.hand_fit.hand_state import HandState, angles_of, pose_with
from calibration.hand_fit.meshed_anew import missed_slopes, settled
from calibration.hand_fit.misfit import deviance_map, misfit
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.skinned import SkinnedSamples
from calibration.registration.mesh_fit import (
    POWER_FLOOR,
    TUKEY_CUTOFF,
    cell_pixels,
    initial_log_brightness,
)
from calibration.registration.mesh_rendering import MeasuredImage
from clradar.hand import pose_by_name
from clradar.hand.pose import HandPose, JointAngles
from clradar.hand.shape import AVERAGE
from clradar.opencl import open_device

KINDS = ("right", "left", "rig")
CENTRE_M = np.array([0.01, -0.02, 0.3])


def bent() -> HandState:
    """Within the limits of every angle, also those of the wrist and the twist of the thumb."""
    pose = pose_by_name("C")
    wrist = JointAngles.from_degrees(5.0, 4.0, -3.0)
    state = state_of(HandPose("bent", {**pose.joints, "wrist": wrist}), ParametricHand())
    state = state.with_angles(state.angles_rad + np.radians(np.linspace(3.0, 9.0, 23)))
    return stepped(state, np.r_[0.1, -0.15, 0.1, np.zeros(N_GEOMETRY - 3)], CENTRE_M)


@pytest.mark.parametrize("kind", ["right", "left", "rig"])
def test_rates_of_bones_are_differences(hands, kind):
    model, state, step = hands[kind], bent(), 1e-5

    def bones_at(changed: HandState):
        return model.bones(changed.pose, changed.shape).moved(changed.transform)

    # Tips carry no skin, and their axes have no meaning.
    rates = bone_rates(model, state, bones_at(state), CENTRE_M)
    for k, away in enumerate(step * np.eye(N_GEOMETRY)):
        ahead, behind = (bones_at(stepped(state, sign * away, CENTRE_M)) for sign in (1, -1))
        # Of lengths below 0.2 m: the next term, step^2 / 6, and rounding, 2e-17 / step, are below
        # 4e-12; those of the shape are one-sided, with a step of 1e-6.
        tolerance = 1e-6 if k >= SHAPE.start else 1e-10
        origin_m = (ahead.origin_m - behind.origin_m) / (2 * step)
        matrix = np.delete((ahead.matrix - behind.matrix) / (2 * step), TIPS, axis=0)
        assert np.abs(rates.origin_m[k] - origin_m).max() < tolerance, k
        assert np.abs(np.delete(rates.matrix[k], TIPS, axis=0) - matrix).max() < tolerance, k
        assert origin_m.any() == (model.has_shape or k < SHAPE.start), k


def test_rates_at_the_limits_of_a_shape_are_those_of_one_side(hands):
    model, state = hands["right"], bent()
    longest = replace(state, shape=replace(AVERAGE, length_m=0.26))
    almost = replace(state, shape=replace(AVERAGE, length_m=0.26 - 1e-6))
    of_longest, of_almost = (
        bone_rates(model, s, model.bones(s.pose, s.shape).moved(s.transform), CENTRE_M).origin_m
        for s in (longest, almost)
    )
    assert np.abs(of_longest[SHAPE]).max() > 0.1
    assert np.abs(of_longest - of_almost).max() < 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_differences_of_renderings(hands, kind):
    model, state = hands[kind], bent()
    wanted = fitted_parameters(model.has_shape)
    depth = rendered_depth(model, state, 4e-3)
    fitter = fitter_on(depth, model, shape=model.has_shape, levels=(MIDDLE,))
    picture = fitter.picture(MIDDLE)
    picture.draw_surface(state)
    brightness = initial_log_brightness()
    rendered = picture.render(state, brightness)
    found = picture.derivatives(state, brightness, CENTRE_M, wanted, rendered)
    # So small that next to no sample crosses a pixel's middle, where bilinear weights have kinks,
    # and large against rounding, which is below 1e-4 of the derivative. One sample that does makes
    # 2e-3 of it.
    step = 1e-7
    lit = (rendered[0] > 1e-3 * rendered[0].max()).ravel()
    for row, k in enumerate(np.flatnonzero(wanted)):
        ends = []
        for sign in (1, -1):
            there, brighter = state, brightness
            if k < N_GEOMETRY:
                there = stepped(state, sign * step * np.eye(N_GEOMETRY)[k], CENTRE_M)
            else:
                brighter = brightness + sign * step * np.eye(7)[k - BRIGHTNESS.start]
            ends.append(picture.render(there, brighter))
        for own, ahead, behind in zip(found, *ends, strict=True):
            central = (ahead - behind).ravel()[lit] / (2 * step)
            error = np.linalg.norm(own[row][lit] - central) / np.linalg.norm(central)
            assert error < 4e-3, k


def test_the_gradient_of_the_deviance_is_the_score():
    """Of a pixel: c^2 / (1 + c^2) (...) has the derivative -s / (1 + s^2 / c^2) by ln(I + f)."""
    picture = SimpleNamespace()
    picture.power = np.array([[1e-3, 0.02, 0.3, 1.0]])
    picture.measured = MeasuredImage(
        np.arange(4.0), np.zeros(1), picture.power, np.full((1, 4), np.nan), (1.0, 1.0)
    )
    picture.range_std_m = np.ones((1, 4))
    power = np.array([[0.3, 0.1, 0.1, 0.02]])
    step = 1e-5

    def value(scale: float) -> np.ndarray:
        there = ((power + POWER_FLOOR) * np.exp(scale) - POWER_FLOOR, np.ones((1, 4)))
        return deviance_map(picture, there, misfit(picture, there))

    here = misfit(picture, (power, np.ones((1, 4))))
    slope = (value(step) - value(-step)) / (2 * step)
    assert slope == pytest.approx(-here.speckle * here.speckle_weights, rel=1e-6)


def test_a_pixel_that_the_hand_does_not_cover_costs_as_much_as_an_outlier():
    power = np.ones((1, 3))
    canvas = SimpleNamespace(power=power)
    found = SimpleNamespace(
        range_m=np.array([[0.0, 0.0, 1.0]]), range_std_m=np.full((1, 3), 1e-3),
        covered=np.array([[1.0, 0.0, 1.0]]), measured=np.array([[True, True, True]]),
    )  # fmt: skip
    hit, uncovered, outlier = deviance_map(canvas, (power, power), found)[0]
    assert hit == pytest.approx(0.0, abs=1e-12)
    assert uncovered == outlier == pytest.approx(TUKEY_CUTOFF**2 / 12)


GIRTH = SHAPE.stop - 1
RING_BENT = 19
"""The ring finger's knuckle."""


@pytest.fixture(scope="module")
def truth() -> HandState:
    return state_of(pose_by_name("S"), ParametricHand("right", "pocl"))


@pytest.fixture(scope="module")
def fitter(truth) -> HandFitter:
    model = ParametricHand("right", "pocl")
    return fitter_on(rendered_depth(model, truth), model, shape=True, levels=(FINE,))


@pytest.fixture(scope="module")
def started(fitter, truth) -> Fitted:
    fitter.picture(FINE).draw_surface(truth, 1)
    brightness = fitter.scaled(truth, initial_log_brightness(), FINE)
    return Fitted(truth, brightness, np.inf, np.inf)


def only(fitter: HandFitter, k: int) -> HandFitter:
    """The same, with one parameter to fit."""
    fitted = np.arange(N_PARAMETERS) == k
    device = open_device("pocl")
    return HandFitter(fitter.model, fitter.depth, fitter.aperture, device, fitted, (FINE,))


def test_slopes_by_the_girth_are_those_of_surfaces_that_are_meshed_anew(fitter, started):
    """Where fingers of a fist touch, moving samples alone have others."""
    missed = missed_slopes(only(fitter, GIRTH), started, 1)
    picture, state, brightness = fitter.picture(FINE), started.state, started.log_brightness
    step = np.where(np.arange(N_GEOMETRY) == GIRTH, 0.04, 0.0)
    ends = [stepped(state, way * step, np.zeros(3)) for way in (1.0, -1.0)]
    # Other samples than those that the slopes were found with.
    high, low = (picture.meshed_anew(end, brightness, 2) for end in ends)
    picture.draw_surface(state, 1)
    _, alone, _ = fitter.linearised(state, brightness, FINE)
    _, whole, _ = fitter.linearised(state, brightness, FINE, missed=missed)
    found = misfit(picture, picture.render(state, brightness))
    weight = np.sqrt(found.speckle_weights / cell_pixels(picture)) / found.dark
    anew = (weight * (high[0] - low[0])).ravel() / 0.08
    by_power = slice(0, anew.size)
    # 0.67 and 0.49: the samples' pattern is in all of them.
    assert _alike(whole[GIRTH, by_power], anew) > _alike(alone[GIRTH, by_power], anew) + 0.1


@pytest.mark.slow
def test_a_fit_settles_nearer_to_the_truth_and_never_in_a_higher_deviance(fitter, truth, started):
    step = np.zeros(N_GEOMETRY)
    step[GIRTH], step[RING_BENT] = -0.05, 0.1
    away = replace(started, state=stepped(truth, step, np.zeros(3)))
    prior, missed = Prior.about(truth, angle_covariance()), missed_slopes(fitter, started, 1)
    before = fitter.judged(away, prior, seed=5)
    found = settled(fitter, away, prior, missed, 5)
    assert found.deviance < before.deviance - 1.0
    girth = vector_of(found.state.shape)[-1] - vector_of(truth.shape)[-1]
    assert abs(girth) < 0.025
    again = settled(fitter, found, prior, missed, 5)
    assert again.deviance <= found.deviance


def _alike(one: np.ndarray, other: np.ndarray) -> float:
    return float(one @ other / np.sqrt((one @ one) * (other @ other)))


@pytest.mark.parametrize("kind", ["right", "left", "rig"])
def test_samples_follow_the_bones_as_the_mesh_does(hands, kind):
    """A bent finger takes its skin along: 0.5 mm is what blending differs from a mesh made anew,
    where 20 degrees at the knuckle move the tip by 30 mm."""
    model, pose = hands[kind], pose_by_name("flat")
    bent = pose_with(pose, angles_of(pose) + np.radians(20.0) * np.eye(23)[13])
    mesh = model.mesh(pose, AVERAGE, 3e-3)
    normals = mesh.to_trimesh().vertex_normals
    bones = model.bones(pose, AVERAGE)
    skin = model.skin(mesh, pose, AVERAGE, mesh.vertices_m, normals)
    points_m, _ = SkinnedSamples.of(mesh.vertices_m, normals, skin, bones).posed(
        model.bones(bent, AVERAGE)
    )
    anew = model.mesh(bent, AVERAGE, 3e-3).to_trimesh()
    near_tip = np.argsort(np.linalg.norm(points_m - model.joints_m(bent, AVERAGE)[19], axis=1))[:60]
    away_m, _ = KDTree(anew.vertices).query(points_m[near_tip])
    assert np.median(away_m) < 1.6e-3  # half the spacing of the vertices
    assert np.linalg.norm(points_m - mesh.vertices_m, axis=1).max() > 20e-3
