"""The interface of container files: keys with shapes and types, each of which can be read."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import MAX_KEYS

_SHOWN_KEYS = 30

Content = Literal["numbers", "text", "other"]


@dataclass(frozen=True, slots=True)
class Key:
    """One entry of a file.

    Attributes
    ----------
    name : str
        How a layout names it; inside groups and structs with "/" between the levels.
    shape : tuple of int
        As `Container.read` gives it.
    kind : str
        Its type in words: a dtype where it holds numbers.
    content : {"numbers", "text", "other"}
        What can be read; "other" cannot.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    content: Content

    def __str__(self) -> str:
        return f"{clean(self.name)[:80]} {self.description}"

    @property
    def description(self) -> str:
        """Shape and type in words."""
        shape = "" if self.content == "text" else f"{self.shape} "
        return f"{shape}{clean(self.kind)[:80]}"


class Container(ABC):
    """An opened file.

    Parameters
    ----------
    path : Path
    kind : str
        What it is, in words, such as "a MATLAB v5 file".
    matlab : bool
        Whether shapes are as MATLAB shows them: at least two axes, a last axis of one left out, and
        fields of structs reached by a dot.
    """

    def __init__(self, path: Path, kind: str, *, matlab: bool = False) -> None:
        self.path, self.kind, self.matlab = path, kind, matlab
        self.keys: dict[str, Key] = {}

    @abstractmethod
    def _read(self, key: Key, pick: Mapping[int, int]) -> np.ndarray: ...

    @abstractmethod
    def _text(self, key: Key) -> str: ...

    def add(self, key: Key) -> None:
        """List a key; names are unique and their number is bounded."""
        if key.name in self.keys:
            fail(self.path, "every key once", f"two of the name '{clean(key.name)[:80]}'")
        if len(self.keys) >= MAX_KEYS:
            fail(self.path, f"at most {MAX_KEYS} keys", "more")
        self.keys[key.name] = key

    def find(self, name: str, purpose: str) -> Key:
        """Return the key of that name; the error lists those there are."""
        wanted = name.replace(".", "/") if self.matlab else name
        wanted = wanted.strip("/")
        if wanted not in self.keys:
            fail(
                self.path,
                f"the key '{clean(name)[:80]}' ({purpose})",
                f"{self.kind} with the keys {self.listed()}",
            )
        return self.keys[wanted]

    def read(self, name: str, purpose: str, pick: Mapping[int, int] | None = None) -> np.ndarray:
        """Return the numbers of one key.

        Parameters
        ----------
        name, purpose : str
            Which key, and what it is read for (for messages).
        pick : mapping of int to int, optional
            Axes from which one index is kept; these axes are not part of the result.

        Raises
        ------
        MeasurementError
            No such key, no numbers, too large, damaged.
        """
        key = self.find(name, purpose)
        if key.content != "numbers":
            fail(self.path, f"'{clean(key.name)[:80]}' ({purpose}) to hold numbers", key.kind)
        return self._read(key, {} if pick is None else pick)

    def read_several(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the numbers of some small keys; what cannot be read is left out."""
        found = {}
        for name in names:
            with suppress(MeasurementError), reading(self.path, "readable numbers"):
                found[name] = self.read(name, "a guess")
        return found

    def text(self, name: str, purpose: str) -> str:
        """Return the text of one key."""
        key = self.find(name, purpose)
        if key.content != "text":
            fail(self.path, f"'{clean(key.name)[:80]}' ({purpose}) to hold text", key.kind)
        return self._text(key)

    def listed(self) -> str:
        """Return the keys in words, on one line."""
        shown = [str(key) for key in list(self.keys.values())[:_SHOWN_KEYS]]
        more = len(self.keys) - len(shown)
        return (", ".join(shown) or "none") + (f" and {more} more" if more > 0 else "")


def holds_numbers(dtype: np.dtype[Any]) -> bool:
    """Whether a dtype is real, complex, or a pair of real fields, possibly a complex number."""
    if dtype.names is not None:
        fields = [dtype[name] for name in dtype.names]
        return len(fields) == 2 and all(f.kind in "iuf" and f.itemsize <= 8 for f in fields)
    if dtype.subdtype is not None or dtype.hasobject:
        return False
    most = {"i": 8, "u": 8, "f": 8, "c": 16}
    return dtype.itemsize <= most.get(dtype.kind, 0)
