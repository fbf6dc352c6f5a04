"""Alpha between simulations of several alphas."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.registration.alpha_cue import ALPHA_STARTS, ALPHA_TOLERANCE, next_alpha


def look(alpha: float) -> np.ndarray:
    """A look that bends, as that of a hand does, but tells every alpha from every other."""
    return np.array([20.0 * alpha, 8.0 * abs(alpha - 0.1), 5.0 * alpha**2])


@pytest.mark.parametrize("wanted", [0.0, 0.05, 0.2, 0.45, 0.7])
def test_comes_to_rest_at_the_alpha_of_the_look(wanted):
    """What bends between the starts is missed by less than the tolerance after a few more."""
    alphas, looks = list(ALPHA_STARTS), [look(a) for a in ALPHA_STARTS]
    for _ in range(5):
        alphas.append(next_alpha(alphas, looks, look(wanted)))
        looks.append(look(alphas[-1]))
    assert abs(alphas[-1] - wanted) < ALPHA_TOLERANCE


def test_one_alpha_alone_stays():
    """Where no other could be simulated."""
    assert next_alpha([0.6], [look(0.6)], look(0.2)) == 0.6


def test_neighbours_are_averaged():
    """Two simulations of nearly one alpha differ by speckle, which must not count as a slope."""
    alphas = [*ALPHA_STARTS, 0.2, 0.21]
    looks = [look(a) for a in alphas]
    looks[-2], looks[-1] = looks[-2] + [1.5, 0.0, 0.0], looks[-1] - [1.5, 0.0, 0.0]
    # The mean of the two is off by nothing; a line through them would fall where looks rise.
    assert next_alpha(alphas, looks, look(0.25)) == pytest.approx(0.25, abs=ALPHA_TOLERANCE)


@pytest.mark.parametrize("factor", [10.0, -10.0])
def test_never_leaves_the_range(factor):
    looks = [look(a) for a in ALPHA_STARTS]
    assert 0.0 <= next_alpha(list(ALPHA_STARTS), looks, factor * look(1.0)) <= 1.0
