"""Rules that place antennas: points, lines, crosses, planes and rings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clradar.files.table import StrictTable

MOST_ANTENNAS = 20_000
"""Of one rule: a whole wall of imaging clusters has some thousands."""


def positions_of(table: StrictTable) -> np.ndarray:
    """Return the positions of the one rule that a table has, shape (n, 3), metres.

    Raises
    ------
    MeasurementError
        No rule or several, an invalid value.
    """
    named = [name for name in RULES if table.has(name)]
    if len(named) != 1:
        found = " and ".join(named) if named else "none"
        table.fail("", f"one of {', '.join(RULES)}", found)
    if named == ["points_m"]:
        return _points(table)
    inner = table.table(named[0])
    placed = RULES[named[0]](inner)
    inner.done()
    return placed


def _points(table: StrictTable) -> np.ndarray:
    rows = table.rows("points_m") or ()
    if len(rows[0]) != 3:
        table.fail("points_m", "rows of three numbers", f"rows of {len(rows[0])}")
    return np.array(rows)


def _line(table: StrictTable) -> np.ndarray:
    """`n` antennas from first_m to last_m, both included."""
    first_m, last_m = (_vector(table, key) for key in ("first_m", "last_m"))
    return np.linspace(first_m, last_m, _count(table, "n"))


def _cross(table: StrictTable) -> np.ndarray:
    """A line of `n` along x and one along y, both of length_m about center_m; one middle."""
    n, half_m = _count(table, "n", 2), _length(table, "length_m") / 2
    steps = np.linspace(-half_m, half_m, n)
    zero = np.zeros(n)
    upright = np.stack([zero, steps, zero], axis=1)
    if n % 2:
        upright = np.delete(upright, n // 2, axis=0)
    placed = np.concatenate([np.stack([steps, zero, zero], axis=1), upright])
    return placed + _center(table)


def _plane(table: StrictTable) -> np.ndarray:
    """n = [n_x, n_y] antennas on size_m = [width, height] about center_m, row by row."""
    size_m = table.numbers("size_m", 2)
    n = table.whole_numbers("n", 1)
    if size_m is None or n is None or len(n) != 2:
        table.fail("", "size_m = [width, height] and n = [n_x, n_y]", "one missing, or not two")
    if n[0] * n[1] > MOST_ANTENNAS:
        table.fail("n", f"at most {MOST_ANTENNAS} antennas", f"{n[0] * n[1]}")
    x, y = (
        np.linspace(-size / 2, size / 2, count) if count > 1 else np.zeros(1)
        for size, count in zip(size_m, n, strict=True)
    )
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    flat = np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=1)
    return flat + _center(table)


def _ring(table: StrictTable) -> np.ndarray:
    """`n` antennas on a circle about center_m; the first at first_deg from x towards y."""
    n, radius_m = _count(table, "n"), _length(table, "radius_m")
    angle = np.deg2rad(table.number("first_deg") or 0.0) + 2 * np.pi * np.arange(n) / n
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    return radius_m * circle + _center(table)


def _vector(table: StrictTable, key: str) -> np.ndarray:
    value = table.numbers(key, 3)
    if value is None:
        table.fail(key, "[x, y, z] in metres", "none")
    return np.array(value)


def _center(table: StrictTable) -> np.ndarray:
    return _vector(table, "center_m") if table.has("center_m") else np.zeros(3)


def _length(table: StrictTable, key: str) -> float:
    value = table.number(key)
    if value is None or value <= 0:
        table.fail(key, "a length above 0, in metres", "none" if value is None else f"{value:g}")
    return value


def _count(table: StrictTable, key: str, least: int = 1) -> int:
    count = table.whole(key, None, least, MOST_ANTENNAS)
    if count is None:
        table.fail(key, "a number of antennas", "none")
    return count


RULES: dict[str, Callable[[StrictTable], np.ndarray]] = {
    "points_m": _points,
    "line": _line,
    "cross": _cross,
    "plane": _plane,
    "ring": _ring,
}
"""Key of a table -> its rule."""
