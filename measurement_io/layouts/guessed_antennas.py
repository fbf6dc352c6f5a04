"""Guess the antenna positions among the keys of a file, and their unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from measurement_io.layouts.container import Key
from measurement_io.layouts.draft_lines import GUESS, Line, toml_name
from measurement_io.layouts.layout import LENGTH_UNITS_PER_M

SIDES = {
    "tx": r"tx|trans(?![filnp])|xmit|send|emit|emet|emis|source|src",
    "rx": r"rx|rec[ev]|rec(?![a-z])|rcv|empf",
}
"""Beginnings of words for the transmitters and the receivers."""

_POSITION = re.compile(r"pos|ant|loc|coord|xyz|place|element|array|geom", re.IGNORECASE)
_NO_POSITION = re.compile(
    r"orient|normal|dir|pattern|gain|angle|rot|vel|boresight|pol|offset|origin", re.IGNORECASE
)
_AXIS = re.compile(
    r"(?<![A-Za-z])([xyzXYZ])(?![a-z])|(?<=[a-z])([XYZ])(?![a-z])|(?<![A-Za-z])([xyz])(?=pos|coord)"
)
_AXIS_AND_LETTER = re.compile(r"([xyz])_?([tr])|([tr])_?([xyz])", re.IGNORECASE)
_FEWEST_BY_SHAPE = 4
"""Antennas of a table that is recognised by nothing but its shape: matrices are smaller."""

_PLAUSIBLE_M = (0.01, 2.0)
"""Extent of a near-field array."""

_CLOSEST_WAVELENGTHS, _FARTHEST_WAVELENGTHS = 0.2, 100.0
"""From one antenna to the next: antennas are about half a wavelength wide."""

_USUAL_WAVELENGTHS = 0.7


@dataclass(frozen=True, slots=True)
class AntennaGuess:
    """The probable antennas of one side.

    Attributes
    ----------
    count : int or None
        How many there are, None if unknown.
    lines : tuple of Line
        The settings; none if no positions were found.
    columns : tuple of str or None
        What the columns of one key hold.
    positions : ndarray, shape (count, 2 or 3), or None
        In the unit of the file.
    names : tuple of str
        The keys; of several that could hold the positions, if there are no lines.
    """

    count: int | None
    lines: tuple[Line, ...]
    columns: tuple[str, ...] | None
    positions: np.ndarray | None
    names: tuple[str, ...]


NOTHING = AntennaGuess(None, (), None, None, ())


def guess_sides(
    keys: Sequence[Key], values: Mapping[str, np.ndarray], shape: tuple[int, ...]
) -> dict[str, AntennaGuess]:
    """Return the probable antennas by side.

    Parameters
    ----------
    keys : sequence of Key
        Those that are not the data.
    values : mapping of str to ndarray
        The numbers of those that are small.
    shape : tuple of int
        Of the data: a table of as many rows as an axis is long may be the positions.
    """
    tables = [*_tables(keys, values), *_column_tables(keys, values)]
    tables = [t for t in tables if t.names and _may_be_positions(t)]
    found = {side: _best([t for t in tables if _table_names(t, side)], shape) for side in SIDES}
    if not any(found.values()):
        found = _letter_pair(tables)
    used = [t for t in found.values() if t is not None]
    rest = [t for t in tables if not any(t is u for u in used)]
    sides = {side: table or NOTHING for side, table in found.items()}
    missing = [side for side, table in found.items() if table is None]
    return sides | _by_shape(missing, rest, shape)


def names_side(name: str, side: str) -> bool:
    """Whether a word of a name begins as a word for one side does."""
    for match in re.finditer(SIDES[side], name, re.IGNORECASE):
        before = name[: match.start()][-1:]
        if not before.isalpha() or (before.islower() and match[0][0].isupper()):
            return True
    return re.search(rf"{side.capitalize()}|{side.upper()}", name) is not None  # ARRAYTX


def _tables(keys: Sequence[Key], values: Mapping[str, np.ndarray]) -> list[AntennaGuess]:
    """Return the keys that hold all coordinates."""
    found = []
    for key in keys:
        if key.name not in values or len(key.shape) != 2 or not {2, 3} & set(key.shape):
            continue
        across = 1 if key.shape[1] in (2, 3) else 0
        columns = ("x", "y", "z")[: key.shape[across]]
        lines = [Line(f"key = {toml_name(key.name)}")]
        if across == 0:
            lines.append(Line('orientation = "columns"'))
        elif key.shape[0] in (2, 3):
            lines.append(Line('orientation = "rows"', f"{GUESS}or columns"))
        if len(columns) == 2:
            lines.append(Line("z = 0.0", f"{GUESS}in one plane"))
        rows = values[key.name] if across == 1 else values[key.name].T
        found.append(AntennaGuess(len(rows), tuple(lines), columns, rows, (key.name,)))
    return found


def _column_tables(keys: Sequence[Key], values: Mapping[str, np.ndarray]) -> list[AntennaGuess]:
    """Return the groups of keys that hold one coordinate each: their names differ by x, y and z."""
    groups: dict[tuple[str, int], dict[str, str]] = {}
    for key in keys:
        if key.name not in values or max(key.shape, default=1) != values[key.name].size:
            continue
        axis, stem = _axis_of(key.name)
        if axis:
            group = groups.setdefault((stem, values[key.name].size), {})
            group.setdefault(axis, key.name)
    found = []
    for (_, count), group in groups.items():
        if not {"x", "y"} <= set(group):
            continue
        axes = [axis for axis in "xyz" if axis in group]
        lines = [Line(f"{axis} = {toml_name(group[axis])}") for axis in axes]
        if "z" not in group:
            lines.append(Line("z = 0.0", f"{GUESS}in one plane"))
        rows = np.stack([values[group[axis]].ravel() for axis in axes], axis=1)
        found.append(
            AntennaGuess(count, tuple(lines), None, rows, tuple(group[axis] for axis in axes))
        )
    return found


def _axis_of(name: str) -> tuple[str, str]:
    """Return the coordinate in a name, and the name without it; "" if there is none."""
    *above, last = name.split("/")
    pair = _AXIS_AND_LETTER.fullmatch(last)
    if pair:
        axis = pair[1] or pair[4]
        return axis.lower(), "/".join([*above, pair[2] or pair[3]])
    # What names the side holds an x: txX.
    side = next((s for s in SIDES if names_side(last, s)), None)
    without = last if side is None else re.sub(SIDES[side], " ", last, count=1, flags=re.IGNORECASE)
    match = _AXIS.search(without)
    if match is None:
        return "", name
    stem = without[: match.start()] + "*" + without[match.end() :]
    return match[0].lower(), "/".join([*above, side or "", stem])


def _may_be_positions(table: AntennaGuess) -> bool:
    rows = table.positions
    assert rows is not None
    if len(rows) == 1:
        return True
    unit_vectors = rows.shape[1] == 3 and np.allclose(np.linalg.norm(rows, axis=1), 1.0, atol=1e-3)
    return bool(np.ptp(rows, axis=0).max() > 0) and not unit_vectors


def _table_names(table: AntennaGuess, side: str) -> bool:
    return any(names_side(name, side) for name in table.names)


def _best(tables: Sequence[AntennaGuess], shape: tuple[int, ...]) -> AntennaGuess | None:
    """Return the table that is most probably the positions of a side that its name says."""

    def rank(table: AntennaGuess) -> tuple[bool, bool, bool]:
        name = table.names[0].rsplit("/", 1)[-1]
        return (
            _NO_POSITION.search(name) is not None,
            table.count not in shape,
            _POSITION.search(table.names[0]) is None,
        )

    return min(tables, key=rank, default=None)


def _letter_pair(tables: Sequence[AntennaGuess]) -> dict[str, AntennaGuess | None]:
    """Return two tables whose names differ by t and r alone: pos_t and pos_r, xt and xr."""
    for first in tables:
        for second in tables:
            pairs = zip(first.names, second.names, strict=False)
            if len(first.names) == len(second.names) and all(_t_and_r(a, b) for a, b in pairs):
                return {"tx": first, "rx": second}
    return dict.fromkeys(SIDES)


def _t_and_r(first: str, second: str) -> bool:
    if len(first) != len(second):
        return False
    differ = [(a.lower(), b.lower()) for a, b in zip(first, second, strict=True) if a != b]
    return differ == [("t", "r")]


def _by_shape(
    missing: Sequence[str], rest: Sequence[AntennaGuess], shape: tuple[int, ...]
) -> dict[str, AntennaGuess]:
    """Return the sides that no name gave, from tables as long as an axis of the data."""
    fitting = [
        table
        for table in rest
        if table.count in shape
        and _NO_POSITION.search(table.names[0]) is None
        and not any(_table_names(table, side) for side in SIDES)
        and (table.count >= _FEWEST_BY_SHAPE or _POSITION.search(table.names[0]))
    ]
    named = [table for table in fitting if _POSITION.search(table.names[0])]
    fitting = named if 0 < len(named) <= len(missing) else fitting
    if not missing or not fitting:
        return {}
    if len(fitting) == 1 and len(missing) == 2 and shape.count(fitting[0].count or 0) >= 2:
        return {side: _remarked(fitting[0], "one table, taken for both sides") for side in missing}
    if len(fitting) != len(missing):
        names = tuple(name for table in fitting for name in table.names)
        return {side: replace(NOTHING, names=names) for side in missing}
    if len(missing) == 1:
        return {missing[0]: _remarked(fitting[0], "by its length; its name does not say the side")}
    # The axis of the transmitters comes first, more often than not.
    fitting = sorted(fitting, key=lambda table: shape.index(table.count or 0))
    return {
        side: _remarked(table, "by its length; which one transmits, no name says")
        for side, table in zip(missing, fitting, strict=True)
    }


def _remarked(table: AntennaGuess, remark: str) -> AntennaGuess:
    first, *more = table.lines
    return replace(table, lines=(replace(first, remark=f"{GUESS}{remark}"), *more))


def guess_length_unit(sides: Sequence[AntennaGuess], center_hz: float | None) -> Line:
    """Return the unit in which the array has a plausible size and antennas a plausible distance.

    Parameters
    ----------
    sides : sequence of AntennaGuess
    center_hz : float or None
        Of the frequencies, if they were found.
    """
    tables = [side.positions for side in sides if side.positions is not None]
    names = [name for side in sides for name in side.names if side.positions is not None]
    extent = max((float(np.ptp(rows, axis=0).max()) for rows in tables), default=0.0)
    fitting = [
        unit
        for unit, per_m in LENGTH_UNITS_PER_M.items()
        if _PLAUSIBLE_M[0] <= extent / per_m <= _PLAUSIBLE_M[1]
    ]
    if not fitting:
        return Line('unit = "?"', "of the positions: m, cm, mm, um")
    apart = min((d for rows in tables if (d := _next_distance(rows)) > 0), default=0.0)
    wavelengths = {}
    if center_hz is not None and apart > 0:
        per_wavelength = center_hz / SPEED_OF_LIGHT_M_PER_S
        wavelengths = {u: apart / LENGTH_UNITS_PER_M[u] * per_wavelength for u in fitting}
    near = {u: _CLOSEST_WAVELENGTHS <= w <= _FARTHEST_WAVELENGTHS for u, w in wavelengths.items()}
    named = [unit for unit in fitting if names and all(_ends_in(name, unit) for name in names)]
    if named and near.get(named[0], True):
        return Line(f'unit = "{named[0]}"')
    if wavelengths:

        def unusual(unit: str) -> tuple[bool, bool, float]:
            away = abs(float(np.log(wavelengths[unit] / _USUAL_WAVELENGTHS)))
            return not near[unit], unit not in named, away

        ordered = sorted(fitting, key=unusual)
        others = "".join(f", {wavelengths[u]:.2g} in {u}" for u in ordered[1:])
        why = f"{apart:g} apart: {wavelengths[ordered[0]]:.2g} wavelengths in {ordered[0]}{others}"
    else:
        # Centimetres are rare: 14.1 could be them, 141 hardly.
        ordered = sorted(fitting, key=["m", "mm", "um", "cm"].index)
        others = " or ".join(ordered[1:])
        why = f"or {others}" if others else "the only unit of such an array"
    return Line(f'unit = "{ordered[0]}"', f"{GUESS}the antennas span {extent:g}, {why}")


def _ends_in(name: str, unit: str) -> bool:
    """Whether a name says a unit: tx_mm, tx_x_mm, tx [mm]."""
    return re.search(rf"(?:^|[^a-z]){unit}[\])]?$", name.lower()) is not None


def _next_distance(rows: np.ndarray) -> float:
    """Return the median distance from an antenna to the next one, 0 for a single antenna."""
    from scipy.spatial import cKDTree

    distinct = np.unique(rows, axis=0)
    if len(distinct) < 2:
        return 0.0
    return float(np.median(cKDTree(distinct).query(distinct, k=2)[0][:, 1]))
