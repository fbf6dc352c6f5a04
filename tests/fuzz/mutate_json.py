"""Changes to JSON as a tree: keys and values replaced, doubled, removed, nested without end."""

from __future__ import annotations

import json
import random
from typing import Any

_TOKENS = (
    "NaN", "Infinity", "-Infinity", "null", "true", "false", "{", "}", "[", "]", '"', "\\u0000",
    "\\ud800", "\\", "1e999", "-0", "-0.0", "1E400", "0" * 50, "9" * 5000, "{}", "[]", '""', ",",
    ":", '"000000":', '"depth":', '"' + "\\u0660" * 6 + '":', "/*", "'", "\ufeff",
)  # fmt: skip
_NO_JSON = (b"[" * 100_000, b'{"a":' * 100_000, b"\xff", b"\xed\xa0\x80", b"\0")
DICTIONARY = (*(token.encode() for token in _TOKENS), *_NO_JSON)

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, -(2**70), 10**400, 0.0, -0.0, 1e308, 5e-324,
    float("nan"), float("inf"), "", "0", "nan", "\0", "\ud800", "x" * 100_000, "../../etc/passwd",
    "/dev/zero", [], {}, [[]], [None] * 1000, {"": {}}, {"000000": {}}, [1, 2, 3], [[1, 0], [0, 1]],
)  # fmt: skip
"""What stands where a reader expects something else."""


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Return the text with one node of its tree changed; text that is no JSON as it is."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return data
    nodes: list[tuple[Any, Any]] = []
    _collect(tree, nodes)
    if not nodes:
        return json.dumps(rng.choice(VALUES)).encode("utf-8", "surrogatepass")
    parent, key = rng.choice(nodes)
    kind = rng.randrange(5)
    if kind == 0:
        del parent[key]
    elif kind == 1 and isinstance(parent, dict):
        parent[rng.choice(("", "000001", "999999", "\u0660" * 6, str(key) * 2, "\ud800"))] = parent[
            key
        ]
    elif kind == 2 and isinstance(parent[key], list | dict):
        parent[key] = [parent[key]] * rng.choice((1, 2, 50))
    elif kind == 3:
        parent[key] = rng.choice(nodes)[0]
        return _dumped(parent[key], rng)
    else:
        parent[key] = rng.choice(VALUES)
    return _dumped(tree, rng)


def _dumped(tree: Any, rng: random.Random) -> bytes:
    try:
        return json.dumps(tree, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):  # a tree that holds itself
        return b"{}"


def _collect(node: Any, nodes: list[tuple[Any, Any]]) -> None:
    if not isinstance(node, dict | list):
        return
    for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
        if len(nodes) < 10_000:
            nodes.append((node, key))
            _collect(value, nodes)
