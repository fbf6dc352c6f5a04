"""Random plausible poses, free or around a known one; those that penetrate are rejected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple
from itertools import combinations

import numpy as np

from clradar.hand.flesh import PART_NAMES, grown_flesh
from clradar.hand.joints import FINGERS, LIMITS_DEG
from clradar.hand.pose import HandPose, JointAngles
from clradar.hand.skeleton import posed_skeleton
from clradar.model import checks

MOST_OVERLAP_M = 1.5e-3  # of two digits of a random pose: skin in contact deforms
MOST_PALM_OVERLAP_M = 4e-3  # the same for a digit and the palm, whose muscles and pads deform more

# Neighbouring fingers bend together: tendons and muscles are shared (Santello, Flanders and
# Soechting, "Postural hand synergies for tool use", Journal of Neuroscience 18(23), 1998).
NEIGHBOUR_CORRELATION = 0.6
# A finger's knuckle and its middle joint: hooks and flat fists exist, but are less frequent.
KNUCKLE_CORRELATION = 0.6
# The last joint bends by about two thirds of the middle one (Rijpkema and Girard, "Computer
# animation of knowledge-based human grasping", SIGGRAPH 1991), which fingertips that press change.
LAST_SHARE, LAST_SIGMA_DEG = 2.0 / 3.0, 6.0

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
    """Draw a plausible pose, the palm towards the radar.

    Neighbouring fingers, and the joints of a finger, bend together. Fingers spread less the more
    they are bent, the thumb moves into opposition as it comes to the front. Digits that penetrate
    by more than 1.5 mm, or the palm by more than 4 mm, are rejected. docs/poses.md has the sources.

    Examples
    --------
    >>> draw = clradar.hand.random_pose
    >>> draw(np.random.default_rng(1)) == draw(np.random.default_rng(1))
    True
    """
    checks.instance("random_pose: rng", rng, np.random.Generator)
    while True:
        pose = _drawn(rng)
        if _fits(pose, {}):
            return pose


SPREAD_DEG = 12.0
"""Standard deviation by which flexions, and all angles of the thumb, are drawn around a pose."""

MOST_SPREAD_DEG = 45.0

ABDUCTION_SHARE, HOLLOW_SHARE = 7.0 / 12.0, 5.0 / 12.0
"""Standard deviations of the fingers' abductions and of the palm's arch, as shares of it."""

_SWEEPS = 6  # over the digits: of fists about every third draw of one fits between the others


def pose_around(
    pose: HandPose, rng: np.random.Generator, spread_deg: float = SPREAD_DEG
) -> HandPose:
    """Draw a plausible pose around another one.

    Flexions of the fingers and all angles of the thumb deviate by `spread_deg` (standard deviation,
    0 to 45), abductions of the fingers by 7/12 and the arch of the palm by 5/12 of it; middle joint
    and knuckle of a finger are correlated by 0.6. Twists of the fingers and the wrist stay. No
    parts penetrate more than in `random_pose`, or than in `pose` itself: digits are drawn one at a
    time, six times over, and kept if they fit (Metropolis within Gibbs).

    Examples
    --------
    >>> pose = clradar.hand.POSES["L"]
    >>> clradar.hand.pose_around(pose, np.random.default_rng(1), spread_deg=0.0) == pose
    True
    """
    checks.instance("pose", pose, HandPose)
    checks.instance("pose_around: rng", rng, np.random.Generator)
    spread_deg = checks.within("spread_deg", spread_deg, 0, MOST_SPREAD_DEG, " degrees")
    own_m = overlaps(pose)
    drawn = pose
    for _ in range(_SWEEPS):
        for digit in ("thumb", *FINGERS):
            tried = _with_digit(drawn, pose, digit, spread_deg * rng.standard_normal(5))
            if _fits(tried, own_m):
                drawn = tried
    return drawn


def _fits(pose: HandPose, allowed_m: Mapping[tuple[str, str], float]) -> bool:
    """Return whether no parts penetrate more than skin deforms, or than is allowed besides."""
    for parts, depth_m in overlaps(pose).items():
        most_m = MOST_PALM_OVERLAP_M if "palm" in parts else MOST_OVERLAP_M
        if depth_m > max(most_m, allowed_m.get(parts, 0.0)):
            return False
    return True


def _with_digit(pose: HandPose, mean: HandPose, digit: str, deviates_deg: np.ndarray) -> HandPose:
    """Return `pose` with a digit drawn around that of `mean`; `deviates_deg` are independent."""
    knuckle, own, last, abduction, hollow = deviates_deg.tolist()
    if digit == "thumb":
        turns = {
            "thumb-metacarpal": (knuckle, abduction, hollow),
            "thumb-phalanx-proximal": (own,),
            "thumb-phalanx-distal": (last,),
        }
    else:
        middle = _mixed(knuckle, own, KNUCKLE_CORRELATION)
        turns = {
            f"{digit}-finger-phalanx-proximal": (knuckle, ABDUCTION_SHARE * abduction),
            f"{digit}-finger-phalanx-intermediate": (middle,),
            f"{digit}-finger-phalanx-distal": (_mixed(middle, last, LAST_SHARE),),
        }
        if digit in _HOLLOW_DEG:
            turns[f"{digit}-finger-metacarpal"] = (HOLLOW_SHARE * hollow,)
    joints = dict(pose.joints)
    for joint, turned_deg in turns.items():
        wanted_rad = np.array(astuple(mean.angles(joint)))
        wanted_rad[: len(turned_deg)] += np.deg2rad(turned_deg)
        joints[joint] = _limited(joint, wanted_rad)
    return HandPose(pose.name, joints, pose.description, pose.source)


def _limited(joint: str, angles_rad: np.ndarray) -> JointAngles:
    limits_rad = np.deg2rad(list(LIMITS_DEG[joint].values()))
    return JointAngles(*np.clip(angles_rad, *limits_rad.T).tolist())


def _between(ends: tuple[float, float], normal: float) -> float:
    """Return a number that is uniform between two ends if `normal` is a standard normal deviate."""
    from scipy.special import ndtr

    return ends[0] + (ends[1] - ends[0]) * float(ndtr(normal))


def _mixed(shared: float, own: float, correlation: float) -> float:
    """Return a standard normal deviate with this correlation to `shared`."""
    return correlation * shared + float(np.sqrt(1.0 - correlation**2)) * own


def _drawn(rng: np.random.Generator) -> HandPose:
    joints: dict[str, JointAngles] = {}

    def bend(joint: str, *wanted_deg: float) -> None:
        joints[joint] = _limited(joint, np.deg2rad((*wanted_deg, 0.0, 0.0)[:3]))

    middle = rng.standard_normal()
    for i, finger in enumerate(FINGERS):
        if i > 0:
            middle = _mixed(middle, rng.standard_normal(), NEIGHBOUR_CORRELATION)
        knuckle_deg = _between(
            _KNUCKLE_DEG, _mixed(middle, rng.standard_normal(), KNUCKLE_CORRELATION)
        )
        middle_deg = _between(_MIDDLE_DEG, middle)
        last_deg = LAST_SHARE * middle_deg + LAST_SIGMA_DEG * rng.standard_normal()
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
    last = _mixed(bent, rng.standard_normal(), KNUCKLE_CORRELATION)
    bend("thumb-phalanx-distal", _between(_THUMB_LAST_DEG, last))
    deviates = np.clip(rng.standard_normal(3), -2.0, 2.0).tolist()
    bend("wrist", *(s * deviate for s, deviate in zip(_WRIST_SIGMA_DEG, deviates, strict=True)))
    return HandPose("random", joints)


# Fractions of a cone's axis at which spheres approximate it. Between two spheres, up to 5 mm apart
# on a bone of 45 mm, their surface is 0.3 mm below a flank of 10 mm radius.
_SPHERES = np.linspace(0.0, 1.0, 10)

# Neighbouring fingers share their webs, so they may touch within this fraction of their first
# phalanges from the knuckles.
_WEB = 0.5


def overlaps(pose: HandPose) -> dict[tuple[str, str], float]:
    """Return the penetration depths, metres, of all pairs of digits, and of the palm and digits.

    By their names in `PART_NAMES`. A depth is the distance to move one out of the other; negative,
    the gap between them. Anatomically joined parts do not count: the roots of neighbouring fingers,
    where the webs are, and the first phalanges with the palm.
    """
    flesh, names = grown_flesh(posed_skeleton(pose)), PART_NAMES[1:]
    # Of each digit: at the web, beyond the first phalanx, beyond the web, and all.
    webs = [_spheres(root[:1], 0.0, _WEB) for root in flesh.roots]
    ends = [_spheres(end) for end in flesh.ends]
    roots = (_spheres(root[:1], _WEB, 1.0) for root in flesh.roots)
    rests = [np.concatenate(both) for both in zip(roots, ends, strict=True)]
    wholes = [np.concatenate(both) for both in zip(webs, rests, strict=True)]
    palm = _spheres(flesh.palm)
    depths_m = {("palm", name): _depth_m(palm, end) for name, end in zip(names, ends, strict=True)}
    for i, j in combinations(range(len(names)), 2):
        at_web = _depth_m(webs[i], (wholes if j > i + 1 else rests)[j])
        depths_m[names[i], names[j]] = max(at_web, _depth_m(rests[i], wholes[j]))
    return depths_m


def _spheres(cones: np.ndarray, begin: float = 0.0, end: float = 1.0) -> np.ndarray:
    """Return centres and radii (N, 4) of spheres along a part of each cone."""
    along = (begin + (end - begin) * _SPHERES)[:, None]
    first, last = cones[:, :1], cones[:, 1:]
    return (first + along * (last - first)).reshape(-1, 4)


def _depth_m(one: np.ndarray, other: np.ndarray) -> float:
    apart_m = np.linalg.norm(one[:, None, :3] - other[None, :, :3], axis=2)
    return float((one[:, None, 3] + other[None, :, 3] - apart_m).max())
