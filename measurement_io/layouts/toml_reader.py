"""Read a layout from its TOML file."""

from __future__ import annotations

import os
import re
from pathlib import Path

from clradar.constants import MAX_FREQUENCIES
from clradar.files.failures import reading, shown
from clradar.files.limits import MAX_CHANNELS
from clradar.files.table import StrictTable
from clradar.files.toml_file import read_toml
from measurement_io.layouts.layout import (
    FREQUENCY_UNITS_HZ,
    KNOWN_ARRAYS,
    LENGTH_UNITS_PER_M,
    SIGNAL_AXES,
    AntennaLayout,
    DataLayout,
    FrameOfReference,
    FrequencyLayout,
    Layout,
    Select,
)

_EXPECTED = "a layout (a TOML file, see docs/layouts.md)"
_SLICE = re.compile(r"(-?[0-9]{0,9}):(-?[0-9]{0,9})(?::(-?[0-9]{1,9}))?\Z")
_COORDINATES = ("x", "y", "z")


def read_layout(path: str | os.PathLike[str]) -> Layout:
    """Return the layout of a TOML file; docs/layouts.md lists its settings.

    Raises
    ------
    MeasurementError
        Missing, no TOML, an unknown or missing key, an invalid value. The message names
        the file, the key, what was expected and what was found.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.measurement_io import read_layout
    >>> _ = Path("lab.toml").write_text('''
    ... data = {key = "s", axes = ["tx", "rx", "freq"]}
    ... tx.key = "tx_mm"
    ... rx.key = "rx_mm"
    ... antennas.unit = "mm"
    ... frequency = {key = "f", unit = "GHz"}
    ... ''')
    >>> read_layout("lab.toml").tx.key
    'tx_mm'
    """
    path = Path(path)
    parsed = read_toml(path, _EXPECTED)
    with reading(path, _EXPECTED):
        return _layout(shown(path), parsed, path.absolute())


def _layout(source: str, parsed: object, path: Path) -> Layout:
    top = StrictTable(source, "", parsed)
    data = _data(top.table("data", needed=True))
    tx = _antennas(top.table("tx", needed=True), path.parent)
    rx = _antennas(top.table("rx", needed=True), path.parent)
    # A layout by another name should not make another array.
    name = tx.array if tx.array is not None and tx.array == rx.array else path.stem
    frame = _frame_of_reference(top.table("antennas"), name, (tx, rx))
    frequency = _frequency(top.table("frequency", needed=True))
    meta_table = top.table("meta")
    meta = meta_table.texts("keys", "a list of keys of the file") or ()
    meta_table.done()
    top.done()
    return Layout(source, data, tx, rx, frame, frequency, meta)


def _data(table: StrictTable) -> DataLayout:
    key, real, imag = table.text("key"), table.text("real"), table.text("imag")
    if (key is None) == (real is None and imag is None) or (real is None) != (imag is None):
        table.fail("key", "'key', or 'real' and 'imag'", _given(key=key, real=real, imag=imag))
    axes = table.texts("axes", 'a list of axes, such as ["tx", "rx", "freq"]')
    if not axes:
        table.fail("axes", 'a list of axes, such as ["tx", "rx", "freq"]', "none")
    inner = table.table("pick")
    pick = inner.whole_entries()
    _check_axes(table, axes, dict(pick), key)
    parts = table.texts("parts", 'the order ["real", "imag"] or ["imag", "real"]')
    if parts is not None and ("part" not in axes or set(parts) != {"real", "imag"}):
        table.fail("parts", 'both "real" and "imag", for an axis "part"', list(parts))
    fields = table.texts("fields", "the names of two fields")
    if fields is not None and (len(fields) != 2 or "part" in axes or key is None):
        table.fail("fields", "the two fields of a compound 'key'", list(fields))
    order = table.one_of("pair_order", None, ("tx_major", "rx_major"))
    if (order is not None) != ("pair" in axes):
        table.fail(
            "pair_order",
            '"tx_major" or "rx_major", for an axis "pair" and for nothing else',
            "none" if order is None else order,
        )
    sign = table.number("phase_sign")
    if sign not in (None, -1, 1):
        table.fail("phase_sign", "-1 for exp(-j 2 pi f d / c) or +1 for exp(+j ...)", sign)
    scale = table.number("scale")
    if scale == 0:
        table.fail("scale", "a number other than 0", 0)
    table.done()
    return DataLayout(
        key,
        real,
        imag,
        axes,
        pick,
        ("imag", "real") if parts is not None and parts[0] == "imag" else ("real", "imag"),
        None if fields is None else (fields[0], fields[1]),
        order,
        1 if sign == 1 else -1,
        1.0 if scale is None else scale,
    )


def _check_axes(
    table: StrictTable, axes: tuple[str, ...], pick: dict[str, int], key: str | None
) -> None:
    for axis in axes:
        if axis not in SIGNAL_AXES and axis not in pick:
            known = ", ".join(f'"{name}"' for name in SIGNAL_AXES)
            table.fail("axes", f"{known}, or a name with an index in [data.pick]", axis)
        if axis != "one" and axes.count(axis) > 1:
            table.fail("axes", "every axis once", f'"{axis}" {axes.count(axis)} times')
    for name in pick:
        if name in SIGNAL_AXES or name not in axes:
            table.fail("pick", "axes that are in 'axes' and have no meaning of their own", name)
    if "pair" in axes and ("tx" in axes or "rx" in axes):
        table.fail("axes", '"pair", or "tx" and "rx"', list(axes))
    if "part" in axes and key is None:
        table.fail("axes", "an axis \"part\" only with one 'key'", list(axes))


def _antennas(table: StrictTable, folder: Path) -> AntennaLayout:
    channels = table.whole("channels", None, 1, MAX_CHANNELS)
    select = _select(table)
    key, file = table.text("key"), table.text("file", "the name of an antenna file")
    values = table.rows("values")
    array = table.one_of("array", None, KNOWN_ARRAYS)
    orientation = table.one_of("orientation", None, ("rows", "columns"))
    coordinates = tuple(
        (name, value) for name in _COORDINATES if (value := table.number_or_text(name)) is not None
    )
    apart = all(any(n == name for n, _ in coordinates) for name in ("x", "y")) and any(
        isinstance(value, str) for _, value in coordinates
    )
    given = _given(key=key, values=values, file=file, array=array)
    whole = sum(v is not None for v in (key, values, file, array))
    if whole + apart != 1 or ((array is not None or file is not None) and coordinates):
        table.fail(
            "key",
            "one of 'key', 'values', 'file', 'array', or keys 'x', 'y' and 'z', for the positions",
            given if whole else _given(**dict(coordinates)),
        )
    if whole and any(isinstance(value, str) for _, value in coordinates):
        table.fail("x, y, z", "numbers, for coordinates that have no column", "a key")
    if apart and len(coordinates) != 3:
        table.fail("z", "a key or a number (0.0 for antennas in one plane)", "none")
    if orientation is not None and key is None:
        table.fail("orientation", "a 'key' that it is about", "none")
    table.done()
    return AntennaLayout(
        channels,
        select,
        key,
        coordinates,
        values,
        None if file is None else str(folder / file),
        array,
        orientation or "rows",
    )


def _select(table: StrictTable) -> Select | None:
    if table.raw("select") is None:
        return None
    expected = 'a slice "start:stop" (stop excluded) or a list of channels from 0'
    if isinstance(table.raw("select"), str):
        text = table.text("select", expected) or ""
        match = _SLICE.match(text)
        if match is None or match[1] == "-" or match[2] == "-" or match[3] in ("0", "-0"):
            table.fail("select", expected, text)
        start, stop, step = (int(n) if n not in (None, "") else None for n in match.groups())
        if step == 0:
            table.fail("select", "a step other than 0", text)
        return Select(start, stop, step, None)
    channels = table.whole_numbers("select", 0)
    if channels is None or len(set(channels)) != len(channels) or len(channels) > MAX_CHANNELS:
        table.fail("select", "every channel once", "repeated channels")
    return Select(None, None, None, channels)


def _frame_of_reference(
    table: StrictTable, name: str, sides: tuple[AntennaLayout, AntennaLayout]
) -> FrameOfReference:
    unit = table.one_of("unit", None, tuple(LENGTH_UNITS_PER_M))
    if unit is None:
        if any(side.array is None for side in sides):
            table.fail("unit", "the unit of the positions: one of m, cm, mm, um", "none")
        unit = "m"
    origin = table.numbers("origin", 3) or (0.0, 0.0, 0.0)
    mirror = table.texts("mirror", 'coordinates, such as ["x"]') or ()
    columns = table.texts("columns", 'the coordinates of the columns, such as ["x", "y", "z"]')
    for key, value in (("mirror", mirror), ("columns", columns or ())):
        if not set(value) <= set(_COORDINATES):
            table.fail(key, '"x", "y" and "z" only', list(value))
    if columns is None:
        columns = _COORDINATES
    missing = [c for c in _COORDINATES if c not in columns]
    for side in sides:
        if side.key is None and side.values is None:
            continue
        constants = [c for c, _ in side.coordinates]
        if constants != missing:
            table.fail(
                "columns",
                "every coordinate either as a column or as a number in [tx] and [rx]",
                f"columns {', '.join(columns)} and numbers for {', '.join(constants) or 'none'}",
            )
    given = table.text("name", "a name")
    table.done()
    return FrameOfReference(
        unit, (origin[0], origin[1], origin[2]), mirror, columns, name if given is None else given
    )


def _frequency(table: StrictTable) -> FrequencyLayout:
    key, values = table.text("key"), table.numbers("values")
    start, stop, step = (table.number_or_text(name) for name in ("start", "stop", "step"))
    points: str | int | None
    if isinstance(table.raw("points"), str):
        points = table.text("points")
    else:
        points = table.whole("points", None, 1, MAX_FREQUENCIES)
    span = start is not None and points is not None and (stop is None) != (step is None)
    parts = [start, stop, step, points]
    ways = (key is not None) + (values is not None) + any(p is not None for p in parts)
    if ways != 1 or (key is None and values is None and not span):
        table.fail(
            "key",
            "'key', or 'values', or 'start', 'points' and either 'stop' or 'step'",
            _given(key=key, values=values, start=start, stop=stop, step=step, points=points),
        )
    unit = table.one_of("unit", None, tuple(FREQUENCY_UNITS_HZ))
    if unit is None:
        table.fail("unit", "the unit: one of Hz, kHz, MHz, GHz", "none")
    table.done()
    return FrequencyLayout(key, values, start, stop, step, points, unit)


def _given(**values: object) -> str:
    names = [f"'{name}'" for name, value in values.items() if value is not None]
    return " and ".join(names) or "none of them"
