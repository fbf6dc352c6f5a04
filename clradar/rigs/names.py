"""The joints of a hand among the nodes of a rig: by WebXR names, or by a mapping file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from clradar.errors import RigError
from clradar.hand.joints import JOINT_INDEX, JOINT_NAMES
from clradar.rigs.anatomy import OPTIONAL
from clradar.rigs.failures import fail

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


def side_in(text: str) -> str | None:
    """Return the side that a name contains as a word, left, right, l or r; None without one."""
    found = {_SIDES[w.lower()] for w in _WORD.findall(text) if w.lower() in _SIDES}
    return found.pop() if len(found) == 1 else None


def hands_by_name(path: Path, names: Sequence[str], skin: set[int]) -> list[FoundJoints]:
    """Return the hands whose joints have WebXR names, each hand with one prefix and suffix.

    Numbers, case and separators do not count: ``Index-Finger_Tip.R`` and ``b_r_index_finger_tip``
    are `index-finger-tip` of two hands.

    `skin` are the joints of skins. Other nodes count where none of these has the name: a tip often
    has no vertices.
    """
    groups: dict[tuple[str, ...], dict[int, list[int]]] = {}
    for node, name in enumerate(names):
        for joint, pattern in _PATTERNS.items():
            match = pattern.search(name)
            if match is None:
                continue
            rest = (name[: match.start()], name[match.end() :])
            around = tuple(re.sub(r"[\W\d_]+", " ", part).strip().casefold() for part in rest)
            groups.setdefault(around, {}).setdefault(joint, []).append(node)
    for group in groups.values():
        for joint, found in group.items():
            group[joint] = [node for node in found if node in skin] or found
    complete = {k: g for k, g in groups.items() if all(JOINT_INDEX[n] in g for n in REQUIRED)}
    if not complete:
        best = max(groups.values(), key=len, default={})
        missing = [name for name in REQUIRED if JOINT_INDEX[name] not in best]
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        fail(
            path,
            "the joints of a hand by their WebXR names, or by a mapping file (--mapping)",
            f"none called '{missing[0]}'{more}",
        )
    hands = []
    for around, group in complete.items():
        nodes_of = {joint: _only(path, names, joint, found) for joint, found in group.items()}
        sides = {side_in(_outside(names[n], joint)) for joint, n in nodes_of.items()}
        side = sides.pop() if len(sides) == 1 else side_in(" ".join(around))
        hands.append(FoundJoints(nodes_of, side))
    return hands


def _label(names: Sequence[str], node: int) -> str:
    return f"'{names[node]}' (node {node})"


def _outside(name: str, joint: int) -> str:
    return _PATTERNS[joint].sub(" ", name, count=1)


def _only(path: Path, names: Sequence[str], joint: int, found: list[int]) -> int:
    if len(found) > 1:
        labels = " and ".join(_label(names, node) for node in found[:2])
        fail(path, f"one joint '{JOINT_NAMES[joint]}' (--mapping can say which)", labels)
    return found[0]


def hand_by_mapping(
    path: Path, names: Sequence[str], mapping: Mapping[str, str | int], source: str
) -> FoundJoints:
    """Return the joints of a mapping from WebXR names to names of nodes, or their numbers.

    `path` is the rig and `source` the mapping in messages.
    """
    nodes = {JOINT_INDEX[k]: _node(path, names, k, wanted) for k, wanted in mapping.items()}
    missing = [name for name in REQUIRED if JOINT_INDEX[name] not in nodes]
    if missing:
        fail(path, f"a node for '{missing[0]}' in {source}", "none")
    taken: dict[int, int] = {}
    for joint, node in nodes.items():
        if node in taken:
            both = f"'{JOINT_NAMES[taken[node]]}' and '{JOINT_NAMES[joint]}'"
            found = f"{_label(names, node)} for {both}"
            fail(path, f"a node for each joint in {source}", found)
        taken[node] = joint
    sides = {side_in(names[node]) for node in nodes.values()} - {None}
    return FoundJoints(nodes, sides.pop() if len(sides) == 1 else None)


def _node(path: Path, names: Sequence[str], joint: str, wanted: str | int) -> int:
    found = [i for i, name in enumerate(names) if wanted in (i, name)]
    if not found:
        expected = f"a node called {wanted!r}"
        if isinstance(wanted, int):
            expected = f"a node below {len(names)}"
        fail(path, f"{expected} for '{joint}'", wanted if isinstance(wanted, int) else "none")
    if len(found) > 1:
        expected = f"one node called {wanted!r} for '{joint}' (give its number)"
        fail(path, expected, f"nodes {found}")
    return found[0]


def read_mapping(path: Path) -> dict[str, str | int]:
    """Return the table ``[joints]`` of a TOML file: WebXR name = name or number of a node.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.rigs import read_mapping
    >>> text = '[joints]\\nwrist = "Bone.001"\\nthumb-tip = 17'
    >>> _ = Path("mapping.toml").write_text(text)
    >>> read_mapping(Path("mapping.toml"))
    {'wrist': 'Bone.001', 'thumb-tip': 17}
    """
    from clradar.files.records import read_record
    from clradar.rigs.mapping_record import MappingFile

    expected = "a TOML file with a table [joints]: WebXR name = node"
    return read_record(path, MappingFile, expected, error=RigError).joints


def checked_mapping(path: Path, joints: Mapping[str, str | int]) -> dict[str, str | int]:
    """Return a mapping of WebXR names to names or numbers of nodes; `path` is for messages."""
    from clradar.files.records import record_of
    from clradar.rigs.mapping_record import MappingFile

    return record_of({"joints": dict(joints)}, MappingFile, path, error=RigError).joints
