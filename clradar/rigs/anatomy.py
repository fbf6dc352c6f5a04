"""Bone axes of a hand from its joint positions, which also check its side and unit of length.

The canonical frame is that of `clradar.hand`: wrist at the origin, middle knuckle and fingers
towards +y, palm towards -z, thumb towards -x; a left hand is mirrored into a right one.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from clradar.hand import HandPose, pose_by_name, posed_skeleton
from clradar.hand.joints import CHAINS, FINGERS, JOINT_NAMES, WRIST
from clradar.model import checks

METACARPALS = tuple(chain[0] for chain in CHAINS[1:])
TIPS = tuple(chain[-1] for chain in CHAINS)
OPTIONAL = frozenset((*METACARPALS, *TIPS))
"""Joints that a rig may lack: tips, and the metacarpals of the four fingers."""

UNITS_M = MappingProxyType({"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 25.4e-3, "100 m": 100.0})
"""Units by name; the last is that of files in which a scale of 0.01 was applied twice."""

REACH_M = (0.05, 0.40)
"""Wrist to the last joint of the middle finger, along the joints. The hand of this package has
166 mm; adult means of hand length are 181 and 194 mm, with the last bone (Greiner 1991)."""

# Sum of two sines: the mean bend of the fingers, and the thumb's direction out of the palm.
_CLEAR_CURL = 0.1

# A digit bent by more has an axis of its own, if it is within the second angle of the expected.
_CLEAR_BEND = np.sin(np.deg2rad(20.0))
_SAME_AXIS = np.cos(np.deg2rad(45.0))

# Two bones of a digit along the same axis of their own frames follow a convention of the rig.
_SAME_LOCAL = np.cos(np.deg2rad(3.0))


def parents_of(known: np.ndarray) -> np.ndarray:
    """Return for every joint (25,) its nearest ancestor that the rig has; the wrist is its own."""
    parents = np.zeros(len(JOINT_NAMES), dtype=np.int64)
    for chain in CHAINS:
        before = WRIST
        for joint in chain:
            parents[joint] = before
            before = joint if known[joint] else before
    return parents


def check_joints(joints: np.ndarray) -> None:
    """Raise `ModelError` unless joints (25, 3), in any unit, NaN where there is none, are a hand's.

    Bones have a length, and the knuckles are side by side in the order of the fingers.
    """
    known = np.isfinite(joints).all(axis=1)
    for joint, parent in enumerate(parents_of(known)):
        # A finger's metacarpal may begin at the wrist: some rigs let all of them begin there.
        if not known[joint] or joint in (WRIST, *METACARPALS):
            continue
        if not np.linalg.norm(joints[joint] - joints[parent]) > 1e-6 * reach(joints):
            got = f"'{JOINT_NAMES[joint]}' and '{JOINT_NAMES[parent]}' at the same place"
            checks.fail("joints", "bones with a length", got)
    index, middle, _, pinky = knuckles = joints[[chain[1] for chain in CHAINS[1:]]]
    normal = np.cross(pinky - index, middle - joints[WRIST])
    if not np.linalg.norm(normal) > 1e-2 * reach(joints) ** 2:
        checks.fail("knuckles", "a row side by side", "all in line with the wrist")
    order = np.argsort(knuckles @ _axes(joints)[:, 0]).tolist()
    if order != sorted(order):
        got = f"{', '.join(FINGERS[i] for i in order)}: are the joints named correctly?"
        checks.fail("knuckles", f"the order {', '.join(FINGERS)}", got)


def reach(joints: np.ndarray) -> float:
    """Return the length from the wrist along the middle finger's joints to the last before the tip.

    The metacarpal's joint, which not every rig has, does not count.
    """
    chain = joints[[WRIST, *CHAINS[2][1:-1]]]
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())


def check_unit(joints: np.ndarray, unit_m: float) -> None:
    """Raise `ModelError` unless a unit of so many metres gives a hand's size."""
    length, (low, high) = reach(joints), REACH_M
    if not low <= length * unit_m <= high:
        fitting = [name for name, m in UNITS_M.items() if low <= length * m <= high]
        hint = f"did you mean {' or '.join(fitting)}?" if fitting else "another one"
        checks.fail(
            "unit",
            f"{1e3 * low:g} to {1e3 * high:g} mm from wrist to the last joint of the middle finger",
            f"{1e3 * length * unit_m:.4g} mm with a unit of {unit_m:g} m; {hint} (--rig-unit)",
        )


def check_side(joints: np.ndarray, side: str | None) -> str:
    """Return a side that is given or named, right if not; raise `ModelError` if it is the other.

    The bend of the fingers and the side of the thumb show it. A flat hand with the thumb in its
    plane is its own mirror image: there it has to be given or named.
    """
    across, along, _ = _axes(joints).T
    # For a right hand, whose index finger is at -x, this looks out of the back of the hand.
    back = np.cross(across, along)
    curl = np.mean([_unit(joints[d[-2]] - joints[d[1]]) @ back for d in CHAINS[1:]])
    thumb = _unit(joints[CHAINS[0][2]] - joints[WRIST]) @ back
    towards_palm = -float(curl + thumb)
    estimated = None
    if abs(towards_palm) >= _CLEAR_CURL:
        estimated = "right" if towards_palm > 0 else "left"
    if side is None and estimated is None:
        expected = "joints or names that tell left from right, or --rig-hand"
        checks.fail("hand", expected, "a flat one with its thumb in the plane of the palm")
    side = side or "right"
    if estimated not in (None, side):
        by = "by the position of its thumb and the bend of its fingers"
        checks.fail("hand", f"a {side} hand", f"a {estimated} one {by}; --rig-hand {estimated}?")
    return side


def canonical_axes(joints: np.ndarray, side: str) -> np.ndarray:
    """Return the matrix (3, 3), with a mirror for a left hand, from offsets from the wrist to the
    canonical frame.
    """
    mirror = np.diag([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    reference = reference_hand()[0]
    # The offset of the same axes in the hand of this package is constant and removed.
    return _axes(reference) @ _axes(joints @ mirror).T @ mirror


def rest_frames(
    joints_m: np.ndarray, local_axes: np.ndarray, flesh_m: dict[int, np.ndarray]
) -> np.ndarray:
    """Return the axes (25, 3, 3) of every bone of a rig at rest, as `Skeleton.frames` has them.

    Joints (25, 3), metres, NaN where the rig has none, and the directions (25, 3, 3) of its own
    coordinates are in the canonical frame; `flesh_m` has the centroid of the vertices of each
    digit's last bone, for digits without a tip. The palm, with the finger metacarpals, is one rigid
    piece: where a rig lets metacarpals begin does not tell how they are bent.
    """
    known = np.isfinite(joints_m).all(axis=1)
    frames = reference_hand()[1].copy()
    for chain in CHAINS:
        *bones, tip = chain[-4:]
        along = [_unit(joints_m[b] - joints_m[a]) for a, b in pairwise(bones)]
        end, last_m = bones[-1], joints_m[tip] - joints_m[bones[-1]]
        if not known[tip]:
            # Along the axis of its own on which the bones before lie, if they share one; else
            # towards its flesh; without any, as the bone before.
            first, second = (local_axes[b].T @ a for b, a in zip(bones, along, strict=False))
            if first @ second > _SAME_LOCAL:
                last_m = local_axes[end] @ (first + second)
            else:
                last_m = flesh_m[end] - joints_m[end] if end in flesh_m else along[-1]
        along.append(_unit(last_m))
        axis = _thumb_axis(along[0]) if chain is CHAINS[0] else _finger_axis(bones[0], along[0])
        bend = sum(np.cross(b, a) for a, b in pairwise(along))
        size = float(np.linalg.norm(bend))
        if size > _CLEAR_BEND and abs(bend @ axis) > _SAME_AXIS * size:
            axis = np.sign(bend @ axis) * bend / size
        for joint, direction in zip(bones, along, strict=True):
            frames[joint] = _frame(axis, direction)
        frames[tip] = frames[end]
    return frames


def _finger_axis(joint: int, along: np.ndarray) -> np.ndarray:
    """Return the bending axis of a finger whose first bone has this direction.

    Solves along = R Rz(abduction) Rx(-flexion) y for the two angles, where R is the frame of that
    finger with all angles 0.
    """
    base = reference_hand()[1][joint]
    x, y, _ = base.T @ along
    if np.hypot(x, y) < np.sin(np.deg2rad(5.0)):  # bent by a right angle: abduction is unobservable
        x, y = 0.0, 1.0
    spread = np.arctan2(-x, y)
    return base @ np.array([np.cos(spread), np.sin(spread), 0.0])


def _thumb_axis(along: np.ndarray) -> np.ndarray:
    """Return the bending axis of a thumb: that of an open hand after the smallest rotation.

    The twist of a straight thumb is unobservable from its joints.
    """
    frame = reference_hand()[2]
    cross, cosine = np.cross(frame[:, 1], along), float(frame[:, 1] @ along)
    axis = frame[:, 0]
    if cosine < -0.99:
        return axis
    # Rodrigues' rotation formula with the sine inside the cross product.
    return axis + np.cross(cross, axis) + np.cross(cross, np.cross(cross, axis)) / (1.0 + cosine)


def _frame(axis: np.ndarray, along: np.ndarray) -> np.ndarray:
    side = _unit(axis - (axis @ along) * along)
    return np.stack([side, along, np.cross(side, along)], axis=1)


def _axes(joints: np.ndarray) -> np.ndarray:
    """Return axes (3, 3) as columns: from index to little knuckle, to the middle knuckle, normal.

    Of a right hand these are nearly the canonical frame's.
    """
    index, middle, _, pinky = (joints[chain[1]] for chain in CHAINS[1:])
    return _frame(pinky - index, _unit(middle - joints[WRIST]))


@cache
def reference_hand() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joints and frames of the hand with all angles 0, and the thumb's frame when flat."""
    straight = posed_skeleton(HandPose("straight"))
    thumb = posed_skeleton(pose_by_name("flat")).frames[CHAINS[0][0]]
    return straight.joints_m, straight.frames, thumb


def _unit(vector: np.ndarray) -> np.ndarray:
    norm = float(np.linalg.norm(vector))
    if not norm > 0.0:
        checks.fail("joints", "bones with a length", "two joints at the same place")
    return vector / norm
