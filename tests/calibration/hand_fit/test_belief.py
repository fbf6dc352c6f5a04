"""What frames of a moving hand tell of the next one."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.hand_fit.belief import (
    MOST_STD_RAD,
    SHAPE_FRAMES,
    SPEED_LASTS_S,
    SPEED_STD_DEG_S,
    Belief,
)
from calibration.hand_fit.hand_shape_vector import shape_covariance, shape_of, vector_of
from calibration.hand_fit.hand_state import HIGHEST_RAD, LOWEST_RAD, N_ANGLES, HandState
from calibration.hand_fit.prior import angle_covariance
from clradar.hand import pose_by_name
from clradar.hand.shape import AVERAGE

STATE = HandState(pose_by_name("F"), AVERAGE, np.eye(4))
STEP_S = 0.125


def measured_exactly(belief: Belief, state: HandState, std: float = 1e-4) -> Belief:
    """After a frame that tells all known quantities within `std`."""
    known = belief.known
    information = np.linalg.inv(belief.covariance[known, known])
    return belief.measured(state, np.linalg.inv(information + np.eye(known.stop) / std**2))


@pytest.mark.parametrize("fit_shape", [False, True])
def test_a_belief_begins_at_the_prior_of_a_fit(fit_shape):
    belief = Belief.of_start(STATE, 12.0, fit_shape)
    prior = belief.prior(STATE)
    np.testing.assert_array_equal(prior.mean_rad, STATE.angles_rad)
    np.testing.assert_array_equal(prior.mean_shape, vector_of(AVERAGE))
    own = np.linalg.inv(prior.information[6 : 6 + N_ANGLES, 6 : 6 + N_ANGLES])
    np.testing.assert_allclose(own, angle_covariance(12.0), rtol=0, atol=1e-12)
    assert (belief.shape_std.size > 0) == fit_shape


def test_measured_angles_tell_the_velocity():
    """A joint that turns evenly is soon predicted: the forgetting of velocities leaves a part."""
    rate_rad_s = np.zeros(N_ANGLES)
    rate_rad_s[7] = 0.8
    belief = Belief.of_start(STATE, 12.0, False)
    for frame in range(6):
        state = STATE.with_angles(STATE.angles_rad - frame * STEP_S * rate_rad_s)
        belief = measured_exactly(belief if frame == 0 else belief.after(STEP_S), state)
    ahead = belief.after(STEP_S).mean[:N_ANGLES] - state.angles_rad
    lasts = np.exp(-STEP_S / SPEED_LASTS_S)
    np.testing.assert_allclose(ahead, -lasts * STEP_S * rate_rad_s, rtol=0, atol=1e-3)


def test_a_measured_belief_is_that_of_the_normal_distribution():
    """Against the joint distribution conditioned on a measurement with the same information."""
    before = Belief.of_start(STATE, 12.0, True).after(STEP_S)
    n, known = len(before.mean), before.known
    noise = np.diag(np.linspace(1e-4, 1e-2, known.stop))
    seen = np.eye(n)[known]
    gain = before.covariance @ seen.T @ np.linalg.inv(before.covariance[known, known] + noise)
    result = 0.02 * np.cos(np.arange(known.stop))
    mean = before.mean + gain @ result
    covariance = before.covariance - gain @ seen @ before.covariance
    shape = shape_of(mean[N_ANGLES : known.stop])
    # Angles near their limits would be clipped by a state.
    state = HandState(STATE.pose, shape, np.eye(4)).with_angles(mean[:N_ANGLES])
    inside = np.abs(state.angles_rad - mean[:N_ANGLES]) < 1e-9
    after = before.measured(state, covariance[known, known])
    np.testing.assert_allclose(after.covariance, covariance, rtol=0, atol=1e-12)
    moved = np.flatnonzero(inside)
    np.testing.assert_allclose(after.mean[moved], mean[moved], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after.mean[N_ANGLES : known.stop], mean[N_ANGLES : known.stop],
                               rtol=0, atol=1e-12)  # fmt: skip


def test_the_information_on_the_shape_adds_up_to_that_of_two_frames():
    """Each frame has all of its own, half of the one before, a quarter ...: twice one's in all."""
    belief = Belief.of_start(STATE, 12.0, True)
    each = 1.0 / 0.03**2
    seen = replace(STATE, shape=shape_of(vector_of(AVERAGE) + 0.01))
    for frame in range(40):
        belief = belief if frame == 0 else belief.after(STEP_S)
        known = belief.known
        information = np.linalg.inv(belief.covariance[known, known])
        told = information[N_ANGLES:, N_ANGLES:] @ belief.mean[N_ANGLES : known.stop]
        information[N_ANGLES:, N_ANGLES:] += each * np.eye(8)
        # The mean of a normal distribution, whose angles have no part in that of the shape.
        shape = np.linalg.solve(
            information[N_ANGLES:, N_ANGLES:], told + each * vector_of(seen.shape)
        )
        state = replace(STATE, shape=shape_of(shape))
        belief = belief.measured(state, np.linalg.inv(information))
    inner = np.linalg.inv(shape_covariance())
    all_of_it = np.linalg.inv(inner + SHAPE_FRAMES * each * np.eye(8))
    np.testing.assert_allclose(belief.shape_std, np.sqrt(np.diag(all_of_it)), rtol=1e-9)
    mean = SHAPE_FRAMES * each * all_of_it @ vector_of(seen.shape)
    np.testing.assert_allclose(belief.mean[N_ANGLES : known.stop], mean, rtol=0, atol=1e-9)


def test_what_is_not_measured_stays_within_the_limits():
    belief = Belief.of_start(STATE, 12.0, False)
    for _ in range(100):
        belief = belief.after(STEP_S)
    std = np.sqrt(np.diag(belief.covariance))
    assert (std[:N_ANGLES] <= MOST_STD_RAD * (1 + 1e-12)).all()
    assert (belief.mean[:N_ANGLES] >= LOWEST_RAD).all()
    assert (belief.mean[:N_ANGLES] <= HIGHEST_RAD).all()
    # Velocities keep the spread that they have without any measurement.
    speed = np.sqrt(np.diag(angle_covariance(SPEED_STD_DEG_S)))
    np.testing.assert_allclose(std[N_ANGLES:], speed, rtol=1e-9)
    assert np.linalg.eigvalsh(belief.covariance).min() > 0
