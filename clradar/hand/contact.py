"""How deep the digits of a posed hand run into one another and into the palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.hand.cones import Cone
from clradar.hand.flesh import PART_NAMES, Flesh, grown_flesh
from clradar.hand.pose import HandPose
from clradar.hand.shape import AVERAGE, HandShape
from clradar.hand.skeleton import posed_skeleton

# Spheres that stand for a cone. Between two of them, up to 5 mm apart on a bone of 45 mm, the
# spheres lie 0.3 mm below a flank of 10 mm radius.
_SPHERES = np.linspace(0.0, 1.0, 10)

# Neighbouring fingers share their webs, so where both are nearer to the knuckles than this share of
# their first phalanges they may touch.
_WEB = 0.5


@dataclass(frozen=True, slots=True)
class Overlap:
    """How deep two parts of a hand run into each other.

    Parameters
    ----------
    parts : tuple of two str
        Names of `PART_NAMES`.
    depth_m : float, metres
        By how much the two would have to move apart to touch only; negative is the gap between.
    """

    parts: tuple[str, str]
    depth_m: float


def overlaps(pose: HandPose, shape: HandShape = AVERAGE) -> tuple[Overlap, ...]:
    """Return the overlap of each two digits and of each digit with the palm, deepest first.

    Not counted is what belongs together: the roots of neighbouring fingers, where the webs are, and
    the first phalanges with the palm.

    Parameters
    ----------
    pose : HandPose
    shape : HandShape
    """
    flesh = grown_flesh(posed_skeleton(pose, shape))
    webs, rests, ends = _digit_spheres(flesh)
    names = PART_NAMES[1:]
    found = []
    for i, one in enumerate(names):
        for j in range(i + 1, len(names)):
            depths = [_depth_m(rests[i], rests[j])]
            depths += [_depth_m(webs[i], rests[j]), _depth_m(rests[i], webs[j])]
            if j > i + 1:
                depths.append(_depth_m(webs[i], webs[j]))
            found.append(Overlap((one, names[j]), max(depths)))
    palm = _spheres(flesh.palm)
    found += [
        Overlap(("palm", name), _depth_m(palm, end)) for name, end in zip(names, ends, strict=True)
    ]
    return tuple(sorted(found, key=lambda overlap: -overlap.depth_m))


_Spheres = tuple[np.ndarray, np.ndarray]


def _spheres(cones: tuple[Cone, ...], begin: float = 0.0, end: float = 1.0) -> _Spheres:
    """Return centres (N, 3) and radii (N,) of spheres that stand for a share of each cone."""
    along = begin + (end - begin) * _SPHERES
    centres_m = [c.begin_m + along[:, None] * (c.end_m - c.begin_m) for c in cones]
    radii_m = [c.begin_radius_m + along * (c.end_radius_m - c.begin_radius_m) for c in cones]
    return np.concatenate(centres_m), np.concatenate(radii_m)


def _digit_spheres(flesh: Flesh) -> tuple[list[_Spheres], list[_Spheres], list[_Spheres]]:
    """Return for each digit the spheres at its web, those beyond, and those that bend free."""
    webs, rests, ends = [], [], []
    for root, end in zip(flesh.roots, flesh.ends, strict=True):
        bone = root[:1]
        webs.append(_spheres(bone, 0.0, _WEB))
        beyond, free = _spheres(bone, _WEB, 1.0), _spheres(end)
        rests.append((np.concatenate([beyond[0], free[0]]), np.concatenate([beyond[1], free[1]])))
        ends.append(free)
    return webs, rests, ends


def _depth_m(one: _Spheres, other: _Spheres) -> float:
    apart_m = np.linalg.norm(one[0][:, None] - other[0][None], axis=2)
    return float((one[1][:, None] + other[1][None] - apart_m).max())
