"""The joints of a hand among the nodes of a rig: by WebXR names, or by a mapping."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from clradar.hand.joints import JOINT_INDEX, JOINT_NAMES
from clradar.model import checks
from clradar.rigs.anatomy import OPTIONAL

REQUIRED = tuple(name for name in JOINT_NAMES if JOINT_INDEX[name] not in OPTIONAL)

# The words of a name in any case, with any characters but letters between them.
_PATTERNS = {
    JOINT_INDEX[name]: re.compile(r"[\W\d_]*".join(name.split("-")), re.IGNORECASE)
    for name in JOINT_NAMES
}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}


@dataclass(frozen=True, slots=True)
class FoundJoints:
    """Joints (indices into `JOINT_NAMES`) -> nodes, and the side if names tell it."""

    nodes: dict[int, int]
    side: str | None


def side_in(*names: str) -> str | None:
    """Return the side that names contain as a word, left, right, l or r; None without one."""
    words = ([word.lower() for word in _WORD.findall(name)] for name in names)
    sides = [{_SIDES[word] for word in own if word in _SIDES} for own in words]
    found = set().union(*(own for own in sides if len(own) == 1))  # not of names with both
    return found.pop() if len(found) == 1 else None


def hands_by_name(names: Sequence[str], skin: set[int]) -> list[FoundJoints]:
    """Return the hands whose joints have WebXR names, each hand with one prefix and suffix.

    Numbers, case and separators do not count: ``Index-Finger_Tip.R`` and ``b_r_index_finger_tip``
    are `index-finger-tip` of two hands. Where a joint of a skin has a name, other nodes of that
    name, as a mesh or a helper, do not count; a tip often has no vertices.
    """
    groups: dict[tuple[str, ...], dict[int, list[int]]] = {}
    for node, name in enumerate(names):
        for joint, pattern in _PATTERNS.items():
            if match := pattern.search(name):
                rest = (name[: match.start()], name[match.end() :])
                around = tuple(re.sub(r"[\W\d_]+", " ", part).strip().casefold() for part in rest)
                groups.setdefault(around, {}).setdefault(joint, []).append(node)
    hands = [group for group in groups.values() if not _missing(group)]
    if not hands:
        missing = _missing(max(groups.values(), key=len, default={}))
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        expected = "those of a hand by their WebXR names, or by a mapping file (mapping, --mapping)"
        checks.fail("joints", expected, f"none called '{missing[0]}'{more}")
    found = []
    for group in hands:
        nodes_of, outside = {}, []
        for joint, nodes in group.items():
            node, *others = [node for node in nodes if node in skin] or nodes
            if others:
                got = f"{_label(names, node)} and {_label(names, others[0])}"
                checks.fail(JOINT_NAMES[joint], "one node (mapping, --mapping, can say which)", got)
            nodes_of[joint] = node
            outside.append(_PATTERNS[joint].sub(" ", names[node], count=1))
        found.append(FoundJoints(nodes_of, side_in(*outside)))
    return found


def _missing(joints: Mapping[int, list[int] | int]) -> list[str]:
    return [name for name in REQUIRED if JOINT_INDEX[name] not in joints]


def _label(names: Sequence[str], node: int) -> str:
    return f"'{names[node]}' (node {node})"


def hand_by_mapping(names: Sequence[str], mapping: Mapping[str, str | int]) -> FoundJoints:
    """Return the joints of a mapping from WebXR names to nodes of the rig."""
    nodes = {JOINT_INDEX[k]: _node(names, k, wanted) for k, wanted in mapping.items()}
    if missing := _missing(nodes):
        checks.fail("mapping", f"a node for '{missing[0]}'", "none")
    for node in nodes.values():
        same = [f"'{JOINT_NAMES[joint]}'" for joint, other in nodes.items() if other == node]
        if len(same) > 1:
            got = f"{_label(names, node)} for {' and '.join(same)}"
            checks.fail("mapping", "a node for each joint", got)
    return FoundJoints(nodes, side_in(*(names[node] for node in nodes.values())))


def _node(names: Sequence[str], joint: str, wanted: str | int) -> int:
    """Return the node that is called so, or has that number."""
    found = [i for i, name in enumerate(names) if wanted in (i, name)]
    if len(found) != 1:
        got = f"nodes {found}: give its number" if found else f"none of {len(names)}"
        checks.fail(f"mapping: {joint}", f"a node with the name or number {wanted!r}", got)
    return found[0]
