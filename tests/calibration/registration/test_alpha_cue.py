"""Alpha between simulations of several alphas."""

import numpy as np
import pytest

from calibration.registration.alpha_cue import ALPHA_STARTS, ALPHA_TOLERANCE, next_alpha


def features_of(alpha: float) -> np.ndarray:
    """Curved features, as those of a hand, but different for all alphas."""
    return np.array([20.0 * alpha, 8.0 * abs(alpha - 0.1), 5.0 * alpha**2])


@pytest.mark.parametrize("wanted", [0.0, 0.2, 0.7])
def test_comes_to_rest_at_the_alpha_of_the_features_of(wanted):
    """The curvature between the starts costs a few more simulations."""
    alphas, features = list(ALPHA_STARTS), [features_of(a) for a in ALPHA_STARTS]
    for _ in range(5):
        alphas.append(next_alpha(alphas, features, features_of(wanted)))
        features.append(features_of(alphas[-1]))
    assert abs(alphas[-1] - wanted) < ALPHA_TOLERANCE


def test_neighbours_are_averaged():
    """Two simulations of nearly one alpha differ by speckle, which must not count as a slope."""
    alphas = [*ALPHA_STARTS, 0.2, 0.21]
    features = [features_of(a) for a in alphas]
    features[-2], features[-1] = features[-2] + [1.5, 0.0, 0.0], features[-1] - [1.5, 0.0, 0.0]
    # The mean of the two is off by nothing; a line through them would fall where features rise.
    assert next_alpha(alphas, features, features_of(0.25)) == pytest.approx(
        0.25, abs=ALPHA_TOLERANCE
    )
