"""Numbers of plans, fixed or drawn for every sample: their streams, and their limits."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pydantic import BaseModel
from pydantic_core import PydanticCustomError, core_schema

from clradar.errors import ClradarError
from clradar.files.failures import clean
from clradar.files.records import is_number, is_whole, mistake
from clradar.files.toml_file import nearest, toml_brief

KINDS = {"uniform": "[low, high]", "normal": "[mean, standard deviation]", "choice": "[a, b, ...]"}
"""Distributions, and the parameters that a plan gives for each."""

SIGMAS = 6.0
"""So many standard deviations of a normal draw have to be within the limits of a plan; 1 in 500
million draws is beyond, and not cut."""

SI: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "mm": ("m", lambda value: np.divide(value, 1e3)),
    "deg": ("rad", np.deg2rad),
    "ps": ("s", lambda value: 1e-12 * value),
}
"""Units of plans: those that functions have, and how they become them."""

_NUMBERS = {"type": "array", "items": {"type": "number"}, "minItems": 1}
_SCHEMA = {
    "type": "object",
    "properties": {kind: {**_NUMBERS, "description": text} for kind, text in KINDS.items()},
    "minProperties": 1,
    "maxProperties": 1,
    "additionalProperties": False,
}


@dataclass(frozen=True, slots=True)
class Draw:
    """A number, or the distribution that it is drawn from for every sample."""

    kind: str  # "fixed", "uniform", "normal" or "choice"
    values: tuple[float, ...]  # the number; low, high; mean, deviation; equally probable numbers

    def draw(self, random: np.random.Generator) -> float:
        if self.kind == "uniform":
            return float(random.uniform(self.values[0], self.values[1]))
        if self.kind == "normal":
            return float(random.normal(self.values[0], self.values[1]))
        return self.values[0 if self.kind == "fixed" else int(random.integers(len(self.values)))]

    def __float__(self) -> float:
        """The number of a sample, of which nothing is to be drawn."""
        return self.values[0]

    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest value; of a normal draw `SIGMAS` about the mean."""
        if self.kind == "normal":
            mean, deviation = self.values
            return mean - SIGMAS * deviation, mean + SIGMAS * deviation
        return min(self.values), max(self.values)

    def to_plain(self) -> Any:
        """Return it in the syntax of plans."""
        return self.values[0] if self.kind == "fixed" else {self.kind: list(self.values)}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        return core_schema.no_info_plain_validator_function(_draw)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        return {"anyOf": [{"type": "number"}, _SCHEMA]}


def fixed(value: float) -> Draw:
    return Draw("fixed", (value,))


def stream(seed: int, index: int, quantity: str) -> np.random.Generator:
    """Return the random numbers of one quantity, such as "placement.x_mm", of one sample.

    They depend on the plan's seed, the sample's index and the quantity's name alone.
    """
    key = (index, zlib.crc32(quantity.encode("utf-8")))
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def _draw(value: Any) -> Draw:
    if isinstance(value, Draw):
        return value
    if is_number(value):
        return fixed(float(value))
    expected = "a number or " + " or ".join(f"{{ {k} = {own} }}" for k, own in KINDS.items())
    if not isinstance(value, dict) or len(value) != 1:
        raise mistake(expected, toml_brief(value))
    ((kind, given),) = value.items()
    if kind not in KINDS:
        raise mistake(expected + nearest(kind, tuple(KINDS)), f"{{ {kind} = ... }}")
    if not isinstance(given, list) or not given or not all(map(is_number, given)):
        raise mistake(f"a list {KINDS[kind]} of numbers", given, key=kind)
    if kind != "choice" and len(given) != 2:
        raise mistake(f"two numbers {KINDS[kind]}", given, key=kind)
    if kind == "uniform" and given[1] < given[0]:
        raise mistake("[low, high] with low <= high", given, key=kind)
    if kind == "normal" and given[1] < 0:
        raise mistake("a standard deviation that is not negative", given, key=kind)
    return Draw(kind, tuple(map(float, given)))


@dataclass(frozen=True, slots=True)
class Within:
    """Annotation of a float, an int or a draw: from `low` (above it, if `above`) to `high`."""

    low: float
    high: float
    above: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        read = partial(self._read, source)
        return core_schema.no_info_before_validator_function(read, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:
        found = handler(schema)
        least = "exclusiveMinimum" if self.above else "minimum"
        found.get("anyOf", [found])[0].update({least: self.low, "maximum": self.high})
        return found

    def _read(self, kind: type, value: Any) -> Any:
        low, high = (f"{v:g}" if isinstance(v, float) else f"{v}" for v in (self.low, self.high))
        span = f"above {low} and at most {high}" if self.above else f"from {low} to {high}"
        if kind is Draw:
            return self._drawn(_draw(value), span)
        expected = f"a {'whole ' if kind is int else ''}number {span}"
        if kind is int and isinstance(value, float) and value.is_integer() and value < 1e15:
            raise mistake(expected, f"the decimal number {value!r}; write {int(value)}")
        if not (is_whole if kind is int else is_number)(value) or not self._holds(value, value):
            raise mistake(expected, toml_brief(value))
        return kind(value)

    def _drawn(self, draw: Draw, span: str) -> Draw:
        least, greatest = draw.bounds()
        if not self._holds(least, greatest):
            text = toml_brief(draw.to_plain())
            if draw.kind == "normal":
                limits = f"[{least:g}, {greatest:g}]"
                text += f", which is {limits} within {SIGMAS:g} standard deviations"
            raise mistake(f"values {span}", text)
        return draw

    def _holds(self, least: float, greatest: float) -> bool:
        return self.low <= least <= greatest <= self.high and not (self.above and least == self.low)


def in_si(table: BaseModel, *without: str) -> dict[str, Any]:
    """Return the numbers of a sample's table in SI units, by their names with those, for calls."""
    values = {name: getattr(table, name) for name in type(table).model_fields}
    found = {}
    for name, value in values.items():
        stem, _, unit = name.rpartition("_")
        if value is not None and name not in without:
            value = float(value) if isinstance(value, Draw) else value
            own, made = SI.get(unit, (unit, lambda value: value))
            found[f"{stem}_{own}".lstrip("_")] = made(value)
    return found


def tried(call: Callable[..., Any], *args: Any) -> Any:
    """Call a function whose errors are mistakes of the plan."""
    try:
        return call(*args)
    except (ClradarError, OSError) as error:
        lines = error.mistakes if isinstance(error, ClradarError) else ()
        text = "\n".join(lines or [clean(error)])
        raise PydanticCustomError("said", "{text}", {"text": text}) from error
