"""The search for the pose of one digit: its pictures, its chain, its limits, and what it finds."""

import numpy as np
import pytest
from hand_renderings import fitter_on, rendered_depth

from calibration.hand_fit.basins import beside
from calibration.hand_fit.certainty import joints_at
from calibration.hand_fit.descent import COARSE, LEVELS, Fitted, HandFitter
from calibration.hand_fit.digit_chain import DigitChain
from calibration.hand_fit.digit_search import DigitSearch
from calibration.hand_fit.hand_model import ParametricHand
from calibration.hand_fit.hand_state import (
    ANGLES_OF_DIGIT,
    HIGHEST_RAD,
    LOWEST_RAD,
    HandState,
    pose_with,
)
from calibration.hand_fit.layers import HandSkin, LayeredRendering, on_digit
from calibration.hand_fit.prior import Prior, angle_covariance
from calibration.hand_fit.result import DIGITS, TIPS
from calibration.registration.mesh_fit import POWER_FLOOR, initial_log_brightness
from clradar.hand import pose_by_name
from clradar.hand.shape import AVERAGE
from clradar.opencl import open_device

PLACE = np.array([[1, 0, 0, 0.0], [0, 1, 0, -0.09], [0, 0, 1, 0.3], [0, 0, 0, 1]])
NOMINAL = HandState(pose_by_name("B"), AVERAGE, PLACE)
KNUCKLE = ANGLES_OF_DIGIT["ring"].start


@pytest.fixture(scope="module")
def bent() -> HandState:
    """The knuckle of the ring finger bent by 35 degrees."""
    angles = NOMINAL.angles_rad
    angles[KNUCKLE] += np.radians(35.0)
    return NOMINAL.with_angles(angles)


@pytest.fixture(scope="module")
def fitter(bent) -> HandFitter:
    """On the picture that the rendering itself has of the hand with the bent finger."""
    model = ParametricHand("right", "pocl")
    return fitter_on(rendered_depth(model, bent, 3e-3), model, levels=LEVELS)


def brightness_on(fitter: HandFitter, state: HandState) -> np.ndarray:
    fitter.picture(COARSE).draw_surface(state)
    return fitter.scaled(state, initial_log_brightness(), COARSE)


@pytest.fixture(scope="module")
def skin(fitter) -> HandSkin:
    return HandSkin(fitter.model, NOMINAL.pose, AVERAGE, open_device("pocl"))


@pytest.mark.parametrize("kind", ["right", "left", "rig"])
@pytest.mark.parametrize("digit", ["thumb", "ring"])
def test_a_chain_takes_bones_where_the_skeleton_does(hands, kind, digit):
    model = hands[kind]
    rng = np.random.default_rng(3)
    own = ANGLES_OF_DIGIT[digit]
    angles = np.repeat(NOMINAL.angles_rad[None], 3, axis=0)
    angles[:, own] += 0.5 * rng.normal(size=angles[:, own].shape)
    angles = np.clip(angles, LOWEST_RAD, HIGHEST_RAD)
    places = DigitChain(model, NOMINAL, digit).places(angles)
    carrying = np.delete(np.arange(25), TIPS)  # a tip carries no skin, its axes have no meaning
    for k, row in enumerate(angles):
        there = model.bones(pose_with(NOMINAL.pose, row), AVERAGE).moved(PLACE)
        # 1e-12: products of five rotations in double precision.
        assert np.abs(places.origin_m[k] - there.origin_m).max() < 1e-12
        assert np.abs(places.matrix[k] - there.matrix)[carrying].max() < 1e-12


@pytest.mark.parametrize("digit", ["thumb", "ring"])
def test_layers_picture_a_hand_as_its_rendering_does(fitter, skin, bent, digit):
    """The rest drawn with the finger straight, the digit by blended skin of another pose."""
    picture, brightness = fitter.picture(COARSE), initial_log_brightness()
    picture.draw_surface(bent)
    power, range_m = picture.render(bent, brightness)
    whole = skin.drawn(NOMINAL.pose, AVERAGE)
    rest = whole[~on_digit(whole, digit)]
    start = bent if digit == "thumb" else NOMINAL
    layers = LayeredRendering(picture, rest, picture.bones_at(start), brightness)
    angles = bent.angles_rad[None]
    ((_, samples),) = skin.of_digit(digit, angles)
    places = DigitChain(fitter.model, start, digit).places(angles)
    ((found, found_m),) = layers.pictures(samples, places)
    one, other = (np.log1p(p / power.max() / POWER_FLOOR).ravel() for p in (power, found[0]))
    assert np.corrcoef(one, other)[0, 1] > 0.98
    lit = power > POWER_FLOOR * power.max()
    assert np.median(np.abs(found_m[0] - range_m)[lit]) < 0.5e-3


def test_a_finger_far_from_its_start_is_found(fitter, skin, bent):
    """By the coarse pictures alone, within the reach of the descent: 8 mm."""
    prior = Prior.about(NOMINAL, angle_covariance())
    search = DigitSearch(fitter, skin, prior, COARSE)
    brightness = brightness_on(fitter, NOMINAL)
    whole = skin.drawn(NOMINAL.pose, AVERAGE)
    tip = TIPS[DIGITS.index("ring")]
    true_m, start_m = (joints_at(fitter, state)[tip] for state in (bent, NOMINAL))
    assert np.linalg.norm(true_m - start_m) > 30e-3
    found = search.digit(NOMINAL, brightness, whole, "ring")
    there_m = joints_at(fitter, found[0].state)[tip]
    assert np.linalg.norm(there_m - true_m) < 8e-3
    again = search.digit(NOMINAL, brightness, whole, "ring")
    assert [one.deviance for one in again] == [one.deviance for one in found]
    for one in found:
        angles = one.state.angles_rad
        assert (angles >= LOWEST_RAD - 1e-9).all()
        assert (angles <= HIGHEST_RAD + 1e-9).all()
        others = np.delete(np.arange(23), np.r_[ANGLES_OF_DIGIT["ring"]])
        assert np.array_equal(angles[others], NOMINAL.angles_rad[others])


def test_beside_a_fit_one_digit_is_elsewhere(fitter, skin, bent):
    """First the ring finger, on its way to where it is."""
    prior = Prior.about(NOMINAL, angle_covariance())
    start = Fitted(NOMINAL, brightness_on(fitter, NOMINAL), 0.0, 0.0)
    found = beside(start, fitter, prior, skin)
    tips_m = [joints_at(fitter, one.state)[list(TIPS)] for one in found]
    true_m, start_m = (joints_at(fitter, state)[list(TIPS)] for state in (bent, NOMINAL))
    for there_m in tips_m:
        away_m = np.linalg.norm(there_m - start_m, axis=1)
        assert np.count_nonzero(away_m > 10e-3) == 1
        assert np.count_nonzero(away_m > 1e-6) == 1
    assert np.linalg.norm(tips_m[0] - true_m, axis=1).max() < 20e-3
