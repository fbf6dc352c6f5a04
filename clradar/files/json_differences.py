"""Differences of two JSON values, as text: settings of a run and of its resumption."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

MOST = 5
"""Differences that an error lists."""

SHOWN = 60
"""Characters of a setting's value in an error."""

LEAD = 20
"""Of these before the first that differs."""


def differences(before: Any, now: Any, name: str = "") -> list[str]:
    """Return in words how two values of JSON differ, one line per setting.

    Short lists are shown whole, of long ones the entries that differ.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        found = []
        for key in {**now, **before}:
            found += differences(before.get(key), now.get(key), f"{name}.{key}" if name else key)
        return found
    if before == now:
        return []
    texts = str(before), str(now)
    if isinstance(before, list) and isinstance(now, list) and max(map(len, texts)) > SHOWN:
        found = []
        for i, (one, other) in enumerate(zip(before, now, strict=False)):
            found += differences(one, other, f"{name}[{i}]")
        if len(before) != len(now):
            found.insert(0, f"{name} of {len(before)}, now of {len(now)}")
        return found
    # Long texts from about where they differ.
    pairs = enumerate(zip(*texts, strict=False))
    common = next((i for i, (one, other) in pairs if one != other), min(map(len, texts)))
    start = common - LEAD if common > SHOWN - LEAD else 0
    return [f"{name} {_cut(texts[0], start)}, now {_cut(texts[1], start)}"]


def listed_differences(found: Sequence[str], most: int = MOST) -> str:
    """Return differences in one line: the first `most` of them, and how many more there are."""
    more = len(found) - most
    return "; ".join(found[:most]) + (f"; {more} more" if more > 0 else "")


def _cut(text: str, start: int) -> str:
    cut = ("…" if start else "") + text[start : start + SHOWN]
    return cut + "…" if len(text) > start + SHOWN else cut
