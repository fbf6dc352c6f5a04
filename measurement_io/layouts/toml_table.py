"""Tables of a layout: values taken one by one and checked, unknown keys refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NoReturn

from clradar.errors import MeasurementError
from clradar.files.failures import clean
from clradar.files.toml_file import toml_brief

_MISSING = object()


class Table:
    """One table of a layout file.

    Parameters
    ----------
    source : str
        The layout file, for messages.
    name : str
        The table's name, empty for the file's top.
    content : mapping
    """

    def __init__(self, source: str, name: str, content: Any) -> None:
        self._source, self._name = source, name
        if not isinstance(content, dict):
            self._fail_here("a table", content)
        self._left = dict(content)
        self._known: list[str] = []

    def fail(self, key: str, expected: str, got: object) -> NoReturn:
        """Raise the error that names the file, the table and the key."""
        text = got if isinstance(got, str) else toml_brief(got)
        raise MeasurementError(
            f"{clean(self._source)}: {self.place(key)}: expected {expected}, got {clean(text)}"
        )

    def place(self, key: str) -> str:
        return f"[{self._name}] {key}" if self._name else key

    def peek(self, key: str) -> Any:
        """Return a value that is yet to be taken, None if there is none."""
        return self._left.get(key)

    def table(self, key: str, *, needed: bool = False) -> Table:
        """Return an inner table, an empty one if it is not there."""
        value = self._take(key)
        if value is _MISSING:
            if needed:
                self.fail(key, "a table of that name", "none")
            value = {}
        return Table(self._source, f"{self._name}.{key}" if self._name else key, value)

    def text(self, key: str, expected: str = "a key of the file") -> str | None:
        value = self._take(key)
        if value is _MISSING:
            return None
        if not isinstance(value, str) or not value or len(value) > 1000 or "\0" in value:
            self.fail(key, f"{expected}, as text", value)
        return value

    def one_of(self, key: str, choices: Sequence[str], default: str | None = None) -> str | None:
        value = self._take(key)
        if value is _MISSING:
            return default
        if value not in choices:
            self.fail(key, "one of " + ", ".join(f'"{c}"' for c in choices), value)
        return str(value)

    def number(self, key: str) -> float | None:
        value = self._take(key)
        return None if value is _MISSING else self._number(key, value)

    def number_or_text(self, key: str) -> str | float | None:
        if isinstance(self._left.get(key), str):
            return self.text(key)
        return self.number(key)

    def whole(self, key: str, low: int, high: int) -> int | None:
        value = self._take(key)
        if value is _MISSING:
            return None
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            self.fail(key, f"a whole number from {low} to {high}", value)
        return value

    def texts(self, key: str, expected: str) -> tuple[str, ...] | None:
        value = self._take(key)
        if value is _MISSING:
            return None
        good = isinstance(value, list) and all(isinstance(v, str) and v for v in value)
        if not good or (len(set(value)) != len(value) and key != "axes"):
            self.fail(key, expected, value)
        return tuple(value)

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...] | None:
        value = self._take(key)
        if value is _MISSING:
            return None
        expected = "a list of numbers" if count is None else f"a list of {count} numbers"
        if not isinstance(value, list) or not value or count not in (None, len(value)):
            self.fail(key, expected, value)
        return tuple(self._number(key, v) for v in value)

    def whole_numbers(self, key: str, low: int) -> tuple[int, ...] | None:
        value = self._take(key)
        if value is _MISSING:
            return None
        if not isinstance(value, list) or not value:
            self.fail(key, "a list of whole numbers", value)
        for v in value:
            if not isinstance(v, int) or isinstance(v, bool) or v < low:
                self.fail(key, f"a list of whole numbers from {low}", value)
        return tuple(value)

    def rows(self, key: str) -> tuple[tuple[float, ...], ...] | None:
        value = self._take(key)
        if value is _MISSING:
            return None
        expected = "a list of rows of numbers, all as long as each other"
        if not isinstance(value, list) or not value or not isinstance(value[0], list):
            self.fail(key, expected, value)
        for row in value:
            if not isinstance(row, list) or not row or len(row) != len(value[0]):
                self.fail(key, expected, row)
        return tuple(tuple(self._number(key, v) for v in row) for row in value)

    def whole_entries(self) -> tuple[tuple[str, int], ...]:
        """Return all entries of this table, each a whole number from 0."""
        return tuple((key, self.whole(key, 0, 2**31) or 0) for key in list(self._left))

    def done(self) -> None:
        """Raise if anything was not taken; the error lists what is known."""
        for key in self._left:
            known = ", ".join(self._known)
            where = f"[{self._name}]" if self._name else "the top of the file"
            raise MeasurementError(
                f"{clean(self._source)}: {where}: expected only the keys {known}, got "
                f"{clean(key)[:80]}"
            )

    def _take(self, key: str) -> Any:
        self._known.append(key)
        return self._left.pop(key, _MISSING)

    def _number(self, key: str, value: Any) -> float:
        if not isinstance(value, int | float) or isinstance(value, bool):
            self.fail(key, "a number", value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(key, "a finite number", value)
        return number

    def _fail_here(self, expected: str, got: object) -> NoReturn:
        found = clean(toml_brief(got))
        raise MeasurementError(
            f"{clean(self._source)}: [{self._name}]: expected {expected}, got {found}"
        )
