"""Differences of two JSON values, as text: settings of a run and of its resumption."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

MOST = 5  # differences that an error lists
SHOWN = 60  # characters of a setting's value in an error


def differences(before: Any, now: Any, name: str = "") -> list[str]:
    """Return as text how two values of JSON differ, one line per setting."""
    if before == now:
        return []
    texts = str(before), str(now)
    if isinstance(before, dict) and isinstance(now, dict):
        above = f"{name}." if name else ""
        inner = ((f"{above}{key}", before.get(key), now.get(key)) for key in {**now, **before})
        return [line for key, one, other in inner for line in differences(one, other, key)]
    if isinstance(before, list) and isinstance(now, list) and max(map(len, texts)) > SHOWN:
        found = [f"{name} of {len(before)}, now of {len(now)}"] * (len(before) != len(now))
        for i, (one, other) in enumerate(zip(before, now, strict=False)):
            found += differences(one, other, f"{name}[{i}]")
        return found
    # Long texts from about where they differ.
    pairs = enumerate(zip(*texts, strict=False))
    common = next((i for i, (one, other) in pairs if one != other), min(map(len, texts)))
    start = common - SHOWN // 3 if common > 2 * SHOWN // 3 else 0
    lead = "…" if start else ""
    one, other = (lead + text[start:][:SHOWN] + "…" * (len(text) > start + SHOWN) for text in texts)
    return [f"{name} {one}, now {other}"]


def listed_differences(found: Sequence[str], most: int = MOST) -> str:
    """Return differences in one line: the first `most` of them, and how many more there are."""
    more = len(found) - most
    return "; ".join(found[:most]) + (f"; {more} more" if more > 0 else "")
