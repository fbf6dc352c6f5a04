"""Numbers, ranges and choices in the text of an option."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clradar.cli.options.groups import wrong_usage
from clradar.errors import ModelError
from clradar.model.plausible import implausible

WHOLE_STEPS = 1e-6
"""How far a range may be from a whole number of steps: allows for rounded decimals."""

MOST_STEPS = 2**31
"""Of a range; beyond it neighbours are the same number."""

DECIMALS = 9
"""Of a number in a range: 3 * 0.1 is then 0.3, as where it is typed."""

FIT = "fit"
"""In place of a value that is to be found."""

RANGE_RULE = "FIRST:LAST:STEP, both ends included"

ALL, RANGE = "all", "FIRST:LAST[:STEP]"
FRAMES_METAVAR = f"all|{RANGE}|N,..."


def check_unit(
    option: str, what: str, value: float, bounds: tuple[float, float], unit: str
) -> None:
    """Raise where a value of an option is in another unit; see `clradar.model.plausible`."""
    fault = implausible(what, value, bounds, unit)
    if fault is not None:
        raise wrong_usage(option, "expected {}, got {}".format(*fault))


def numbers(text: str, separator: str = ",") -> list[float]:
    """The finite numbers between separators; none if one of them is something else."""
    try:
        values = [float(part) for part in text.split(separator)]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []


def numbers_of(option: str, text: str, count: int) -> list[float]:
    """So many numbers with commas between them."""
    found = numbers(text)
    if len(found) != count:
        raise wrong_usage(option, f"expected {count} numbers with commas between, got '{text}'")
    return found


def position_m(option: str, text: str) -> list[float]:
    """The metres of a position ``X,Y,Z`` in millimetres."""
    found = numbers(text)
    if len(found) != 3:
        raise wrong_usage(option, f"expected X,Y,Z in millimetres, got '{text}'")
    return [value / 1e3 for value in found]


def alpha_of(option: str, text: str, other: str) -> float:
    """The alpha in the text of an option, which could also be something else."""
    values = numbers(text)
    if len(values) != 1 or not 0.0 <= values[0] <= 1.0:
        raise wrong_usage(option, f"expected a number in [0, 1] or {other}, got '{text}'")
    return values[0]


def alpha_or_fit(text: str) -> float | None:
    """The alpha of an option, or None for `fit`."""
    return None if text == FIT else alpha_of("--alpha", text, f"'{FIT}'")


def whole_steps(option: str, text: str, first: float, last: float, step: float) -> int:
    """The number of steps of a range; raises if they do not end at `last`."""
    steps = (last - first) / step
    if not steps <= MOST_STEPS:
        raise wrong_usage(option, f"expected at most {MOST_STEPS} steps, got '{text}'")
    if abs(steps - round(steps)) > WHOLE_STEPS * max(1.0, steps):
        fits = f"{first:g}:{first + math.floor(steps) * step:g}:{step:g}"
        raise wrong_usage(option, f"expected a whole number of steps, such as {fits}, got '{text}'")
    return round(steps)


def ascending(
    option: str,
    text: str,
    noun: str,
    limits: tuple[float, float],
    *,
    least: int = 1,
    most: int = 1001,
) -> np.ndarray:
    """The numbers of ``FIRST:LAST:STEP`` or of a list with commas, shape (n,), float64.

    `noun` says what they are, in the plural; they have to be within `limits`.
    """
    is_range = ":" in text
    values = numbers(text, ":" if is_range else ",")
    expected = ""
    if not values or (is_range and len(values) != 3):
        expected = f"{RANGE_RULE}, or a list with commas"
    elif not all(limits[0] <= value <= limits[1] for value in values):
        expected = f"numbers in [{limits[0]:g}, {limits[1]:g}]"
    elif is_range:
        first, last, step = values
        if step <= 0 or last <= first:
            expected = "FIRST below LAST and STEP above 0"
        elif (last - first) / step > most - 1:
            expected = f"at most {most} {noun}"
        else:
            steps = whole_steps(option, text, first, last, step)
            values = [round(first + i * step, DECIMALS) for i in range(steps + 1)]
    if not expected and len(values) < least:
        expected = f"at least {'two' if least == 2 else least} {noun}"
    if not expected and not (np.diff(values) > 0).all():
        expected = f"{noun} in ascending order, each once"
    if expected:
        raise wrong_usage(option, f"expected {expected}, got '{text}'")
    return np.array(values)


def chosen_frames(text: str, there: Sequence[int], option: str = "--frames") -> list[int]:
    """The frames, or what else has numbers, that an option chooses of those that are there."""
    if text.strip() == ALL:
        return list(there)
    try:
        if ":" in text:
            first, last, step = map(int, f"{text}:1".split(":")[:3])
            if step < 1 or text.count(":") > 2:
                raise ValueError
            chosen = [n for n in there if first <= n <= last and (n - first) % step == 0]
        else:
            chosen = sorted({int(part) for part in text.split(",")})
    except ValueError:
        raise wrong_usage(
            option, f"expected all, {RANGE} or numbers with commas, got '{text}'"
        ) from None
    if not chosen or not set(chosen) <= set(there):
        raise ModelError(
            f"{option}: expected some of the {option[2:]} {there[0]} to {there[-1]}, got '{text}'"
        )
    return chosen
