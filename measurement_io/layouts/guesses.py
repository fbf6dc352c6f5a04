"""Guess the quantities under the keys of a file, by their names, lengths and values."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clradar.constants import PLAUSIBLE_HZ
from measurement_io.layouts.container import Container, Key
from measurement_io.layouts.draft_lines import GUESS, UNKNOWN, Line, toml_name
from measurement_io.layouts.guessed_antennas import SIDES, names_side
from measurement_io.layouts.layout import FREQUENCY_UNITS_HZ

_MOST_FREQUENCIES = 1_000_000
_MOST_POSITION_NUMBERS = 300_000
_MOST_NUMBERS = 2**23
_MOST_KEYS = 5000
"""What is read to guess from, in all: 64 MiB."""

_FREQUENCY = re.compile(r"freq|hz", re.IGNORECASE)
_HINT = re.compile(r"freq|hz|(?<![a-z])f|pos|ant|coord|xyz|[tr]x|send|trans|rec", re.IGNORECASE)
_PARTS = ((r"re(al)?", "im(ag(inary)?)?"), ("i", "q"))


@dataclass(frozen=True, slots=True)
class Signal:
    """The probable data: names and shape of the keys."""

    names: tuple[str, ...]
    lines: tuple[Line, ...]
    shape: tuple[int, ...]
    part_axis: int | None


@dataclass(frozen=True, slots=True)
class Frequencies:
    """The probable frequencies, `count` of them; None and no lines if none were found."""

    count: int | None
    lines: tuple[Line, ...]
    center_hz: float | None


def guess_signal(keys: Sequence[Key]) -> Signal:
    largest = sorted(keys, key=lambda key: -math.prod(key.shape))
    for key in largest:
        if key.kind.startswith(("complex", "[")) and math.prod(key.shape) > 1:
            rivals = [k for k in keys if k.shape == key.shape and k.kind == key.kind]
            remark = f"{GUESS}of {len(rivals)} alike" if len(rivals) > 1 else ""
            return Signal(
                (key.name,), (Line(f"key = {toml_name(key.name)}", remark),), key.shape, None
            )
    for real in largest:
        for imag in keys:
            if real.shape == imag.shape and math.prod(real.shape) > 3 and _is_pair(real, imag):
                lines = (
                    Line(f"real = {toml_name(real.name)}"),
                    Line(f"imag = {toml_name(imag.name)}"),
                )
                return Signal((real.name, imag.name), lines, real.shape, None)
    for key in largest:
        twos = [axis for axis, n in enumerate(key.shape) if n == 2]
        if len(key.shape) >= 3 and twos:
            axis = twos[-1]
            remark = f"{GUESS}real, with an axis of length 2 for the real and imaginary part"
            return Signal(
                (key.name,), (Line(f"key = {toml_name(key.name)}", remark),), key.shape, axis
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


def small_values(container: Container, keys: Sequence[Key]) -> dict[str, np.ndarray]:
    """Return the finite real numbers of the keys that may be frequencies or positions.

    All are read at once, the most promising ones first: opening a file costs more than a list.
    """
    wanted, left = [], _MOST_NUMBERS
    for key in sorted(keys, key=lambda key: (_HINT.search(key.name) is None, math.prod(key.shape))):
        count = math.prod(key.shape)
        vector = count == max(key.shape, default=1) and count <= _MOST_FREQUENCIES
        table = len(key.shape) == 2 and {2, 3} & set(key.shape) and count <= _MOST_POSITION_NUMBERS
        if key.kind.startswith(("complex", "[")) or not (vector or table) or count > left:
            continue
        left -= count
        wanted.append(key.name)
    found = container.read_several(wanted[:_MOST_KEYS])
    numbers = {name: value.astype(np.float64) for name, value in found.items()}
    return {name: value for name, value in numbers.items() if np.isfinite(value).all()}


def guess_frequencies(keys: Sequence[Key], values: Mapping[str, np.ndarray]) -> Frequencies:
    keys = [
        key
        for key in keys
        if key.name in values
        and (_FREQUENCY.search(key.name) or not any(names_side(key.name, side) for side in SIDES))
    ]

    def rank(key: Key) -> bool:
        return not re.search(r"f|hz", key.name.rsplit("/", 1)[-1], re.IGNORECASE)

    for key in sorted(keys, key=rank):
        if math.prod(key.shape) < 2 or max(key.shape) != math.prod(key.shape):
            continue
        numbers = values[key.name].ravel()
        steps = np.diff(numbers)
        if not ((steps > 0).all() or (steps < 0).all()):
            continue
        unit, sure = _frequency_unit(key.name, numbers)
        if unit is None:
            continue
        remark = "" if sure and not rank(key) else f"{GUESS}{numbers[0]:g} to {numbers[-1]:g}"
        lines = (Line(f"key = {toml_name(key.name)}"), Line(f'unit = "{unit}"', remark))
        center_hz = float(numbers[0] + numbers[-1]) / 2 * FREQUENCY_UNITS_HZ[unit]
        return Frequencies(numbers.size, lines, center_hz)
    return Frequencies(None, (), None)


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
