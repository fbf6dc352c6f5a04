"""Values of plans: random variables and their streams, and what pydantic reads within limits."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError, core_schema

from clradar.errors import ClradarError
from clradar.files.failures import clean
from clradar.files.records import LONGEST, is_number, is_whole, mistake
from clradar.files.toml_file import choice_text, nearest, toml_brief

KINDS = {"uniform": "[low, high]", "normal": "[mean, standard deviation]", "choice": "[a, b, ...]"}
"""Distributions, and the parameters that a plan gives for each."""

SIGMAS = 6.0
"""So many standard deviations of a normal draw have to be within the limits of a plan; 1 in 500
million draws is beyond, and not cut."""


@dataclass(frozen=True, slots=True)
class Draw:
    """A number, or the distribution that it is drawn from for every sample."""

    kind: str  # "fixed", "uniform", "normal" or "choice"
    values: tuple[float, ...]  # the number; low, high; mean, deviation; equally probable numbers

    def draw(self, random: np.random.Generator) -> float:
        if self.kind == "fixed":
            return self.values[0]
        if self.kind == "uniform":
            return float(random.uniform(self.values[0], self.values[1]))
        if self.kind == "normal":
            return float(random.normal(self.values[0], self.values[1]))
        return self.values[int(random.integers(len(self.values)))]

    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest value; of a normal draw `SIGMAS` about the mean."""
        if self.kind == "normal":
            mean, deviation = self.values
            return mean - SIGMAS * deviation, mean + SIGMAS * deviation
        return min(self.values), max(self.values)

    def to_plain(self) -> Any:
        """Return it in the syntax of plans."""
        return self.values[0] if self.kind == "fixed" else {self.kind: list(self.values)}


def fixed(value: float) -> Draw:
    return Draw("fixed", (value,))


def stream(seed: int, index: int, quantity: str) -> np.random.Generator:
    """Return the random numbers of one quantity, such as "placement.x_mm", of one sample.

    They depend on the plan's seed, the sample's index and the quantity's name alone.
    """
    key = (index, zlib.crc32(quantity.encode("utf-8")))
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """The annotation of a value that `read` takes and checks, with its JSON schema."""

    read: Callable[..., Any]
    schema: Any
    info: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        if self.info:
            return core_schema.with_info_plain_validator_function(self.read)
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:
        return dict(self.schema)


def number(low: float, high: float, *, above: bool = False) -> Value:
    """A number from `low` (above it, if `above`) to `high`."""

    def read(value: Any) -> float:
        if not is_number(value) or not low <= value <= high or (above and value == low):
            raise mistake(f"a number {_range(low, high, above)}", value)
        return float(value)

    least = {"exclusiveMinimum" if above else "minimum": low}
    return Value(read, {"type": "number", **least, "maximum": high})


def whole(low: int, high: int) -> Value:
    """A whole number from `low` to `high`."""

    def read(value: Any) -> int:
        expected = f"a whole number from {low} to {high}"
        if isinstance(value, float) and value.is_integer() and abs(value) < LONGEST:
            raise mistake(expected, f"the decimal number {value!r}; write {int(value)}")
        if not is_whole(value) or not low <= value <= high:
            raise mistake(expected, value)
        return int(value)

    return Value(read, {"type": "integer", "minimum": low, "maximum": high})


def choice(*names: str) -> Value:
    """One of some words."""

    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise mistake(choice_text(value, names), toml_brief(value))
        return value

    return Value(read, {"enum": list(names)})


def channel_numbers(low: int, high: int) -> Value:
    """A list of whole numbers, none of them twice."""

    def read(value: Any) -> tuple[int, ...]:
        good = isinstance(value, list) and all(is_whole(v) and low <= v <= high for v in value)
        if not good or len(set(value)) != len(value):
            raise mistake(f"a list of different whole numbers from {low} to {high}", value)
        return tuple(value)

    item = {"type": "integer", "minimum": low, "maximum": high}
    return Value(read, {"type": "array", "items": item, "uniqueItems": True})


def floats(count: int) -> Value:
    """A list of so many numbers."""

    def read(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count or not all(map(is_number, value)):
            raise mistake(f"a list of {count} numbers", value)
        return tuple(float(v) for v in value)

    item = {"type": "number"}
    return Value(read, {"type": "array", "items": item, "minItems": count, "maxItems": count})


def draws(low: float, high: float, kinds: tuple[str, ...] = tuple(KINDS)) -> Value:
    """A number or a distribution; every draw has to be from `low` to `high`."""

    def read(value: Any) -> Draw:
        found = _draw(value, kinds)
        least, greatest = found.bounds()
        if least < low or greatest > high:
            text = toml_brief(found.to_plain())
            if found.kind == "normal":
                text += (
                    f", which is [{least:g}, {greatest:g}] within {SIGMAS:g} standard deviations"
                )
            raise mistake(f"values {_range(low, high, False)}", text)
        return found

    numbers = {"type": "array", "items": {"type": "number"}, "minItems": 1}
    table = {
        "type": "object",
        "properties": {kind: {**numbers, "description": KINDS[kind]} for kind in kinds},
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": False,
    }
    return Value(read, {"anyOf": [{"type": "number", "minimum": low, "maximum": high}, table]})


def _draw(value: Any, kinds: tuple[str, ...]) -> Draw:
    if isinstance(value, Draw):
        return value
    if is_number(value):
        return fixed(float(value))
    expected = "a number or " + " or ".join(f"{{ {k} = {KINDS[k]} }}" for k in kinds)
    if not isinstance(value, dict) or len(value) != 1:
        raise mistake(expected, toml_brief(value))
    kind, given = next(iter(value.items()))
    if kind not in kinds:
        near = "" if kind in KINDS else nearest(kind, kinds)
        raise mistake(expected + near, f"{{ {kind} = ... }}")
    if not isinstance(given, list) or not given or not all(map(is_number, given)):
        raise mistake(f"a list {KINDS[kind]} of numbers", toml_brief(given), key=kind)
    values = tuple(float(v) for v in given)
    if kind != "choice" and len(values) != 2:
        raise mistake(f"two numbers {KINDS[kind]}", toml_brief(given), key=kind)
    if kind == "uniform" and values[1] < values[0]:
        raise mistake("[low, high] with low <= high", toml_brief(given), key=kind)
    if kind == "normal" and values[1] < 0:
        raise mistake("a standard deviation that is not negative", toml_brief(given), key=kind)
    return Draw(kind, values)


def _range(low: float, high: float, above: bool) -> str:
    if above:
        return f"above {low:g} and at most {high:g}"
    return f"from {low:g} to {high:g}"


def tried(call: Callable[..., Any], *args: Any) -> Any:
    """Call a function whose errors are mistakes of the plan."""
    try:
        return call(*args)
    except (ClradarError, OSError) as error:
        raise PydanticCustomError("said", "{text}", {"text": clean(error)}) from error
