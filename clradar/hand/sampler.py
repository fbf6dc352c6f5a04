"""Random poses of a hand."""

from __future__ import annotations

import numpy as np

from clradar.hand.known_poses import LETTERS, POSES
from clradar.hand.pose import HandPose, interpolate_poses


def random_pose(rng: np.random.Generator) -> HandPose:
    """Return a plausible pose within the limits; the generator's state alone decides."""
    one, other = rng.choice(len(LETTERS), 2)
    return interpolate_poses(POSES[LETTERS[one]], POSES[LETTERS[other]], float(rng.uniform()))
