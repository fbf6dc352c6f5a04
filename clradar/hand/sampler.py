"""Random plausible poses: correlated joint angles, with rejection of poses that penetrate."""

from __future__ import annotations

import numpy as np

from clradar.hand.contact import overlaps
from clradar.hand.joints import FINGERS, LIMITS_DEG
from clradar.hand.pose import HandPose, JointAngles

MOST_OVERLAP_M = 1.5e-3
"""Largest penetration depth of two digits of a random pose: skin in contact deforms."""

MOST_PALM_OVERLAP_M = 4e-3
"""The same for a digit and the palm, whose muscles and pads deform more."""

# Neighbouring fingers bend together: tendons and muscles are shared (Santello, Flanders and
# Soechting, "Postural hand synergies for tool use", Journal of Neuroscience 18(23), 1998).
_NEIGHBOURS = 0.6
# A finger's knuckle and its middle joint: hooks and flat fists exist, but are less frequent.
_KNUCKLE = 0.6
# The last joint bends by about two thirds of the middle one (Rijpkema and Girard, "Computer
# animation of knowledge-based human grasping", SIGGRAPH 1991), which fingertips that press change.
_LAST_SHARE, _LAST_SIGMA_DEG = 2.0 / 3.0, 6.0

_KNUCKLE_DEG = (-8.0, 92.0)
_MIDDLE_DEG = (0.0, 108.0)
_SPREAD_DEG = {"index": (4.0, 6.0), "middle": (0.0, 4.0), "ring": (2.0, 5.0), "pinky": (8.0, 9.0)}
_TWIST_SIGMA_DEG = 2.0
_HOLLOW_DEG = {"ring": 8.0, "pinky": 18.0}
_THUMB_FLEXION_DEG, _THUMB_ABDUCTION_DEG = (-62.0, 18.0), (2.0, 66.0)
_THUMB_TWIST_SIGMA_DEG = 12.0
_THUMB_KNUCKLE_DEG, _THUMB_LAST_DEG = (-8.0, 60.0), (-12.0, 70.0)
_WRIST_SIGMA_DEG = (14.0, 7.0, 14.0)


def random_pose(rng: np.random.Generator) -> HandPose:
    """Draw a plausible pose; it depends on the state of the generator alone.

    Flexions are correlated: those of neighbouring fingers, those of a finger's knuckle and middle
    joint, and the last joint follows the middle one. Fingers spread less the more they are bent.
    The thumb moves into opposition as it comes to the front. The wrist is within its own range,
    the palm towards the radar. Poses in which digits penetrate by more than `MOST_OVERLAP_M`, or
    the palm by more than `MOST_PALM_OVERLAP_M`, are rejected.

    Parameters
    ----------
    rng : numpy.random.Generator

    Examples
    --------
    >>> import numpy as np
    >>> from clradar.hand import random_pose
    >>> pose = random_pose(np.random.default_rng(1))
    >>> [round(pose.angles(f"{name}-finger-phalanx-proximal").degrees()[0])
    ...  for name in ("index", "middle", "ring", "pinky")]
    [61, 14, 25, 37]
    """
    while True:
        pose = _drawn(rng)
        if all(
            found.depth_m <= (MOST_PALM_OVERLAP_M if "palm" in found.parts else MOST_OVERLAP_M)
            for found in overlaps(pose)
        ):
            return pose


def _between(ends: tuple[float, float], normal: float) -> float:
    """Return a number that is uniform between two ends if `normal` is a standard normal deviate."""
    from scipy.special import ndtr

    return ends[0] + (ends[1] - ends[0]) * float(ndtr(normal))


def _mixed(shared: float, own: float, correlation: float) -> float:
    """Return a standard normal deviate with this correlation to `shared`."""
    return correlation * shared + float(np.sqrt(1.0 - correlation**2)) * own


def _drawn(rng: np.random.Generator) -> HandPose:
    joints: dict[str, JointAngles] = {}

    def bend(
        joint: str, flexion_deg: float, abduction_deg: float = 0.0, twist_deg: float = 0.0
    ) -> None:
        limits = LIMITS_DEG[joint].values()
        wanted_deg = (flexion_deg, abduction_deg, twist_deg)
        joints[joint] = JointAngles.from_degrees(
            *(float(np.clip(a, *limit)) for a, limit in zip(wanted_deg, limits, strict=True))
        )

    middle = rng.standard_normal()
    for i, finger in enumerate(FINGERS):
        if i > 0:
            middle = _mixed(middle, rng.standard_normal(), _NEIGHBOURS)
        knuckle_deg = _between(_KNUCKLE_DEG, _mixed(middle, rng.standard_normal(), _KNUCKLE))
        middle_deg = _between(_MIDDLE_DEG, middle)
        last_deg = _LAST_SHARE * middle_deg + _LAST_SIGMA_DEG * rng.standard_normal()
        mean_deg, sigma_deg = _SPREAD_DEG[finger]
        free = float(np.cos(np.deg2rad(max(knuckle_deg, 0.0))))
        spread_deg = (mean_deg + sigma_deg * rng.standard_normal()) * free
        bone = f"{finger}-finger"
        hollow_deg = _HOLLOW_DEG.get(finger, 0.0) * max(knuckle_deg, 0.0) / _KNUCKLE_DEG[1]
        twist_deg = _TWIST_SIGMA_DEG * rng.standard_normal()
        bend(f"{bone}-metacarpal", hollow_deg)
        bend(f"{bone}-phalanx-proximal", knuckle_deg, spread_deg, twist_deg)
        bend(f"{bone}-phalanx-intermediate", middle_deg)
        bend(f"{bone}-phalanx-distal", last_deg)
    across, front, bent = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
    bend(
        "thumb-metacarpal",
        _between(_THUMB_FLEXION_DEG, across),
        _between(_THUMB_ABDUCTION_DEG, front),
        # From beside the hand to opposite the fingers.
        _between((-25.0, 75.0), 0.5 * (across + front))
        + _THUMB_TWIST_SIGMA_DEG * rng.standard_normal(),
    )
    bend("thumb-phalanx-proximal", _between(_THUMB_KNUCKLE_DEG, bent))
    last = _mixed(bent, rng.standard_normal(), _KNUCKLE)
    bend("thumb-phalanx-distal", _between(_THUMB_LAST_DEG, last))
    deviates = np.clip(rng.standard_normal(3), -2.0, 2.0).tolist()
    bend("wrist", *(s * deviate for s, deviate in zip(_WRIST_SIGMA_DEG, deviates, strict=True)))
    return HandPose("random", joints)
