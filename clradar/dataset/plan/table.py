"""Checked values of the tables of a plan; all mistakes are collected, not only the first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from clradar.dataset.plan.draws import KINDS, SIGMAS, Draw, fixed
from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import clean
from clradar.files.table import Table, is_number, is_whole, nearest
from clradar.files.toml_file import toml_brief

Value = TypeVar("Value")

MOST_MISTAKES = 20
"""That the text of an error lists; its `mistakes` has all."""


class PlanError(MeasurementError):
    """A plan has mistakes; of several the text has their number and one line for each.

    Attributes
    ----------
    mistakes : tuple of str
        One line each: file, key, what was expected, what was found.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import PlanError, read_plan
    >>> _ = Path("plan.toml").write_text('sampels = 3\\nposes.names = "letters"\\nalpha = 2')
    >>> try:
    ...     read_plan("plan.toml")
    ... except PlanError as error:
    ...     print(*error.mistakes, sep="\\n")
    plan.toml: samples: expected the number of samples, got nothing
    plan.toml: alpha: expected values from 0 to 1, got 2
    plan.toml: sampels: unknown key; expected one of ... (did you mean 'samples'?)
    """

    def __init__(self, mistakes: Sequence[str]) -> None:
        self.mistakes = tuple(mistakes)
        lines = list(self.mistakes[:MOST_MISTAKES])
        if len(self.mistakes) > len(lines):
            lines.append(f"and {len(self.mistakes) - len(lines)} more")
        if len(self.mistakes) > 1:
            lines.insert(0, f"{len(self.mistakes)} mistakes, one per line:")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[PlanError], tuple[tuple[str, ...]]]:
        return PlanError, (self.mistakes,)


class PlanTable(Table):
    """One table of a plan; `mistakes` is shared by all of them."""

    def __init__(self, source: str, name: str, content: Any, mistakes: list[str]) -> None:
        self._mistakes = mistakes
        super().__init__(source, name, content)

    def note(self, line: str) -> None:
        self._mistakes.append(line)

    def table(self, key: str) -> PlanTable:
        """Return an inner table, an empty one if it is not there."""
        return self.inner(key, self.raw(key, {}))

    def inner(self, key: str, content: Any) -> PlanTable:
        return PlanTable(self._source, self.place(key), content, self._mistakes)

    def entries(self, key: str, what: str) -> list[Any]:
        """Return a list, an empty one if it is not there."""
        value = self.raw(key, [])
        if not isinstance(value, list):
            self.refuse(key, f"a list of {what}", value)
            return []
        return value

    def checked(self, key: str, check: Callable[..., Value], *args: Any) -> Value | None:
        """Return `check(*args)`, or report why it raises and return None."""
        try:
            return check(*args)
        except (ClradarError, OSError) as error:
            self.note(f"{clean(self._source)}: {self.place(key)}: {clean(error)}")
            return None

    def number(
        self, key: str, default: float, low: float, high: float, *, above: bool = False
    ) -> float:
        """Return a number from `low` (above it, if `above`) to `high`."""
        value = self.raw(key, default)
        if not is_number(value) or not low <= value <= high or (above and value == low):
            self.refuse(key, f"a number {_range(low, high, above)}", value)
            return default
        return float(value)

    def numbers(self, key: str, default: Sequence[float], count: int) -> tuple[float, ...]:
        value = self.raw(key, list(default))
        if not isinstance(value, list) or len(value) != count or not all(map(is_number, value)):
            self.refuse(key, f"a list of {count} numbers", value)
            return tuple(default)
        return tuple(float(v) for v in value)

    def whole_numbers(self, key: str, low: int, high: int) -> tuple[int, ...]:
        """Return a list of whole numbers, none of them twice; an empty one if it is not there."""
        value = self.raw(key, [])
        good = isinstance(value, list) and all(is_whole(v) and low <= v <= high for v in value)
        if not good or len(set(value)) != len(value):
            self.refuse(key, f"a list of different whole numbers from {low} to {high}", value)
            return ()
        return tuple(value)

    def texts(self, key: str, default: Sequence[str], what: str) -> tuple[str, ...]:
        value = self.raw(key, list(default))
        good = isinstance(value, list) and all(isinstance(v, str) and v for v in value)
        if not good:
            self.refuse(key, f"a list of {what}", value)
            return tuple(default)
        if len(set(value)) != len(value):
            twice = sorted({v for v in value if value.count(v) > 1})
            self.mistake(key, f"every one of the {what} once", f"{', '.join(twice)} more often")
        return tuple(dict.fromkeys(value))

    def draw(
        self,
        key: str,
        default: Draw,
        low: float,
        high: float,
        kinds: Sequence[str] = tuple(KINDS),
    ) -> Draw:
        """Return a number or a distribution; every draw must be from `low` to `high`."""
        if not self.has(key):
            self._known.append(key)
            return default
        found = self._draw(key, self.raw(key), kinds)
        if found is None:
            return default
        least, greatest = found.bounds()
        if least < low or greatest > high:
            text = toml_brief(found.to_plain())
            if found.kind == "normal":
                text += (
                    f", which is [{least:g}, {greatest:g}] within {SIGMAS:g} standard deviations"
                )
            self.mistake(key, f"values {_range(low, high, False)}", text)
            return default
        return found

    def _draw(self, key: str, value: Any, kinds: Sequence[str]) -> Draw | None:
        if is_number(value):
            return fixed(float(value))
        expected = "a number or " + " or ".join(f"{{ {k} = {KINDS[k]} }}" for k in kinds)
        if not isinstance(value, dict) or len(value) != 1:
            self.refuse(key, expected, value)
            return None
        kind, given = next(iter(value.items()))
        if kind not in kinds:
            near = "" if kind in KINDS else nearest(kind, kinds)
            self.mistake(key, expected + near, f"{{ {kind} = ... }}")
            return None
        if not isinstance(given, list) or not given or not all(map(is_number, given)):
            self.refuse(f"{key}.{kind}", f"a list {KINDS[kind]} of numbers", given)
            return None
        values = tuple(float(v) for v in given)
        if kind != "choice" and len(values) != 2:
            self.refuse(f"{key}.{kind}", f"two numbers {KINDS[kind]}", given)
            return None
        if kind == "uniform" and values[1] < values[0]:
            self.refuse(f"{key}.{kind}", "[low, high] with low <= high", given)
            return None
        if kind == "normal" and values[1] < 0:
            self.refuse(f"{key}.{kind}", "a standard deviation that is not negative", given)
            return None
        return Draw(kind, values)


def _range(low: float, high: float, above: bool) -> str:
    if above:
        return f"above {low:g} and at most {high:g}"
    return f"from {low:g} to {high:g}"
