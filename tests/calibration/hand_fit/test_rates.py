"""Derivatives of bones and of renderings, against differences."""

from dataclasses import replace

import numpy as np
import pytest
from hand_renderings import TIPS, fitter_on, rendered_depth, state_of
from nightly import nightly

from calibration.hand_fit.bone_rates import bone_rates
from calibration.hand_fit.descent import BRIGHTNESS, MIDDLE, fitted_parameters
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_rendering import N_GEOMETRY, SHAPE, stepped
from calibration.hand_fit.hand_state import HandState
from calibration.registration.mesh_fit import initial_log_brightness
from clradar.hand import pose_by_name
from clradar.hand.pose import HandPose, JointAngles
from clradar.hand.shape import AVERAGE

KINDS = ("right", "left", "rig")
CENTRE_M = np.array([0.01, -0.02, 0.3])


def bent() -> HandState:
    """Within the limits of every angle, also those of the wrist and the twist of the thumb."""
    pose = pose_by_name("C")
    wrist = JointAngles.from_degrees(5.0, 4.0, -3.0)
    state = state_of(HandPose("bent", {**pose.joints, "wrist": wrist}), ParametricHand())
    state = state.with_angles(state.angles_rad + np.radians(np.linspace(3.0, 9.0, 23)))
    return stepped(state, np.r_[0.1, -0.15, 0.1, np.zeros(N_GEOMETRY - 3)], CENTRE_M)


@pytest.mark.parametrize("kind", KINDS)
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


@pytest.mark.parametrize("kind", ["right", "rig", *nightly(["left"])])
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
