"""A hand's pose: the angles of its joints, within their limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from types import MappingProxyType

from clradar.hand.joints import ANGLES, JOINT_NAMES, LIMITS_DEG
from clradar.model import checks
from clradar.model.record import Record

# Angles given in degrees and turned into radians come back a few ulp off a limit.
_LIMIT_SLACK_DEG = 1e-7


@dataclass(frozen=True, slots=True)
class JointAngles(Record):
    """The three angles of a joint; docs/poses.md has their signs and limits."""

    flexion_rad: float = 0.0
    abduction_rad: float = 0.0
    twist_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ANGLES:
            field = f"{name}_rad"
            self._set(**{field: checks.real(f"JointAngles.{field}", getattr(self, field))})

    @classmethod
    def from_degrees(
        cls, flexion_deg: float = 0.0, abduction_deg: float = 0.0, twist_deg: float = 0.0
    ) -> JointAngles:
        """The joint with these angles."""
        given = zip(ANGLES, (flexion_deg, abduction_deg, twist_deg), strict=True)
        return cls(*(math.radians(checks.real(f"{name}_deg", deg)) for name, deg in given))

    def degrees(self) -> tuple[float, float, float]:
        """Flexion, abduction and twist."""
        flexion, abduction, twist = map(math.degrees, astuple(self))
        return flexion, abduction, twist


STRAIGHT = JointAngles()


@dataclass(frozen=True, slots=True)
class HandPose(Record):
    """Angles of a whole hand; the same angles describe a right and a left hand.

    Two poses are equal if name and angles are.

    Parameters
    ----------
    name : str
    joints : mapping of str to JointAngles
        Angles by joint of `JOINT_NAMES`; all 0 where a joint is left out.
    description, source : str
        The appearance of the pose, and the publication that describes it.

    Examples
    --------
    >>> bent = clradar.hand.JointAngles.from_degrees(70.0)
    >>> pose = clradar.hand.HandPose("pointing down", {"index-finger-phalanx-proximal": bent})
    >>> [round(angle_deg) for angle_deg in pose.angles("index-finger-phalanx-proximal").degrees()]
    [70, 0, 0]
    """

    name: str
    joints: Mapping[str, JointAngles] = field(default_factory=dict)
    description: str = field(default="", compare=False)
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name in ("name", "description", "source"):
            checks.text(f"HandPose.{name}", getattr(self, name))
        given = checks.frozen_mapping("HandPose.joints", self.joints)
        for joint, angles in given.items():
            if joint not in LIMITS_DEG:
                example = "such as 'index-finger-phalanx-proximal'"
                checks.fail("joint", f"one of the 25 of WebXR Hand Input, {example}", repr(joint))
            checks.instance(f"joint {joint}", angles, JointAngles)
            own = zip(LIMITS_DEG[joint].items(), angles.degrees(), strict=True)
            for (name, (low_deg, high_deg)), angle_deg in own:
                if not low_deg - _LIMIT_SLACK_DEG <= angle_deg <= high_deg + _LIMIT_SLACK_DEG:
                    expected = f"an angle in [{low_deg:g}, {high_deg:g}] degrees"
                    if low_deg == high_deg == 0.0:
                        expected = "0, since this joint does not move so"
                    checks.fail(f"joint {joint}: {name}", expected, f"{angle_deg:g} degrees")
        kept = {n: given[n] for n in JOINT_NAMES if n in given and given[n] != STRAIGHT}
        self._set(joints=MappingProxyType(kept))

    def __hash__(self) -> int:
        return hash((self.name, tuple(self.joints.items())))

    def angles(self, joint: str) -> JointAngles:
        """The angles of a joint."""
        return self.joints.get(joint, STRAIGHT)


def interpolate_poses(a: HandPose, b: HandPose, share: float) -> HandPose:
    """Return the linear interpolation of two poses, angle by angle.

    A share of 0 gives the angles of `a`, 1 those of `b`. Fingers may penetrate each other on the
    way.

    Examples
    --------
    >>> from clradar.hand import POSES
    >>> half = clradar.hand.interpolate_poses(POSES["flat"], POSES["S"], 0.5)
    >>> round(half.angles("middle-finger-phalanx-intermediate").degrees()[0])
    57
    """
    checks.instance("a", a, HandPose)
    checks.instance("b", b, HandPose)
    share = checks.within("share", share, 0, 1)
    joints = {}
    for joint in {**a.joints, **b.joints}:
        ends = zip(astuple(a.angles(joint)), astuple(b.angles(joint)), strict=True)
        joints[joint] = JointAngles(*((1.0 - share) * one + share * other for one, other in ends))
    return HandPose(f"{a.name} to {b.name}, {share:g}", joints)


def minimum_jerk(time: float) -> float:
    """Share of the way at a share of the time: from rest to rest with the least jerk.

    Flash and Hogan, "The coordination of arm movements: an experimentally confirmed mathematical
    model", Journal of Neuroscience 5(7), 1985: 10 t^3 - 15 t^4 + 6 t^5.
    """
    return time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
