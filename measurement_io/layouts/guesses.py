"""Guess the quantities under the keys of a file, by their names, lengths and values."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clradar.constants import PLAUSIBLE_HZ
from clradar.errors import MeasurementError
from clradar.files.failures import clean, reading
from clradar.files.toml_file import toml_string
from measurement_io.layouts.container import Container, Key
from measurement_io.layouts.containers import EXPECTED
from measurement_io.layouts.layout import FREQUENCY_UNITS_HZ, LENGTH_UNITS_PER_M

UNKNOWN = "?"
"""Stands in a draft where nothing could be guessed; no file has a key of that name."""

GUESS = "guess: "
SIDES = {"tx": r"tx|transmit|sender", "rx": r"rx|receiv"}

_MOST_FREQUENCIES = 1_000_000
_MOST_POSITION_NUMBERS = 300_000
_PLAUSIBLE_M = (0.01, 2.0)
_PARTS = ((r"re(al)?", "im(ag(inary)?)?"), ("i", "q"))


@dataclass(frozen=True, slots=True)
class Line:
    """One setting and the remark beside it."""

    text: str
    remark: str = ""

    def __str__(self) -> str:
        return f"{self.text}  # {self.remark}" if self.remark else self.text


@dataclass(frozen=True, slots=True)
class Signal:
    """The probable data: names and shape of the keys."""

    names: tuple[str, ...]
    lines: tuple[Line, ...]
    shape: tuple[int, ...]
    part_axis: int | None


@dataclass(frozen=True, slots=True)
class AntennaGuess:
    """The probable antennas of one side: `count` of them, None if unknown."""

    count: int | None
    lines: tuple[Line, ...]
    columns: tuple[str, ...] | None
    extent: float | None
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Frequencies:
    """The probable frequencies, `count` of them; None and no lines if none were found."""

    count: int | None
    lines: tuple[Line, ...]


def guess_signal(keys: Sequence[Key]) -> Signal:
    largest = sorted(keys, key=lambda key: -math.prod(key.shape))
    for key in largest:
        if key.kind.startswith(("complex", "[")) and math.prod(key.shape) > 1:
            rivals = [k for k in keys if k.shape == key.shape and k.kind == key.kind]
            remark = f"{GUESS}of {len(rivals)} alike" if len(rivals) > 1 else ""
            return Signal(
                (key.name,), (Line(f"key = {quoted(key.name)}", remark),), key.shape, None
            )
    for real in largest:
        for imag in keys:
            if real.shape == imag.shape and math.prod(real.shape) > 3 and _is_pair(real, imag):
                lines = (
                    Line(f"real = {quoted(real.name)}"),
                    Line(f"imag = {quoted(imag.name)}"),
                )
                return Signal((real.name, imag.name), lines, real.shape, None)
    for key in largest:
        twos = [axis for axis, n in enumerate(key.shape) if n == 2]
        if len(key.shape) >= 3 and twos:
            axis = twos[-1]
            remark = f"{GUESS}real, with an axis of length 2 for the real and imaginary part"
            return Signal(
                (key.name,), (Line(f"key = {quoted(key.name)}", remark),), key.shape, axis
            )
    remark = "nothing complex, no two keys for the real and the imaginary part"
    return Signal((), (Line(f'key = "{UNKNOWN}"', remark),), (), None)


def _is_pair(real: Key, imag: Key) -> bool:
    """Whether two names differ by nothing but re and im, or i and q."""
    for first, second in _PARTS:
        for match in re.finditer(rf"(?<![a-z]){first}(?![a-z])", real.name, re.IGNORECASE):
            before, after = real.name[: match.start()], real.name[match.end() :]
            if re.fullmatch(
                re.escape(before) + f"({second})" + re.escape(after), imag.name, re.IGNORECASE
            ):
                return True
    return False


def _numbers(container: Container, key: Key, most: int) -> np.ndarray | None:
    """Return the finite real numbers of a key that is not large; None for any other."""
    if math.prod(key.shape) > most or key.kind.startswith(("complex", "[")):
        return None
    try:
        with reading(container.path, EXPECTED):
            value = container.read(key.name, "a guess").astype(np.float64)
    except MeasurementError:
        return None
    return value if np.isfinite(value).all() else None


def guess_frequencies(container: Container, keys: Sequence[Key]) -> Frequencies:
    keys = [key for key in keys if not any(_names_side(key.name, side) for side in SIDES)]

    def rank(key: Key) -> bool:
        return not re.search(r"f|hz", key.name.rsplit("/", 1)[-1], re.IGNORECASE)

    for key in sorted(keys, key=rank):
        if math.prod(key.shape) < 2 or max(key.shape) != math.prod(key.shape):
            continue
        values = _numbers(container, key, _MOST_FREQUENCIES)
        if values is None:
            continue
        values = values.ravel()
        steps = np.diff(values)
        if not ((steps > 0).all() or (steps < 0).all()):
            continue
        unit, sure = _frequency_unit(key.name, values)
        if unit is None:
            continue
        remark = "" if sure and not rank(key) else f"{GUESS}{values[0]:g} to {values[-1]:g}"
        lines = (Line(f"key = {quoted(key.name)}"), Line(f'unit = "{unit}"', remark))
        return Frequencies(values.size, lines)
    return Frequencies(None, ())


def _frequency_unit(name: str, values: np.ndarray) -> tuple[str | None, bool]:
    """Return a unit in which the values are those of a radar, and whether it is certain."""
    fitting = [
        unit
        for unit, hz in FREQUENCY_UNITS_HZ.items()
        if values.min() * hz >= PLAUSIBLE_HZ[0] and values.max() * hz <= PLAUSIBLE_HZ[1]
    ]
    for unit in fitting:
        if name.lower().endswith(f"_{unit.lower()}"):
            return unit, True
    # 72e9 can only be Hz, but 72 000 is 72 MHz in kHz and 72 GHz in MHz: the highest is likely.
    return (fitting[-1], fitting == ["Hz"]) if fitting else (None, False)


def guess_antennas(container: Container, keys: Sequence[Key], side: str) -> AntennaGuess:
    named = [key for key in keys if _names_side(key.name, side)]
    for key in sorted(named, key=lambda key: -len(key.shape)):
        if len(key.shape) != 2 or not {2, 3} & set(key.shape):
            continue
        values = _numbers(container, key, _MOST_POSITION_NUMBERS)
        if values is None:
            continue
        across = 1 if key.shape[1] in (2, 3) else 0
        columns = ("x", "y", "z")[: key.shape[across]]
        lines = [Line(f"key = {quoted(key.name)}")]
        if across == 0:
            lines.append(Line('orientation = "columns"'))
        elif key.shape[0] in (2, 3):
            lines.append(Line('orientation = "rows"', f"{GUESS}or columns"))
        if len(columns) == 2:
            lines.append(Line("z = 0.0", f"{GUESS}in one plane"))
        extent = float(np.ptp(values, axis=1 - across).max())
        return AntennaGuess(key.shape[1 - across], tuple(lines), columns, extent, (key.name,))
    found: dict[str, tuple[Key, np.ndarray]] = {}
    for axis in "xyz":
        for key in named:
            values = _numbers(container, key, _MOST_POSITION_NUMBERS)
            last = re.sub(SIDES[side], "", key.name.rsplit("/", 1)[-1], flags=re.IGNORECASE)
            if values is not None and re.search(rf"(?<![a-z]){axis}(?![a-z])", last, re.I):
                found.setdefault(axis, (key, values))
    if {"x", "y"} <= set(found) and len({v.size for _, v in found.values()}) == 1:
        lines = [Line(f"{axis} = {quoted(key.name)}") for axis, (key, _) in found.items()]
        if "z" not in found:
            lines.append(Line("z = 0.0", f"{GUESS}in one plane"))
        extent = max(float(np.ptp(values)) for _, values in found.values())
        names = tuple(key.name for key, _ in found.values())
        return AntennaGuess(found["x"][1].size, tuple(lines), None, extent, names)
    return AntennaGuess(None, (), None, None, ())


def _names_side(name: str, side: str) -> bool:
    if re.search(rf"(?<![a-z])({SIDES[side]})", name, re.IGNORECASE):
        return True
    return re.search(rf"{side.capitalize()}|{side.upper()}", name) is not None  # positionsTx


def guess_length_unit(names: Sequence[str], extent: float) -> tuple[str | None, bool]:
    fitting = [
        unit
        for unit, per_m in LENGTH_UNITS_PER_M.items()
        if _PLAUSIBLE_M[0] <= extent / per_m <= _PLAUSIBLE_M[1]
    ]
    for unit in fitting:
        if names and all(name.lower().endswith(f"_{unit}") for name in names):
            return unit, True
    # Centimetres are rare: 14.1 could be them, 141 hardly.
    ordered = sorted(fitting, key=["m", "mm", "um", "cm"].index)
    return (ordered[0], False) if ordered else (None, False)


def quoted(name: str) -> str:
    """Return a name as a TOML string; a long one is cut."""
    return toml_string(clean(name) if len(name) > 1000 else name)
