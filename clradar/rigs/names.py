"""The joints of a hand among the nodes of a rig: by WebXR names, or by a mapping file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from clradar.errors import RigError
from clradar.files.toml_file import read_toml
from clradar.hand.joints import JOINT_INDEX, JOINT_NAMES
from clradar.rigs.anatomy import OPTIONAL
from clradar.rigs.failures import fail, reading
from clradar.rigs.nodes import NodeTree

REQUIRED = tuple(name for name in JOINT_NAMES if JOINT_INDEX[name] not in OPTIONAL)

Mapped = dict[int, int]
"""Joint (index into `JOINT_NAMES`) -> node."""

# The words of a name in any case, with any characters but letters between them.
_PATTERNS = {
    JOINT_INDEX[name]: re.compile(r"[\W\d_]*".join(name.split("-")), re.IGNORECASE)
    for name in JOINT_NAMES
}
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}


@dataclass(frozen=True, slots=True)
class FoundJoints:
    """A hand's joints among the nodes, and its side, "left" or "right", if the names tell it."""

    nodes: Mapped
    side: str | None


def side_in(text: str) -> str | None:
    """Return the side that a name contains as a word, left, right, l or r; None without one."""
    found = {_SIDES[w.lower()] for w in _WORD.findall(text) if w.lower() in _SIDES}
    return found.pop() if len(found) == 1 else None


def hands_by_name(path: Path, tree: NodeTree, skin: set[int]) -> list[FoundJoints]:
    """Return the hands whose joints have WebXR names, each hand with one prefix and suffix.

    Numbers, case and separators do not count: ``Index-Finger_Tip.R`` and ``b_r_index_finger_tip``
    are `index-finger-tip` of two hands.

    `skin` are the joints of skins. Other nodes count where none of these has the name: a tip often
    has no vertices.
    """
    groups: dict[tuple[str, ...], dict[int, list[int]]] = {}
    for node in range(len(tree.names)):
        for joint, pattern in _PATTERNS.items():
            match = pattern.search(tree.names[node])
            if match is None:
                continue
            name = tree.names[node]
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
        nodes_of = {joint: _only(path, tree, joint, found) for joint, found in group.items()}
        sides = {side_in(_outside(tree.names[n], joint)) for joint, n in nodes_of.items()}
        side = sides.pop() if len(sides) == 1 else side_in(" ".join(around))
        hands.append(FoundJoints(nodes_of, side))
    return hands


def _outside(name: str, joint: int) -> str:
    return _PATTERNS[joint].sub(" ", name, count=1)


def _only(path: Path, tree: NodeTree, joint: int, found: list[int]) -> int:
    if len(found) > 1:
        labels = " and ".join(tree.label(node) for node in found[:2])
        fail(path, f"one joint '{JOINT_NAMES[joint]}' (--mapping can say which)", labels)
    return found[0]


def hand_by_mapping(
    path: Path, tree: NodeTree, mapping: Mapping[str, str | int], source: str
) -> FoundJoints:
    """Return the joints of a mapping from WebXR names to names of nodes, or their numbers.

    `path` is the rig and `source` the mapping in messages.
    """
    nodes: Mapped = {}
    with reading(path, "a mapping of joints"):
        for name, wanted in mapping.items():
            if name not in JOINT_INDEX:
                fail(path, f"WebXR joint names in {source}", repr(name))
            nodes[JOINT_INDEX[name]] = _node(path, tree, name, wanted)
        missing = [name for name in REQUIRED if JOINT_INDEX[name] not in nodes]
        if missing:
            fail(path, f"a node for '{missing[0]}' in {source}", "none")
        taken: dict[int, int] = {}
        for joint, node in nodes.items():
            if node in taken:
                names = f"'{JOINT_NAMES[taken[node]]}' and '{JOINT_NAMES[joint]}'"
                fail(path, f"a node for each joint in {source}", f"{tree.label(node)} for {names}")
            taken[node] = joint
    sides = {side_in(tree.names[node]) for node in nodes.values()} - {None}
    return FoundJoints(nodes, sides.pop() if len(sides) == 1 else None)


def _node(path: Path, tree: NodeTree, name: str, wanted: str | int) -> int:
    if type(wanted) is int:
        if not 0 <= wanted < len(tree.names):
            fail(path, f"a node below {len(tree.names)} for '{name}'", wanted)
        return wanted
    found = [i for i, known in enumerate(tree.names) if known == wanted]
    if not found:
        fail(path, f"a node called {wanted!r} for '{name}'", "none")
    if len(found) > 1:
        fail(path, f"one node called {wanted!r} for '{name}' (give its number)", f"nodes {found}")
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
    expected = "a TOML file with a table [joints]: WebXR name = node"
    table = read_toml(path, expected, error=RigError)
    joints = table.pop("joints", None)
    if table or not isinstance(joints, dict):
        fail(path, expected, f"{', '.join(map(repr, table)) or 'no such table'}")
    return checked_mapping(path, joints)


def checked_mapping(path: Path, joints: Mapping[str, str | int]) -> dict[str, str | int]:
    """Return a mapping of WebXR names to names or numbers of nodes; `path` is for messages."""
    for name, node in joints.items():
        if name not in JOINT_INDEX:
            fail(path, "WebXR joint names", repr(name))
        if type(node) not in (str, int):
            fail(path, f"the name or number of a node for '{name}'", repr(node))
    return dict(joints)
