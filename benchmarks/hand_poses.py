"""The poses of the hand that the studies of alignment and metrics use."""

from __future__ import annotations

from dataclasses import replace

from clradar.hand import HandPose, JointAngles, pose_by_name

_BONES = ("phalanx-proximal", "phalanx-intermediate", "phalanx-distal")


def _finger(
    finger: str, mcp_deg: float, pip_deg: float, dip_deg: float, spread_deg: float = 0.0
) -> dict[str, JointAngles]:
    angles_deg = ((mcp_deg, spread_deg), (pip_deg, 0.0), (dip_deg, 0.0))
    return {
        f"{finger}-finger-{bone}": JointAngles.from_degrees(*angles)
        for bone, angles in zip(_BONES, angles_deg, strict=True)
    }


def _fingers(
    fingers: tuple[str, ...], mcp_deg: float, pip_deg: float, dip_deg: float
) -> dict[str, JointAngles]:
    joints: dict[str, JointAngles] = {}
    for finger in fingers:
        joints |= _finger(finger, mcp_deg, pip_deg, dip_deg)
    return joints


def poses() -> dict[str, HandPose]:
    """Return ten poses: two that are packaged and eight others."""
    flat, letter_f = pose_by_name("flat"), pose_by_name("F")
    bent, every = (60.0, 80.0, 40.0), ("index", "middle", "ring", "pinky")
    across = {
        "thumb-metacarpal": JointAngles.from_degrees(10.0, 40.0, 30.0),
        "thumb-phalanx-proximal": JointAngles.from_degrees(25.0),
        "thumb-phalanx-distal": JointAngles.from_degrees(30.0),
    }
    changes = {
        "point": _fingers(("middle", "ring", "pinky"), *bent) | across,
        "two": _finger("index", 0, 2, 2, 14) | _finger("middle", 0, 2, 2, -8)
        | _fingers(("ring", "pinky"), *bent) | across,
        "three": _finger("ring", 10, 10, 5, 8) | _finger("pinky", *bent) | across,
        "horns": _fingers(("middle", "ring"), *bent),
        "claw": _finger("index", 10, 45, 30, 10) | _finger("middle", 10, 45, 30)
        | _finger("ring", 10, 45, 30, 6) | _finger("pinky", 10, 45, 30, 15),
        "cup": _fingers(every, 35, 15, 10),
        "fist": _fingers(every, 80, 95, 50) | across,
        "spread": _finger("index", 0, 2, 2, 22) | _finger("ring", 0, 2, 2, 16)
        | _finger("pinky", 0, 2, 2, 28),
    }  # fmt: skip
    made = {
        name: replace(flat, name=name, joints={**flat.joints, **change})
        for name, change in changes.items()
    }
    return {"flat": flat, "F": letter_f} | made
