"""Whole fits of what is no hand, and of half a hand."""

from dataclasses import replace

import numpy as np
import pytest
from hand_renderings import rendered_depth, state_of

from calibration import HandFit, fit_hand
from calibration.hand_fit.hand_model import ParametricHand
from clradar import DepthMap
from clradar.errors import ClradarWarning, CompareError
from clradar.hand import POSES

pytestmark = pytest.mark.slow


def seen(letter: str) -> DepthMap:
    """The rendering's own picture of a letter."""
    hand = ParametricHand("right", "pocl")
    return rendered_depth(hand, state_of(POSES[letter], hand))


def fitted(depth: DepthMap, start: str) -> HandFit:
    return fit_hand(depth, start, closed_loop=False, device="pocl")


def test_noise_is_no_hand():
    axis_m = 2e-3 * np.arange(-50, 51)
    rng = np.random.default_rng(0)
    amplitude = rng.rayleigh(size=(101, 101))
    depth = DepthMap(rng.uniform(0.28, 0.32, (101, 101)), amplitude, axis_m, axis_m, 20.0)
    with pytest.raises(CompareError, match=r"^could not fit the hand, because .* it shows noise"):
        fitted(depth, "F")


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
