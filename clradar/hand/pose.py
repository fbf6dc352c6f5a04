"""Hand poses as joint angles, with anatomical limits, and the poses known by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

import numpy as np

from clradar.model import checks

# Active ranges of motion in degrees, after the tables of the American Academy of Orthopaedic
# Surgeons (Joint Motion, 1965), widened where passive contact or letter shapes need more: fingers
# may hyperextend at the MCP joint, and may adduct past the middle line (crossed fingers).
FINGER_LIMITS_DEG: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "mcp_flexion": (-30.0, 95.0),
        "pip_flexion": (-10.0, 115.0),
        "dip_flexion": (-15.0, 90.0),
        "abduction": (-25.0, 30.0),
    }
)
THUMB_LIMITS_DEG: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "cmc_flexion": (-70.0, 50.0),
        "cmc_abduction": (-15.0, 75.0),
        "cmc_twist": (-60.0, 110.0),
        "mcp_flexion": (-20.0, 80.0),
        "ip_flexion": (-30.0, 90.0),
    }
)

# Angles given in degrees and turned into radians come back a few ulp off a limit.
_LIMIT_SLACK_RAD = 1e-9


def _check_angles(record: Any, limits_deg: Mapping[str, tuple[float, float]]) -> None:
    for name, (low_deg, high_deg) in limits_deg.items():
        label = f"{type(record).__name__}.{name}_rad"
        angle_rad = checks.real(label, getattr(record, f"{name}_rad"))
        low_rad, high_rad = np.deg2rad(low_deg), np.deg2rad(high_deg)
        if not low_rad - _LIMIT_SLACK_RAD <= angle_rad <= high_rad + _LIMIT_SLACK_RAD:
            checks.fail(
                label,
                f"an angle in [{low_deg:g}, {high_deg:g}] degrees",
                f"{np.rad2deg(angle_rad):g} degrees",
            )
        object.__setattr__(record, f"{name}_rad", angle_rad)


@dataclass(frozen=True, slots=True)
class FingerPose:
    """Angles of one finger (index, middle, ring or pinky).

    Parameters
    ----------
    mcp_flexion_rad, pip_flexion_rad, dip_flexion_rad : float, radians
        Bending towards the palm at the knuckle, the middle and the last joint; 0 is straight.
    abduction_rad : float, radians
        Spread at the knuckle away from the middle finger's line; for the middle finger itself,
        positive is towards the thumb. With 0 for all, the fingers are parallel.
    """

    mcp_flexion_rad: float = 0.0
    pip_flexion_rad: float = 0.0
    dip_flexion_rad: float = 0.0
    abduction_rad: float = 0.0

    def __post_init__(self) -> None:
        _check_angles(self, FINGER_LIMITS_DEG)

    @classmethod
    def from_degrees(
        cls, mcp_deg: float, pip_deg: float, dip_deg: float, abduction_deg: float = 0.0
    ) -> FingerPose:
        """Return the finger with these angles in degrees."""
        return cls(*(float(np.deg2rad(a)) for a in (mcp_deg, pip_deg, dip_deg, abduction_deg)))


@dataclass(frozen=True, slots=True)
class ThumbPose:
    """Angles of the thumb.

    With all angles 0 the thumb is straight, parallel to the fingers, in the plane of the palm, and
    its nail looks away from the fingers.

    Parameters
    ----------
    cmc_flexion_rad : float, radians
        Swing of the whole thumb in the plane of the palm, positive across the palm; negative
        spreads the thumb sideways.
    cmc_abduction_rad : float, radians
        Swing of the whole thumb out of the plane of the palm, positive in front of the palm.
    cmc_twist_rad : float, radians
        Turn about the metacarpal, positive into opposition (the pad turns to the finger pads).
    mcp_flexion_rad, ip_flexion_rad : float, radians
        Bending at the two visible joints, positive towards the thumb's pad.
    """

    cmc_flexion_rad: float = 0.0
    cmc_abduction_rad: float = 0.0
    cmc_twist_rad: float = 0.0
    mcp_flexion_rad: float = 0.0
    ip_flexion_rad: float = 0.0

    def __post_init__(self) -> None:
        _check_angles(self, THUMB_LIMITS_DEG)

    @classmethod
    def from_degrees(
        cls,
        cmc_flexion_deg: float,
        cmc_abduction_deg: float,
        cmc_twist_deg: float,
        mcp_deg: float,
        ip_deg: float,
    ) -> ThumbPose:
        """Return the thumb with these angles in degrees."""
        angles_deg = (cmc_flexion_deg, cmc_abduction_deg, cmc_twist_deg, mcp_deg, ip_deg)
        return cls(*(float(np.deg2rad(a)) for a in angles_deg))


@dataclass(frozen=True, slots=True)
class HandPose:
    """Angles of a whole hand; the same angles describe a right and a left hand.

    Parameters
    ----------
    name : str
        How the pose is called; a letter of the manual alphabet or a word.
    thumb : ThumbPose
    index, middle, ring, pinky : FingerPose
    """

    name: str
    thumb: ThumbPose = ThumbPose()
    index: FingerPose = FingerPose()
    middle: FingerPose = FingerPose()
    ring: FingerPose = FingerPose()
    pinky: FingerPose = FingerPose()

    def __post_init__(self) -> None:
        checks.text("HandPose.name", self.name)
        for item in fields(self)[1:]:
            kind = ThumbPose if item.name == "thumb" else FingerPose
            value = getattr(self, item.name)
            if not isinstance(value, kind):
                checks.fail(f"HandPose.{item.name}", f"a {kind.__name__}", type(value).__name__)


_FLAT = HandPose(
    name="flat",
    thumb=ThumbPose.from_degrees(-42.0, 14.0, -20.0, 6.0, 4.0),
    index=FingerPose.from_degrees(2.0, 4.0, 2.0, 7.0),
    middle=FingerPose.from_degrees(2.0, 4.0, 2.0, 0.0),
    ring=FingerPose.from_degrees(2.0, 4.0, 2.0, 6.0),
    pinky=FingerPose.from_degrees(2.0, 4.0, 2.0, 15.0),
)

# The index finger's and the thumb's angles come from a search that presses the tips 0.9 mm into
# each other, so that one surface leads over a neck from one to the other, keeps the pads near the
# contact, and leaves the ring between the two open as seen from the palm's side.
# A change of bones or radii asks for a new search.
_LETTER_F = HandPose(
    name="F",
    thumb=ThumbPose.from_degrees(-35.4, 27.9, 7.0, 21.7, 28.5),
    index=FingerPose.from_degrees(25.0, 78.8, 31.4, 21.8),
    middle=FingerPose.from_degrees(2.0, 4.0, 2.0, 1.0),
    ring=FingerPose.from_degrees(0.0, 4.0, 2.0, 9.0),
    pinky=FingerPose.from_degrees(0.0, 4.0, 2.0, 19.0),
)

POSES: Mapping[str, HandPose] = MappingProxyType({p.name: p for p in (_FLAT, _LETTER_F)})
"""Poses by name: `flat` (open hand) and letters of the American manual alphabet."""


def pose_by_name(name: str) -> HandPose:
    """Return a pose of `POSES`; upper and lower case mean the same.

    Raises
    ------
    ModelError
        If there is no pose of that name.
    """
    wanted = checks.text("pose", name).strip().casefold()
    for known, pose in POSES.items():
        if known.casefold() == wanted:
            return pose
    checks.fail("pose", "one of " + ", ".join(repr(known) for known in POSES), repr(name))
