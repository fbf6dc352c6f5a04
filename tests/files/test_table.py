"""Tables: values are checked, and unknown keys are refused with the nearest known one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from clradar.errors import MeasurementError
from clradar.files.table import StrictTable, is_number

CONTENT = {
    "inner": {"n": 3}, "text": "a", "number": 2, "texts": ["a", "b"], "numbers": [1, 2.5],
    "rows": [[1, 2], [3, 4]], "choice": "one", "huge": 10**400, "nan": float("nan"), "true": True,
}  # fmt: skip


def test_values_are_read_as_they_are_and_missing_ones_are_none() -> None:
    table = StrictTable("f.toml", "", CONTENT)
    assert table.table("inner").whole("n", None, 1, 3) == 3
    assert (table.text("text"), table.number("number")) == ("a", 2.0)
    assert table.texts("texts", "names") == ("a", "b")
    assert table.numbers("numbers", 2, 3) == (1.0, 2.5)
    assert table.rows("rows") == ((1.0, 2.0), (3.0, 4.0))
    assert table.one_of("choice", None, ("one", "two")) == "one"
    for read in (table.text, table.number, table.numbers, table.rows):
        assert read("missing") is None
    assert table.whole("missing", 7, 0, 9) == 7
    table.done(known=("huge", "nan", "true"))


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda t: t.table("text"), 'expected a table or object, got "a"'),
        (lambda t: t.whole("number", None, 3, 9), "a whole number from 3 to 9, got 2"),
        (lambda t: t.whole("true", None, 0, 9), "a whole number from 0 to 9, got true"),
        (lambda t: t.number("text"), 'a finite number, got "a"'),
        (lambda t: t.number("huge"), "a finite number, got a huge number"),
        (lambda t: t.number("nan"), "a finite number, got nan"),
        (lambda t: t.numbers("numbers", 3), "a list of 3 numbers, got \\[1, 2.5\\]"),
        (lambda t: t.rows("numbers"), "a list of rows of numbers"),
        (lambda t: t.one_of("choice", None, ("ones", "two")), "did you mean 'ones'"),
        (lambda t: t.done(known=("numbr",)), "unknown key; expected one of numbr"),
    ],
)
def test_invalid_values_name_the_file_and_the_key(
    read: Callable[[StrictTable], Any], words: str
) -> None:
    with pytest.raises(MeasurementError, match=rf"^f\.toml: part\..*{words}"):
        read(StrictTable("f.toml", "part", CONTENT))


def test_numbers() -> None:
    assert all(map(is_number, (0, -1.5, 2**64)))
    assert not any(map(is_number, (True, "1", None, 10**400, float("inf"), float("nan"))))
