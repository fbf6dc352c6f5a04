"""Tables of TOML or JSON files: values read one by one and checked, unknown keys refused."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, NoReturn, TypeVar

from clradar.errors import MeasurementError, quoted
from clradar.files.failures import clean
from clradar.files.toml_file import toml_brief

Default = TypeVar("Default")

_KEY_CHARACTERS = 80

LONGEST = 1e15
"""Decimal numbers below this are shown as the whole number to write instead."""


class Table:
    """One table; `note` decides what becomes of invalid values, and raises here.

    Parameters
    ----------
    source : str
        The file, for messages.
    name : str
        The table's name with dots, empty for the file's top.
    content : object
    """

    def __init__(self, source: str, name: str, content: Any) -> None:
        self._source, self._name = source, name
        self._known: list[str] = []
        self._content = content if isinstance(content, dict) else {}
        if not isinstance(content, dict):
            self.refuse("", "a table or object", content)

    def note(self, line: str) -> None:
        """Report that something is invalid; without an override, raise."""
        raise MeasurementError(line)

    def mistake(self, key: str, expected: str, words: str) -> None:
        """Report that a key is invalid; `words` describe what was found."""
        self.note(
            f"{clean(self._source)}: {self.place(key)}: expected {expected}, got {quoted(words)}"
        )

    def refuse(self, key: str, expected: str, value: object) -> None:
        """Report that a key has an invalid value."""
        self.mistake(key, expected, toml_brief(value))

    def fail(self, key: str, expected: str, got: object) -> NoReturn:
        """Raise the error that names the file, the key, what was expected and what was found."""
        words = got if isinstance(got, str) else toml_brief(got)
        Table.mistake(self, key, expected, words)
        raise AssertionError

    def place(self, key: str) -> str:
        return ".".join(quoted(part, _KEY_CHARACTERS) for part in (self._name, key) if part)

    def has(self, key: str) -> bool:
        return key in self._content

    def raw(self, key: str, default: Any = None) -> Any:
        """Return a value as it is."""
        self._known.append(key)
        return self._content.get(key, default)

    def whole(self, key: str, default: Default, low: int, high: int) -> int | Default:
        value = self.raw(key, default)
        expected = f"a whole number from {low} to {high}"
        if value is None and default is None:
            return default
        if isinstance(value, float) and value.is_integer() and abs(value) < LONGEST:
            self.mistake(key, expected, f"the decimal number {value!r}; write {int(value)}")
            return default
        if not is_whole(value) or not low <= value <= high:
            self.refuse(key, expected, value)
            return default
        return value

    def one_of(self, key: str, default: Default, choices: Sequence[str]) -> str | Default:
        value = self.raw(key, default)
        if value is None and default is None:
            return default
        if not isinstance(value, str) or value not in choices:
            self.refuse(key, choice_text(value, choices), value)
            return default
        return value

    def done(self, known: Sequence[str] = ()) -> None:
        """Report every key that was not read; `known` are further valid ones."""
        names = list(dict.fromkeys([*self._known, *known]))
        for key in self._content:
            if key not in names:
                remark = f"unknown key; expected one of {', '.join(names)}{nearest(key, names)}"
                self.note(f"{clean(self._source)}: {self.place(key)}: {remark}")


class StrictTable(Table):
    """A table whose first invalid value raises, and whose missing values are None."""

    def table(self, key: str, *, needed: bool = False) -> StrictTable:
        """Return an inner table, an empty one if it is not there."""
        if needed and not self.has(key):
            self.fail(key, "a table of that name", "none")
        return StrictTable(self._source, self.place(key), self.raw(key, {}))

    def tables(self, key: str) -> list[StrictTable]:
        """Return the tables of ``[[key]]``, none if it is not there."""
        content = self.raw(key, [])
        if not isinstance(content, list):
            self.fail(key, f"tables [[{key}]]", content)
        place = self.place(key)
        return [StrictTable(self._source, f"{place}[{i}]", own) for i, own in enumerate(content)]

    def fail_with(self, remark: str) -> NoReturn:
        """Raise the error that names the file, and this table as the start of the remark."""
        place = f"{self.place('')}{remark}".lstrip(".: ")
        raise MeasurementError(f"{clean(self._source)}: {place}")

    def text(self, key: str, expected: str = "a key of the file") -> str | None:
        value = self.raw(key)
        good = isinstance(value, str) and 0 < len(value) <= 1000 and "\0" not in value
        if value is not None and not good:
            self.fail(key, f"{expected}, as text", toml_brief(value))
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
            self.fail(key, expected, toml_brief(value))
        return tuple(value)

    def numbers(self, key: str, *counts: int) -> tuple[float, ...] | None:
        """Return a list of as many numbers as one of `counts`, if there are any."""
        expected = f"a list of {' or '.join(map(str, counts))} numbers"
        expected = expected if counts else "a list of numbers"
        value = self._list(key, expected)
        if value is None:
            return None
        if not value or (counts and len(value) not in counts):
            self.fail(key, expected, toml_brief(value))
        return tuple(self._number(key, v) for v in value)

    def whole_numbers(self, key: str, low: int) -> tuple[int, ...] | None:
        expected = f"a list of whole numbers from {low}"
        value = self._list(key, expected)
        if value is None:
            return None
        if not value or not all(is_whole(v) and v >= low for v in value):
            self.fail(key, expected, toml_brief(value))
        return tuple(value)

    def rows(self, key: str) -> tuple[tuple[float, ...], ...] | None:
        expected = "a list of rows of numbers, all as long as each other"
        value = self._list(key, expected)
        if value is None:
            return None
        if not value or not all(isinstance(row, list) and row for row in value):
            self.fail(key, expected, toml_brief(value))
        if len({len(row) for row in value}) > 1:
            self.fail(key, expected, toml_brief(value))
        return tuple(tuple(self._number(key, v) for v in row) for row in value)

    def whole_entries(self) -> tuple[tuple[str, int], ...]:
        """Return all entries of this table, each a whole number from 0."""
        return tuple((key, self.whole(key, 0, 0, 2**31)) for key in self._content)

    def _list(self, key: str, expected: str) -> list[Any] | None:
        value = self.raw(key)
        if value is not None and not isinstance(value, list):
            self.fail(key, expected, toml_brief(value))
        return value

    def _number(self, key: str, value: Any) -> float:
        if not is_number(value):
            self.fail(key, "a finite number", toml_brief(value))
        return float(value)


def is_number(value: object) -> bool:
    """Whether a value of TOML or JSON is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300  # an int of any length, or an infinity, is larger; NaN is not less


def is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def nearest(given: object, known: Sequence[str]) -> str:
    """Return " (did you mean ...?)" where a known word is near to what was given, else nothing.

    Upper and lower case count as the same.
    """
    folded = {word.casefold(): word for word in known}
    found = get_close_matches(str(given).casefold(), folded, n=1)
    return f" (did you mean '{folded[found[0]]}'?)" if found else ""


def choice_text(given: object, choices: Sequence[str]) -> str:
    return "one of " + ", ".join(f'"{c}"' for c in choices) + nearest(given, choices)
