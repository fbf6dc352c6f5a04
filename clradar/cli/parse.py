"""What the texts of options mean: each function takes the option's name and its text."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from operator import le
from pathlib import Path
from typing import Any

from clradar.cli.groups import Read, wrong_usage
from clradar.constants import FINEST_SPACING_M, PLAUSIBLE_HZ, PLAUSIBLE_RANGE_M
from clradar.errors import ModelError, OutputError
from clradar.model.plausible import implausible
from clradar.plot.saving import SUFFIXES

# Of ranges.
WHOLE_STEPS = 1e-6  # as far may one be from a whole number of steps: allows for rounded decimals
MOST_STEPS = 2**31  # beyond it neighbours are the same number
DECIMALS = 9  # 3 * 0.1 is then 0.3, as where it is typed

FIT = "fit"  # in place of a value that is to be found

RANGE_RULE = "FIRST:LAST:STEP, both ends included"
GRID_RULE = f"{RANGE_RULE}, or one number for a single slice"

ALL, RANGE = "all", "FIRST:LAST[:STEP]"
FRAMES_METAVAR = f"all|{RANGE}|N,..."

Band = tuple[float, float, int]
Axis = tuple[float, float, float]


def check_unit(
    option: str, value: float, what: str, bounds: tuple[float, float], unit: str
) -> float:
    """A value of an option, which is not in another unit; see `clradar.model.plausible`."""
    if (fault := implausible(what, value, bounds, unit)) is not None:
        raise wrong_usage(option, "expected {}, got {}".format(*fault))
    return value


def ends_in(*suffixes: str) -> Callable[[str, Path], Path]:
    """A check that the name of a file ends as its kind does."""

    def check(option: str, path: Path) -> Path:
        if path.suffix.lower() not in suffixes:
            raise OutputError(
                f"{path}: expected a name that ends in {', '.join(suffixes)}, got '{path.suffix}'"
            )
        return path

    return check


page = ends_in(".html", ".htm")
figure = ends_in(*SUFFIXES)


def numbers(text: str, separator: str = ",") -> list[float]:
    """The finite numbers between separators; none if one of them is something else."""
    try:
        values = [float(part) for part in text.split(separator)]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []


def so_many(
    count: int | None,
    expected: str,
    separator: str = ",",
    holds: Callable[..., bool] = lambda *_: True,
    plausible: tuple[Any, ...] = (),
) -> Callable[[str, str], tuple[float, ...]]:
    """Reads so many numbers between separators; `plausible` is the end of `check_unit`."""

    def read(option: str, text: str) -> tuple[float, ...]:
        found = numbers(text, separator)
        if len(found) != (count or len(found) or 1) or not holds(*found):
            raise wrong_usage(option, f"expected {expected}, got '{text}'")
        for value in map(abs, found if plausible else ()):
            check_unit(option, value, *plausible)
        return tuple(found)

    return read


FREQUENCY = ("a frequency", PLAUSIBLE_HZ, "GHz")  # as `check_unit` has it

some = so_many(None, "numbers")
pair = so_many(2, "2 numbers with commas between")
position_mm = so_many(3, "X,Y,Z in millimetres")
window_mm = so_many(
    2, "NEAR:FAR, half path lengths in millimetres, 0 <= NEAR < FAR", ":",
    lambda near, far: 0 <= near < far,
)  # fmt: skip
ends_ghz = so_many(2, "FIRST:LAST with FIRST <= LAST", ":", le, FREQUENCY)


def band(option: str, text: str) -> Band:
    """First and last frequency in gigahertz, and their number."""
    read = so_many(3, "FIRST:LAST:STEPS", ":", lambda _, __, steps: steps >= 1 and not steps % 1)
    first, last, steps = read(option, text)
    for value in (first, last):
        check_unit(option, value, *FREQUENCY)
    if first >= last if steps > 1 else first != last:
        expected = "FIRST below LAST, or both equal for one step"
        raise wrong_usage(option, f"expected {expected}, got '{text}'")
    return first, last, int(steps)


def axis_mm(option: str, text: str) -> Axis:
    """First, last and step of ``FIRST:LAST:STEP`` in millimetres; one number is one voxel."""
    values = numbers(text, ":")
    if len(values) not in (1, 3):
        raise wrong_usage(option, f"expected {GRID_RULE}, in millimetres; got '{text}'")
    farthest = max(map(abs, values[:2]))
    check_unit(option, farthest, "coordinates", (0.0, PLAUSIBLE_RANGE_M[1]), "mm")
    if len(values) == 1:
        return values[0], values[0], 1.0
    first, last, step = values
    if whole_steps(option, text, *values):
        check_unit(option, step, "a step", (FINEST_SPACING_M, PLAUSIBLE_RANGE_M[1]), "mm")
    return first, last, step


def plane(option: str, text: str) -> tuple[str, float | None]:
    """Axis and place, m, of ``AXIS[=MM]``; None: through the strongest voxel."""
    axis, equals, place = text.partition("=")
    values = numbers(place, ":") if equals else []
    if axis not in ("x", "y", "z") or len(values) != bool(equals):
        raise wrong_usage(option, f"expected x, y or z, or one with =MM; got '{text}'")
    return axis, values[0] / 1e3 if equals else None


def alpha_of(option: str, text: str, other: str = "PART=number") -> float:
    """The alpha in the text of an option, which could also be something else."""
    values = numbers(text)
    if len(values) != 1 or not 0.0 <= values[0] <= 1.0:
        raise wrong_usage(option, f"expected a number in [0, 1] or {other}, got '{text}'")
    return values[0]


def alpha_or_fit(option: str, text: str) -> float | str:
    """The alpha of an option, or `FIT`."""
    return FIT if text == FIT else alpha_of(option, text, f"'{FIT}'")


def by_part(option: str, texts: Sequence[str], read: Callable[[str, str], Any]) -> dict[Any, Any]:
    """The values of texts ``PART=VALUE``, of None that without a part."""
    values: dict[Any, Any] = {}
    for text in texts:
        name, equals, value = text.rpartition("=")
        part = name if equals else None
        if part in values:
            raise wrong_usage(option, f"part '{part}' is given twice" if equals else "given twice")
        values[part] = read(option, value)
    return values


def whole_steps(option: str, text: str, first: float, last: float, step: float) -> int:
    """The number of steps of a range; raises if they do not end at `last`."""
    if step <= 0 or last < first:
        raise wrong_usage(option, f"expected FIRST <= LAST and STEP > 0, got '{text}'")
    steps = (last - first) / step
    if not steps <= MOST_STEPS:
        raise wrong_usage(option, f"expected at most {MOST_STEPS} steps, got '{text}'")
    if abs(steps - round(steps)) > WHOLE_STEPS * max(1.0, steps):
        fits = f"{first:g}:{first + math.floor(steps) * step:g}:{step:g}"
        raise wrong_usage(option, f"expected a whole number of steps, such as {fits}, got '{text}'")
    return round(steps)


def ascending(noun: str, limits: tuple[float, float], *, least: int = 1, most: int = 1001) -> Read:
    """Reads numbers of ``FIRST:LAST:STEP`` or of a list with commas; `noun` is in the plural."""

    def read(option: str, text: str) -> tuple[float, ...]:
        is_range = ":" in text
        values = numbers(text, ":" if is_range else ",")
        expected = ""
        if not values or (is_range and len(values) != 3):
            expected = f"{RANGE_RULE}, or a list with commas"
        elif not all(limits[0] <= value <= limits[1] for value in values):
            expected = f"numbers in [{limits[0]:g}, {limits[1]:g}]"
        elif is_range:
            first, _, step = values
            steps = whole_steps(option, text, *values)
            values = [round(first + i * step, DECIMALS) for i in range(min(steps, most) + 1)]
            if steps >= most:
                expected = f"at most {most} {noun}"
        if not expected and len(values) < least:
            expected = f"at least {'two' if least == 2 else least} {noun}"
        if not expected and any(b <= a for a, b in pairwise(values)):
            expected = f"{noun} in ascending order, each once"
        if expected:
            raise wrong_usage(option, f"expected {expected}, got '{text}'")
        return tuple(values)

    return read


def chosen_frames(text: str, there: Sequence[int]) -> list[int]:
    """The frames that --frames chooses of those that are there."""
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
            "--frames", f"expected all, {RANGE} or numbers with commas, got '{text}'"
        ) from None
    if not chosen or not set(chosen) <= set(there):
        raise ModelError(
            f"--frames: expected some of the frames {there[0]} to {there[-1]}, got '{text}'"
        )
    return chosen
