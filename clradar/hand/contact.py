"""Penetration depth between the digits of a posed hand, and between digits and palm.

Each cone is approximated by spheres along its axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clradar.hand.cones import Cone
from clradar.hand.flesh import PART_NAMES, Flesh, grown_flesh
from clradar.hand.pose import HandPose
from clradar.hand.shape import AVERAGE, HandShape
from clradar.hand.skeleton import posed_skeleton

# Fractions of a cone's axis at which spheres approximate it. Between two spheres, up to 5 mm apart
# on a bone of 45 mm, their surface is 0.3 mm below a flank of 10 mm radius.
_SPHERES = np.linspace(0.0, 1.0, 10)

# Neighbouring fingers share their webs, so they may touch within this fraction of their first
# phalanges from the knuckles.
_WEB = 0.5


@dataclass(frozen=True, slots=True)
class Overlap:
    """Penetration depth of two parts of a hand, metres, by their names in `PART_NAMES`.

    It is the distance to move one out of the other; negative, the gap between them.
    """

    parts: tuple[str, str]
    depth_m: float


def overlaps(pose: HandPose, shape: HandShape = AVERAGE) -> tuple[Overlap, ...]:
    """Return the overlap of every pair of digits, and of each digit and the palm, deepest first.

    Anatomically joined parts do not count: the roots of neighbouring fingers, where the webs are,
    and the first phalanges with the palm.
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
    """Return centres (N, 3) and radii (N,) of spheres along a part of each cone."""
    along = begin + (end - begin) * _SPHERES
    centres_m = [c.begin_m + along[:, None] * (c.end_m - c.begin_m) for c in cones]
    radii_m = [c.begin_radius_m + along * (c.end_radius_m - c.begin_radius_m) for c in cones]
    return np.concatenate(centres_m), np.concatenate(radii_m)


def _digit_spheres(flesh: Flesh) -> tuple[list[_Spheres], list[_Spheres], list[_Spheres]]:
    """Return for each digit its spheres at the web, beyond it, and beyond the first phalanx."""
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
