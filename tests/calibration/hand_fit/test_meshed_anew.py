"""The last steps of the fit of a hand, with slopes of surfaces that are meshed anew."""

from dataclasses import replace

import numpy as np
import pytest
from hand_renderings import fitter_on, rendered_depth, state_of

from calibration.hand_fit.descent import FINE, Fitted, HandFitter
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_rendering import N_GEOMETRY, N_PARAMETERS, SHAPE, stepped
from calibration.hand_fit.hand_shape_vector import vector_of
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.meshed_anew import missed_slopes, settled
from calibration.hand_fit.misfit import misfit
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.registration.mesh_fit import cell_pixels, initial_log_brightness
from clradar.hand import pose_by_name
from clradar.opencl import open_device

GIRTH = SHAPE.stop - 1
RING_BENT, THUMB_END = 19, 10
"""The ring finger's knuckle, and the thumb's last joint."""


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


def test_nothing_is_missed_of_the_motion_and_of_what_is_not_fitted(fitter, started):
    missed = missed_slopes(only(fitter, RING_BENT), started, 1)
    for slopes in (missed.by_power, missed.by_range):
        assert np.flatnonzero(slopes.any(axis=1)).tolist() == [RING_BENT]
    assert not missed_slopes(only(fitter, 2), started, 1).by_power.any()


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
