"""Tables of a layout."""

from __future__ import annotations

from typing import Any

from clradar.files.table import Table, is_number, is_whole


class LayoutTable(Table):
    """One table of a layout file; what is not there is None."""

    def table(self, key: str, *, needed: bool = False) -> LayoutTable:
        """Return an inner table, an empty one if it is not there."""
        if needed and not self.has(key):
            self.fail(key, "a table of that name", "none")
        return LayoutTable(self._source, self.place(key), self.raw(key, {}))

    def text(self, key: str, expected: str = "a key of the file") -> str | None:
        value = self.raw(key)
        good = isinstance(value, str) and 0 < len(value) <= 1000 and "\0" not in value
        if value is not None and not good:
            self.fail(key, f"{expected}, as text", value)
        return value

    def number(self, key: str) -> float | None:
        value = self.raw(key)
        return None if value is None else self._number(key, value)

    def number_or_text(self, key: str) -> str | float | None:
        return self.text(key) if isinstance(self.raw(key), str) else self.number(key)

    def texts(self, key: str, expected: str) -> tuple[str, ...] | None:
        value = self._list(key, expected)
        if value is None:
            return None
        good = all(isinstance(v, str) and v for v in value)
        if not good or (len(set(value)) != len(value) and key != "axes"):
            self.fail(key, expected, value)
        return tuple(value)

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...] | None:
        expected = "a list of numbers" if count is None else f"a list of {count} numbers"
        value = self._list(key, expected)
        if value is None:
            return None
        if not value or count not in (None, len(value)):
            self.fail(key, expected, value)
        return tuple(self._number(key, v) for v in value)

    def whole_numbers(self, key: str, low: int) -> tuple[int, ...] | None:
        expected = f"a list of whole numbers from {low}"
        value = self._list(key, expected)
        if value is None:
            return None
        if not value or not all(is_whole(v) and v >= low for v in value):
            self.fail(key, expected, value)
        return tuple(value)

    def rows(self, key: str) -> tuple[tuple[float, ...], ...] | None:
        expected = "a list of rows of numbers, all as long as each other"
        value = self._list(key, expected)
        if value is None:
            return None
        if not value or not all(isinstance(row, list) and row for row in value):
            self.fail(key, expected, value)
        if len({len(row) for row in value}) > 1:
            self.fail(key, expected, value)
        return tuple(tuple(self._number(key, v) for v in row) for row in value)

    def whole_entries(self) -> tuple[tuple[str, int], ...]:
        """Return all entries of this table, each a whole number from 0."""
        return tuple((key, self.whole(key, 0, 0, 2**31)) for key in self._content)

    def _list(self, key: str, expected: str) -> list[Any] | None:
        value = self.raw(key)
        if value is not None and not isinstance(value, list):
            self.fail(key, expected, value)
        return value

    def _number(self, key: str, value: Any) -> float:
        if not is_number(value):
            self.fail(key, "a finite number", value)
        return float(value)
