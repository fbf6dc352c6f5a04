"""The hand's joints: WebXR names, degrees of freedom and ranges of motion.

docs/poses.md has the signs of angles and their order. All are zero in the hand held flat: fingers
straight and parallel, the thumb straight beside them.

References
----------
.. [1] American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and Recording",
   1965: fingers, MCP -45 to 90 (passive), PIP 0 to 100, DIP 0 to 90; thumb, CMC flexion 15,
   extension 20, abduction 70, MCP 0 to 50, IP 0 to 80; wrist, flexion 80, extension 70, radial 20,
   ulnar 30 deviation; forearm, pronation 80, supination 80 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

FINGERS: tuple[str, ...] = ("index", "middle", "ring", "pinky")

FINGER_BONES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
THUMB_BONES = ("metacarpal", "phalanx-proximal", "phalanx-distal", "tip")

JOINT_NAMES: tuple[str, ...] = (
    "wrist",
    *(f"thumb-{bone}" for bone in THUMB_BONES),
    *(f"{finger}-finger-{bone}" for finger in FINGERS for bone in FINGER_BONES),
)
"""Joint names and their order: XRHandJoint of W3C WebXR Hand Input Module, Level 1.

A joint carries the name of the bone that begins there; `tip` is the end of the last bone.
"""

JOINT_INDEX: Mapping[str, int] = MappingProxyType({name: i for i, name in enumerate(JOINT_NAMES)})

CHAINS: tuple[tuple[int, ...], ...] = tuple(
    tuple(i for name, i in JOINT_INDEX.items() if name.startswith(f"{digit}-"))
    for digit in ("thumb", *FINGERS)
)
"""Joints of the thumb and the four fingers, from metacarpal to tip."""

WRIST = 0

ANGLES: tuple[str, ...] = ("flexion", "abduction", "twist")

Range = tuple[float, float]
_STILL: Range = (0.0, 0.0)


def _finger(cmc_flexion: Range, mcp_abduction: Range) -> tuple[tuple[Range, Range, Range], ...]:
    return (
        (cmc_flexion, _STILL, _STILL),
        ((-45.0, 100.0), mcp_abduction, (-20.0, 20.0)),
        ((-10.0, 120.0), (-5.0, 5.0), (-5.0, 5.0)),
        ((-15.0, 90.0), (-5.0, 5.0), (-5.0, 5.0)),
        (_STILL, _STILL, _STILL),
    )


_LIMITS = (
    # The whole hand: the wrist's own range and what forearm and upper arm add to it.
    ((-90.0, 170.0), (-90.0, 110.0), (-180.0, 90.0)),
    # Thumb.
    ((-70.0, 50.0), (-15.0, 75.0), (-60.0, 110.0)),
    ((-20.0, 80.0), (-10.0, 10.0), (-10.0, 10.0)),
    ((-30.0, 90.0), (-5.0, 5.0), (-5.0, 5.0)),
    (_STILL, _STILL, _STILL),
    *_finger((0.0, 5.0), (-25.0, 30.0)),
    *_finger((0.0, 5.0), (-25.0, 25.0)),
    *_finger((0.0, 15.0), (-25.0, 25.0)),
    *_finger((0.0, 30.0), (-25.0, 40.0)),
)

LIMITS_DEG: Mapping[str, Mapping[str, Range]] = MappingProxyType(
    {
        name: MappingProxyType(dict(zip(ANGLES, ranges, strict=True)))
        for name, ranges in zip(JOINT_NAMES, _LIMITS, strict=True)
    }
)
"""For each joint and each of `ANGLES` the lowest and the highest angle in degrees."""
