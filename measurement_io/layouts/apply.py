"""Apply a layout to a file: a `Capture`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from clradar import arrays
from clradar.constants import MAX_FREQUENCIES, PLAUSIBLE_APERTURE_M, PLAUSIBLE_HZ
from clradar.files.failures import clean, fail, reading, shown
from clradar.files.limits import MAX_ARRAY_BYTES, MAX_CHANNELS
from clradar.model import AntennaArray, Capture, Waveform, checks
from measurement_io.antenna_file import read_position_file
from measurement_io.layouts.contents import EXPECTED
from measurement_io.layouts.lab_file import Key, LabFile
from measurement_io.layouts.layout import (
    COORDINATES,
    FREQUENCY_UNITS_HZ,
    LENGTH_UNITS_PER_M,
    AntennaLayout,
    DataLayout,
    FrequencyLayout,
    Layout,
    read_layout,
)

_FIELD_NAMES = (("r", "i"), ("real", "imag"), ("re", "im"))
_PURPOSE = "the data"
_COMPLEX64_BYTES = 8


def open_with_layout(
    path: str | os.PathLike[str],
    layout: str | os.PathLike[str] | Layout,
    *,
    frame: int | None = None,
) -> Capture:
    """Return the capture in another program's file.

    Parameters
    ----------
    path : path-like
        An HDF5, MATLAB (v5 or v7.3), `.npz` or plain `.npy` file; its content decides which.
    layout : path-like or Layout
        A TOML file with the keys, axes and units of the file (docs/layouts.md).
    frame : int, optional
        Index on the axis "frame", if the layout has one; 0 if not given.

    Returns
    -------
    Capture
        data[tx, rx, freq], complex64, in the antenna frame and with the sign of the phase that this
        program uses. `meta` has `source`, `format` ("layout"), `container`, `frame`, `frames`,
        `frequencies_reversed`, `layout` (its settings), and under `file` the keys that the layout
        asks for.

    Raises
    ------
    MeasurementError
        Anything wrong with the file or the layout, or both do not fit each other. Nothing in the
        file is ever unpickled or run.
    ModelError
        A frame that is no whole number.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from measurement_io import open_with_layout
    >>> _ = Path("lab.toml").write_text('''
    ... data = {key = "s", axes = ["tx", "rx", "freq"]}
    ... tx.key = "tx_mm"
    ... rx.key = "rx_mm"
    ... antennas.unit = "mm"
    ... frequency = {key = "f", unit = "GHz"}
    ... ''')
    >>> lab = {"tx_mm": np.eye(3), "rx_mm": np.eye(3)[:2], "f": np.linspace(72, 82, 5)}
    >>> np.savez("lab.npz", s=np.ones((3, 2, 5), np.complex64), **lab)
    >>> capture = open_with_layout("lab.npz", "lab.toml")
    >>> capture.data.shape, capture.array.tx_m[0].tolist(), capture.waveform.n_freq
    ((3, 2, 5), [0.001, 0.0, 0.0], 5)
    """
    if frame is not None:
        frame = checks.whole("open_with_layout: frame", frame, 0)
    source = Path(path)
    if not isinstance(layout, Layout):
        layout = read_layout(layout)
    with reading(source, EXPECTED):
        file = LabFile.opened(source, list(_wanted(layout, frame or 0)))
        return _capture(file, layout, frame)


def _wanted(layout: Layout, frame: int) -> Iterator[tuple[str, Mapping[int, int]]]:
    """Yield the keys that a layout names, and which index of which axis is used of the data."""
    picked = {**layout.data.pick, "frame": frame}
    pick = {a: picked[name] for a, name in enumerate(layout.data.axes) if name in picked}
    for name in (layout.data.key, layout.data.real, layout.data.imag):
        if name is not None:
            yield name, pick
    for side in (layout.tx, layout.rx):
        for value in (side.key, *side.coordinates.values()):
            if isinstance(value, str):
                yield value, {}
    given = layout.frequency
    for value in (given.key, given.start, given.stop, given.step, given.points):
        if isinstance(value, str):
            yield value, {}
    for name in layout.meta.keys:
        yield name, {}


@dataclass(frozen=True, slots=True)
class _Data:
    """Keys of the data: one, or those of the real and the imaginary part; and length by axis."""

    keys: tuple[Key, ...]
    lengths: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class _Side:
    """One side of the array: how many channels the file has, which are used, and where they are."""

    channels: int
    chosen: list[int]
    position_m: np.ndarray


def _capture(file: LabFile, layout: Layout, frame: int | None) -> Capture:
    path = file.path
    data = _data_of(file, layout.data)
    frames = data.lengths.get("frame")
    number = _frame_number(path, frame, frames)
    frequency_hz, descending = _frequencies(file, layout.frequency)
    tx, rx = _sides(file, layout, data)
    points = data.lengths.get("freq", 1)
    if points != len(frequency_hz):
        got = f"{points} in the data {data.keys[0]}, {len(frequency_hz)} frequencies"
        fail(path, "as many frequencies as the data has", got)
    _check_plausible(path, tx.position_m, rx.position_m, layout.antennas.unit or "m")
    cube = _cube(file, layout.data, data, (tx, rx), descending=descending)
    meta: dict[str, Any] = {
        "source": shown(path),
        "format": "layout",
        "container": file.kind,
        "frame": number if frames is not None else None,
        "frames": frames,
        "frequencies_reversed": descending,
        "layout": layout.plain(),
    }
    if layout.meta.keys:
        # In a table of their own: a file can use any name.
        meta["file"] = {key: file.meta_value(key) for key in layout.meta.keys}
    array = AntennaArray(tx.position_m, rx.position_m, layout.array_name)
    return Capture(cube, array, Waveform(frequency_hz), meta)


def _data_of(file: LabFile, layout: DataLayout) -> _Data:
    """Return keys and axes of the data, checked against the layout's axes."""
    names = [name for name in (layout.key, layout.real, layout.imag) if name is not None]
    keys = tuple(file.find(name, _PURPOSE) for name in names)
    path = file.path
    for key in keys[1:]:
        if key.shape != keys[0].shape:
            fail(path, f"the shape of {keys[0]} for the imaginary part", str(key))
    shape = keys[0].shape
    if file.matlab and len(layout.axes) > len(shape):  # it leaves out last axes of length 1
        shape = shape + (1,) * (len(layout.axes) - len(shape))
    if len(shape) != len(layout.axes):
        wanted = f"the data to have {len(layout.axes)} axes ({', '.join(layout.axes)})"
        fail(path, wanted, str(keys[0]))
    lengths = dict(zip(layout.axes, shape, strict=True))
    ones = [n for axis, n in zip(layout.axes, shape, strict=True) if axis == "one" and n != 1]
    if ones:
        fail(path, f'every axis "one" of {keys[0]} to have length 1', f"{ones[0]}")
    if lengths.get("part", 2) != 2:
        fail(path, f'the axis "part" of {keys[0]} to have length 2', f"{lengths['part']}")
    for axis, index in layout.pick.items():
        if index >= lengths[axis]:
            fail(path, f"an index {index} on the axis '{clean(axis)}'", f"length {lengths[axis]}")
    if 0 in shape:
        fail(path, "data with at least one element", str(keys[0]))
    return _Data(keys, lengths)


def _frame_number(path: Path, frame: int | None, frames: int | None) -> int:
    if frames is None:
        if frame is not None:
            fail(path, 'a layout with an axis "frame", for a frame to be chosen', "none")
        return 0
    number = 0 if frame is None else frame
    if number >= frames:
        fail(path, f"frame {number}", f"frames 0 to {frames - 1}")
    return number


# ---- frequencies


def _frequencies(file: LabFile, layout: FrequencyLayout) -> tuple[np.ndarray, bool]:
    """Return the frequencies ascending, hertz, and whether the file has them descending."""
    frequency_hz = _as_described(file, layout)
    low_hz, high_hz = PLAUSIBLE_HZ
    outside = ~((frequency_hz >= low_hz) & (frequency_hz <= high_hz))
    if outside.any():
        got = f"{frequency_hz[outside][0]:g} Hz, read in {layout.unit}; is that the file's unit?"
        fail(file.path, f"frequencies between {low_hz:g} and {high_hz:g} Hz", got)
    steps = np.diff(frequency_hz)
    if (steps > 0).all():
        return frequency_hz, False
    if (steps < 0).all():
        return frequency_hz[::-1], True
    wrong = steps <= 0 if steps[0] > 0 else steps >= 0
    at = int(np.argmax(wrong))
    got = f"{frequency_hz[at]:.12g}, then {frequency_hz[at + 1]:.12g} Hz at {at}, {at + 1}"
    fail(file.path, "frequencies that ascend or descend", got)


def _as_described(file: LabFile, layout: FrequencyLayout) -> np.ndarray:
    unit_hz = FREQUENCY_UNITS_HZ[layout.unit]
    if layout.key is not None:
        return file.real_list(layout.key, "the frequencies") * unit_hz
    if layout.values is not None:
        return np.array(layout.values) * unit_hz
    assert layout.start is not None
    assert layout.points is not None
    start = file.real_number(layout.start, "the first frequency")
    points = file.real_number(layout.points, "the number of frequencies")
    if points != int(points) or not 1 <= points <= MAX_FREQUENCIES:
        fail(file.path, "a whole number of frequencies from 1", clean(points))
    count = int(points)
    if layout.step is not None:
        step = file.real_number(layout.step, "the frequency step")
        return (start + step * np.arange(count)) * unit_hz
    assert layout.stop is not None
    stop = file.real_number(layout.stop, "the last frequency")
    if count == 1 and start != stop:
        fail(file.path, "more than one frequency from start to stop", "1")
    return np.linspace(start * unit_hz, stop * unit_hz, count)


# ---- antennas


def _sides(file: LabFile, layout: Layout, data: _Data) -> tuple[_Side, _Side]:
    """Return Tx and Rx, their numbers of channels, positions and the data's shape in agreement."""
    path, sides = file.path, {"tx": layout.tx, "rx": layout.rx}
    positions = {name: _positions(file, layout, name) for name in sides}
    if "pair" in data.lengths:
        pairs = data.lengths["pair"]
        counts = {}
        for name, side in sides.items():
            # Positions of a known array are those of the used channels.
            hidden = side.select is not None and side.array is not None
            counts[name] = side.channels or (None if hidden else len(positions[name]))
        n_tx, n_rx = counts["tx"], counts["rx"]
        if n_tx is None and n_rx is not None and pairs % n_rx == 0:
            n_tx = pairs // n_rx
        if n_rx is None and n_tx is not None and pairs % n_tx == 0:
            n_rx = pairs // n_tx
        if n_tx is None or n_rx is None:
            fail(
                path,
                "[tx] channels and [rx] channels, the numbers of channels before 'select', to cut "
                f"{pairs} pairs by",
                "neither" if n_tx is n_rx else "one that does not divide them",
            )
        if n_tx * n_rx != pairs:
            wanted = f"{n_tx} Tx times {n_rx} Rx, so {n_tx * n_rx} pairs"
            fail(path, wanted, f"{pairs} in the data {data.keys[0]}")
        have = {"tx": n_tx, "rx": n_rx}
    else:
        have = {name: data.lengths.get(name, 1) for name in sides}
    tx, rx = (_side(path, n, sides[n], have[n], positions[n], data.keys[0]) for n in sides)
    return tx, rx


def _side(
    path: Path, name: str, side: AntennaLayout, have: int, position_m: np.ndarray, key: Key
) -> _Side:
    if side.channels is not None and side.channels != have:
        fail(path, f"[{name}] channels = {side.channels} in the data", f"{have}: {key}")
    if have > MAX_CHANNELS:  # what a header claims costs nothing until it is counted out
        fail(path, f"at most {MAX_CHANNELS} {name} channels", f"{have}: {key}")
    chosen = list(range(have))
    if side.select is not None:
        try:
            chosen = side.select.indices(have)
        except IndexError as error:
            fail(path, f"[{name}] select within {have} channels (from 0)", str(error))
        if not chosen:
            fail(path, f"[{name}] select to keep a channel of {have}", f"none: {side.select}")
    # Positions of all channels are selected from like the data; those of the used ones are not.
    if len(position_m) == have and side.array is None:
        position_m = position_m[chosen]
    elif len(position_m) != len(chosen):
        used = f", of which {len(chosen)} are selected," if len(chosen) != have else ""
        fail(
            path,
            f"as many {name} positions as {name} channels",
            f"{len(position_m)} positions and {have} channels{used} in the data {key}",
        )
    return _Side(have, chosen, np.ascontiguousarray(position_m))


def _positions(file: LabFile, layout: Layout, name: str) -> np.ndarray:
    """Return the positions of one side in the antenna frame, shape (n, 3), metres."""
    side: AntennaLayout = getattr(layout, name)
    frame, purpose = layout.antennas, f"the {name} positions"
    per_m = LENGTH_UNITS_PER_M[frame.unit or "m"]
    antenna_file = layout.file_of(side)
    if side.array is not None:
        known = getattr(arrays, side.array)()
        position_m = np.array(known.tx_m if name == "tx" else known.rx_m)
    elif antenna_file is not None:
        position_m = read_position_file(antenna_file) / per_m
    elif side.key is None and side.values is None:
        position_m = _of_single_keys(file, side, purpose) / per_m
    else:
        position_m = _of_table(file, side, frame.columns, purpose) / per_m
    position_m -= np.array(frame.origin) / per_m
    for axis in frame.mirror:
        column = COORDINATES.index(axis)
        position_m[:, column] = 0.0 - position_m[:, column]  # a zero keeps its sign
    return position_m


def _of_table(
    file: LabFile, side: AntennaLayout, columns: Sequence[str], purpose: str
) -> np.ndarray:
    """Return x, y, z of `values` or of one key, in the unit of the file."""
    if side.values is not None:
        table, source = np.array(side.values), "values"
    else:
        assert side.key is not None
        table, source = file.real_array(side.key, purpose), side.key
    across = 1 if side.orientation == "rows" else 0
    if table.ndim != 2 or table.shape[across] != len(columns):
        want = [len(columns), "N"] if across == 0 else ["N", len(columns)]
        other = "columns" if side.orientation == "rows" else "rows"
        turned = table.ndim == 2 and table.shape[1 - across] == len(columns)
        hint = f'; orientation = "{other}" would fit' if turned else ""
        wanted = (
            f"'{clean(source)}' ({purpose}: {', '.join(columns)}) of shape ({want[0]}, {want[1]})"
        )
        fail(file.path, wanted, f"shape {table.shape}{hint}")
    found = table if across == 1 else table.T
    result = np.zeros((len(found), 3))
    for i, axis in enumerate(columns):
        result[:, COORDINATES.index(axis)] = found[:, i]
    for axis, value in side.coordinates.items():
        result[:, COORDINATES.index(axis)] = value
    return result


def _of_single_keys(file: LabFile, side: AntennaLayout, purpose: str) -> np.ndarray:
    lists = {
        axis: file.real_list(value, f"{purpose}, {axis}")
        for axis, value in side.coordinates.items()
        if isinstance(value, str)
    }
    if len({len(values) for values in lists.values()}) != 1:
        counts = ", ".join(f"{len(values)} of {axis}" for axis, values in lists.items())
        fail(file.path, f"as many values of every coordinate ({purpose})", counts)
    result = np.zeros((len(next(iter(lists.values()))), 3))
    for axis, value in side.coordinates.items():
        result[:, COORDINATES.index(axis)] = lists.get(axis, value)
    return result


def _check_plausible(path: Path, tx_m: np.ndarray, rx_m: np.ndarray, unit: str) -> None:
    """Raise if the aperture has a size of another unit, or lies far away."""
    both = np.concatenate([tx_m, rx_m])
    extent_m = float(np.ptp(both, axis=0).max())
    low_m, high_m = PLAUSIBLE_APERTURE_M
    # One Tx and one Rx can be as close together as they like.
    too_small = extent_m < low_m and len(both) > 2
    if too_small or extent_m > high_m:
        _implausible(path, f"an aperture of {extent_m * 1e3:g} mm", unit)
    away_m = float(np.abs(both).max())
    if away_m > high_m:
        _implausible(path, f"an antenna {away_m * 1e3:g} mm away from the origin", unit)


def _implausible(path: Path, got: str, unit: str) -> NoReturn:
    low_m, high_m = PLAUSIBLE_APERTURE_M
    wanted = f"antennas within {high_m * 1e3:g} mm, over more than {low_m * 1e3:g} mm"
    fail(path, wanted, f"{got}, read in {unit}; is that the file's unit?")


# ---- the signal


def _cube(
    file: LabFile, layout: DataLayout, data: _Data, sides: tuple[_Side, _Side], *, descending: bool
) -> np.ndarray:
    """Return the signal of the used channels, shape (n_tx, n_rx, n_freq), complex64, read-only."""
    tx, rx = sides
    n_freq = data.lengths.get("freq", 1)
    count = len(tx.chosen) * len(rx.chosen) * n_freq
    if count * _COMPLEX64_BYTES > MAX_ARRAY_BYTES:
        most = MAX_ARRAY_BYTES // _COMPLEX64_BYTES
        fail(file.path, f"at most {most} complex numbers", f"{count}")
    cubes = _parts(file, layout, data, (tx.channels, rx.channels))
    result = np.empty((len(tx.chosen), len(rx.chosen), n_freq), np.complex64)
    step = -1 if descending else 1
    bad = 0
    for i, channel in enumerate(tx.chosen):
        # In double precision one Tx at a time: the whole would take several times the memory.
        row = np.empty(result.shape[1:], np.complex128)
        # A file can hold any bits as its numbers; what is not finite is counted below.
        with np.errstate(all="ignore"):
            if len(cubes) == 2:
                for part, target in zip(cubes, (row.real, row.imag), strict=True):
                    target[...] = part[channel][rx.chosen, ::step]
            else:
                row[...] = cubes[0][channel][rx.chosen, ::step]
            if layout.phase_sign > 0:
                np.conjugate(row, out=row)
            if layout.scale != 1.0:
                row *= layout.scale
            bad += int(row.size - np.count_nonzero(np.isfinite(row)))
            result[i] = row
    if bad:
        fail(file.path, "finite values in the data", f"{bad} of {count} that are NaN or infinite")
    if not np.isfinite(result).all():
        fail(file.path, "data that complex64 can hold", "an overflow")
    result.flags.writeable = False
    return result


def _parts(
    file: LabFile, layout: DataLayout, data: _Data, channels: tuple[int, int]
) -> list[np.ndarray]:
    """Return [tx, rx, freq] views: a complex one, or a real and an imaginary one."""
    path, picked = file.path, {*layout.pick, "frame"}
    rest = [name for name in layout.axes if name not in picked]
    found = []
    for key in data.keys:
        array = file.read(key.name, _PURPOSE)
        array = array.reshape(array.shape + (1,) * (len(rest) - array.ndim))
        found.append(_ordered(array, rest, layout, channels))
    if len(found) == 2:
        for array in found:
            if array.dtype.kind not in "iuf":
                wanted = "real numbers for the real and the imaginary part"
                fail(path, wanted, clean(array.dtype))
        return [array[..., 0] for array in found]
    array = found[0]
    if "part" in layout.axes:
        if array.dtype.kind not in "iuf":
            fail(path, 'real numbers where there is an axis "part"', clean(array.dtype))
        return [array[..., layout.parts.index(name)] for name in ("real", "imag")]
    array = array[..., 0]
    if array.dtype.names is not None:
        return [array[name] for name in _fields(path, layout, array.dtype.names)]
    if layout.fields is not None:
        wanted = f"a compound type with the fields {', '.join(layout.fields)}"
        fail(path, wanted, clean(array.dtype))
    if array.dtype.kind != "c":
        wanted = "complex numbers, or 'real' and 'imag', or an axis \"part\""
        fail(path, wanted, f"{array.dtype} in '{clean(data.keys[0].name)}'")
    return [array]


def _ordered(
    array: np.ndarray, names: Sequence[str], layout: DataLayout, channels: tuple[int, int]
) -> np.ndarray:
    """Return a view with the axes tx, rx, freq, part; those that are missing have length 1."""
    names = list(names)
    if "pair" in names:
        at = names.index("pair")
        outer, inner = ("tx", "rx") if layout.pair_order == "tx_major" else ("rx", "tx")
        n_tx, n_rx = channels
        split = (n_tx, n_rx) if outer == "tx" else (n_rx, n_tx)
        # Cutting one axis in two needs no copy, whatever the strides are.
        array = array.reshape(*array.shape[:at], *split, *array.shape[at + 1 :])
        names[at : at + 1] = [outer, inner]
    array = array[tuple(slice(None) if name != "one" else 0 for name in names)]
    names = [name for name in names if name != "one"]
    for name in ("tx", "rx", "freq", "part"):
        if name not in names:
            array = array[..., np.newaxis]
            names.append(name)
    return array.transpose([names.index(name) for name in ("tx", "rx", "freq", "part")])


def _fields(path: Path, layout: DataLayout, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return which field of a compound type is the real and which the imaginary part."""
    if layout.fields is not None:
        if set(layout.fields) != set(names):
            fail(path, f"the fields {clean(', '.join(layout.fields))}", clean(", ".join(names)))
        return layout.fields
    by_lower = {name.lower(): name for name in names}
    for pair in _FIELD_NAMES:
        if set(by_lower) == set(pair):
            return tuple(by_lower[name] for name in pair)
    wanted = "a compound type with fields r and i or real and imag; [data] fields names others"
    fail(path, wanted, clean(", ".join(names)))
