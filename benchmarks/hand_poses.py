"""The poses of the hand that the studies of alignment and metrics use."""

from __future__ import annotations

from dataclasses import replace

from clradar.hand import FingerPose, HandPose, ThumbPose, pose_by_name


def _finger(mcp_deg: float, pip_deg: float, dip_deg: float, spread_deg: float = 0.0) -> FingerPose:
    return FingerPose.from_degrees(mcp_deg, pip_deg, dip_deg, spread_deg)


def poses() -> dict[str, HandPose]:
    """Return ten poses: the two that are embedded and eight others."""
    flat, letter_f = pose_by_name("flat"), pose_by_name("F")
    bent = _finger(60.0, 80.0, 40.0)
    fist = _finger(80.0, 95.0, 50.0)
    across = ThumbPose.from_degrees(10.0, 40.0, 30.0, 25.0, 30.0)
    made = {
        "point": replace(flat, middle=bent, ring=bent, pinky=bent, thumb=across),
        "two": replace(flat, index=_finger(0, 2, 2, 14), middle=_finger(0, 2, 2, -8), ring=bent,
                       pinky=bent, thumb=across),
        "three": replace(flat, ring=_finger(10, 10, 5, 8), pinky=bent, thumb=across),
        "horns": replace(flat, middle=bent, ring=bent),
        "claw": replace(flat, index=_finger(10, 45, 30, 10), middle=_finger(10, 45, 30),
                        ring=_finger(10, 45, 30, 6), pinky=_finger(10, 45, 30, 15)),
        "cup": replace(flat, index=_finger(35, 15, 10), middle=_finger(35, 15, 10),
                       ring=_finger(35, 15, 10), pinky=_finger(35, 15, 10)),
        "fist": replace(flat, index=fist, middle=fist, ring=fist, pinky=fist, thumb=across),
        "spread": replace(flat, index=_finger(0, 2, 2, 22), ring=_finger(0, 2, 2, 16),
                          pinky=_finger(0, 2, 2, 28)),
    }  # fmt: skip
    return {"flat": flat, "F": letter_f} | {n: replace(p, name=n) for n, p in made.items()}
