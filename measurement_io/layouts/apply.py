"""Apply a layout to a file: a `Capture`."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar import arrays
from clradar.constants import MAX_FREQUENCIES, PLAUSIBLE_APERTURE_M, PLAUSIBLE_HZ
from clradar.files.failures import clean, fail, reading, shown
from clradar.files.limits import MAX_ARRAY_BYTES, MAX_CHANNELS
from clradar.model import AntennaArray, Capture, Waveform
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
from measurement_io.maroon.frame import read_position_file

_FIELD_NAMES = (("r", "i"), ("real", "imag"), ("re", "im"), ("i", "q"))
_PURPOSE = "the data"
_ORDER = ("tx", "rx", "freq", "part")


def open_with_layout(
    source: Path, layout: str | os.PathLike[str] | Layout, frame: int | None
) -> Capture:
    """Return the capture in another program's file; see `open_capture`."""
    if not isinstance(layout, Layout):
        layout = read_layout(layout)
    with reading(source, EXPECTED):
        return _capture(LabFile.opened(source, [*_wanted(layout, frame or 0)]), layout, frame)


def _wanted(layout: Layout, frame: int) -> Iterator[tuple[str, Mapping[int, int]]]:
    """Yield the keys that a layout names, and which index of which axis is used of the data."""
    picked = {**layout.data.pick, "frame": frame}
    pick = {a: picked[name] for a, name in enumerate(layout.data.axes) if name in picked}
    for name in layout.data.keys:
        yield name, pick
    given = layout.frequency
    values = [given.key, given.start, given.stop, given.step, given.points]
    for side in (layout.tx, layout.rx):
        values += [side.key, *side.coordinates.values()]
    for value in values:
        if isinstance(value, str):
            yield value, {}


@dataclass(frozen=True, slots=True)
class _Side:
    """One side of the array: how many channels the file has, which are used, and where they are."""

    channels: int
    chosen: list[int]
    position_m: np.ndarray


def _capture(file: LabFile, layout: Layout, frame: int | None) -> Capture:
    path = file.path
    keys = [file.find(name, _PURPOSE) for name in layout.data.keys]
    lengths = _lengths(file, layout.data, keys)
    frames = lengths.get("frame")
    if frames is None and frame is not None:
        fail(path, 'a layout with an axis "frame", for a frame to be chosen', "none")
    if frames is not None and (frame or 0) >= frames:
        fail(path, f"frame {frame or 0}", f"frames 0 to {frames - 1}")
    frequency_hz, descending = _frequencies(file, layout.frequency)
    tx, rx = _sides(file, layout, lengths, keys[0])
    points = lengths.get("freq", 1)
    if points != len(frequency_hz):
        got = f"{points} in the data {keys[0]}, {len(frequency_hz)} frequencies"
        fail(path, "as many frequencies as the data has", got)
    _check_plausible(path, tx.position_m, rx.position_m, layout.antennas.unit or "m")
    cube = _cube(file, layout.data, (tx, rx), points, descending=descending)
    meta: dict[str, Any] = {
        "source": shown(path),
        "format": "layout",
        "container": file.kind,
        "frame": None if frames is None else frame or 0,
        "frames": frames,
        "frequencies_reversed": descending,
        "layout": layout.plain(),
    }
    array = AntennaArray(tx.position_m, rx.position_m, layout.array_name)
    return Capture(cube, array, Waveform(frequency_hz), meta)


def _lengths(file: LabFile, layout: DataLayout, keys: Sequence[Key]) -> dict[str, int]:
    """Return the lengths of the data's axes, checked against the layout."""
    path, key, shape = file.path, keys[0], keys[0].shape
    if keys[-1].shape != shape:
        fail(path, f"the shape of {key} for the imaginary part", str(keys[-1]))
    if file.matlab:  # it leaves out last axes of length 1
        shape = shape + (1,) * (len(layout.axes) - len(shape))
    if len(shape) != len(layout.axes):
        wanted = f"the data to have {len(layout.axes)} axes ({', '.join(layout.axes)})"
        fail(path, wanted, str(key))
    for axis, length in zip(layout.axes, shape, strict=True):
        wanted_length = {"one": 1, "part": 2}.get(axis, length)
        if length != wanted_length:
            wanted = f'the axis "{axis}" of {key} to have length {wanted_length}'
            fail(path, wanted, f"{length}")
        if layout.pick.get(axis, 0) >= length:
            index = layout.pick.get(axis, 0)
            fail(path, f"an index {index} on the axis '{clean(axis)}'", f"length {length}")
    return dict(zip(layout.axes, shape, strict=True))


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
    at = int(np.argmax(steps <= 0 if steps[0] > 0 else steps >= 0))
    got = f"{frequency_hz[at]:.12g}, then {frequency_hz[at + 1]:.12g} Hz at {at}, {at + 1}"
    fail(file.path, "frequencies that ascend or descend", got)


def _as_described(file: LabFile, layout: FrequencyLayout) -> np.ndarray:
    unit_hz = FREQUENCY_UNITS_HZ[layout.unit]
    if layout.key is not None:
        return file.real_list(layout.key, "the frequencies") * unit_hz
    if layout.values is not None:
        return np.array(layout.values) * unit_hz
    start = file.real_number(layout.start, "the first frequency")
    points = file.real_number(layout.points, "the number of frequencies")
    if points != int(points) or not 1 <= points <= MAX_FREQUENCIES:
        fail(file.path, "a whole number of frequencies from 1", clean(points))
    count = int(points)
    if layout.step is not None:
        step = file.real_number(layout.step, "the frequency step")
        return (start + step * np.arange(count)) * unit_hz
    stop = file.real_number(layout.stop, "the last frequency")
    if count == 1 and start != stop:
        fail(file.path, "more than one frequency from start to stop", "1")
    return np.linspace(start * unit_hz, stop * unit_hz, count)


# ---- antennas


def _sides(
    file: LabFile, layout: Layout, lengths: Mapping[str, int], key: Key
) -> tuple[_Side, _Side]:
    """Return Tx and Rx, their numbers of channels, positions and the data's shape in agreement."""
    path, sides = file.path, {"tx": layout.tx, "rx": layout.rx}
    positions = {name: _positions(file, layout, name) for name in sides}
    have = {name: lengths.get(name, 1) for name in sides}
    if "pair" in lengths:
        pairs, counts = lengths["pair"], dict[str, int]()
        for name, side in sides.items():
            # Positions of a known array are those of the used channels.
            if side.channels or side.select is None or side.array is None:
                counts[name] = side.channels or len(positions[name])
        for name, other in (("tx", "rx"), ("rx", "tx")):
            if name not in counts and pairs % counts.get(other, pairs + 1) == 0:
                counts[name] = pairs // counts[other]
        if len(counts) < 2 or math.prod(counts.values()) != pairs:
            wanted = (
                f"{pairs} pairs cut by the numbers of Tx and Rx ([tx] channels and [rx] channels: "
                "those before 'select')"
            )
            got = ", ".join(f"{count} {name}" for name, count in counts.items()) or "neither"
            fail(path, wanted, f"{got} in the data {key}")
        have = counts
    tx, rx = (_side(path, n, sides[n], have[n], positions[n], key) for n in sides)
    return tx, rx


def _side(
    path: Path, name: str, side: AntennaLayout, have: int, position_m: np.ndarray, key: Key
) -> _Side:
    if side.channels is not None and side.channels != have:
        fail(path, f"[{name}] channels = {side.channels} in the data", f"{have}: {key}")
    if have > MAX_CHANNELS:  # what a header claims costs nothing until it is counted out
        fail(path, f"at most {MAX_CHANNELS} {name} channels", f"{have}: {key}")
    try:
        chosen = side.chosen(have)
    except IndexError as error:
        fail(path, f"[{name}] select within {have} channels (from 0)", str(error))
    if not chosen:
        fail(path, f"[{name}] select to keep a channel of {have}", "none")
    # Positions of all channels are selected from like the data; those of the used ones are not.
    if len(position_m) == have and side.array is None:
        position_m = position_m[chosen]
    elif len(position_m) != len(chosen):
        used = f", of which {len(chosen)} are selected," if len(chosen) != have else ""
        got = f"{len(position_m)} positions and {have} channels{used} in the data {key}"
        fail(path, f"as many {name} positions as {name} channels", got)
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
    else:
        given = _coordinates(file, side, frame.columns, purpose)
        columns = np.broadcast_arrays(*(given[axis] for axis in COORDINATES))
        position_m = np.stack(columns, axis=1) / per_m
    position_m -= np.array(frame.origin) / per_m
    for axis in frame.mirror:
        column = COORDINATES.index(axis)
        position_m[:, column] = 0.0 - position_m[:, column]  # a zero keeps its sign
    return position_m


def _coordinates(
    file: LabFile, side: AntennaLayout, columns: Sequence[str], purpose: str
) -> dict[str, Any]:
    """Return x, y and z in the unit of the file, each a list, or the number that all share."""
    given: dict[str, Any] = {
        axis: file.real_list(value, f"{purpose}, {axis}") if isinstance(value, str) else value
        for axis, value in side.coordinates.items()
    }
    if side.key is None:
        counts = {axis: len(values) for axis, values in given.items() if np.ndim(values)}
        if len(set(counts.values())) != 1:
            got = ", ".join(f"{count} of {axis}" for axis, count in counts.items())
            fail(file.path, f"as many values of every coordinate ({purpose})", got)
        return given
    table = file.real_array(side.key, purpose)
    rows = side.orientation == "rows"
    if table.ndim != 2 or table.shape[1 if rows else 0] != len(columns):
        lines = "columns" if rows else "rows"
        wanted = f"{', '.join(columns)} in the {lines} of '{clean(side.key)}'"
        turned = table.ndim == 2 and table.shape[0 if rows else 1] == len(columns)
        hint = f'; orientation = "{"columns" if rows else "rows"}" would fit' if turned else ""
        fail(file.path, f"{wanted} ({purpose})", f"shape {table.shape}{hint}")
    return given | dict(zip(columns, table.T if rows else table, strict=True))


def _check_plausible(path: Path, tx_m: np.ndarray, rx_m: np.ndarray, unit: str) -> None:
    """Raise if the aperture has a size of another unit, or lies far away."""
    both = np.concatenate([tx_m, rx_m])
    extent_m, away_m = float(np.ptp(both, axis=0).max()), float(np.abs(both).max())
    low_m, high_m = PLAUSIBLE_APERTURE_M
    # One Tx and one Rx can be as close together as they like.
    if (extent_m < low_m and len(both) > 2) or max(extent_m, away_m) > high_m:
        wanted = f"antennas within {high_m * 1e3:g} mm, over more than {low_m * 1e3:g} mm"
        got = (
            f"an aperture of {extent_m * 1e3:g} mm, antennas to {away_m * 1e3:g} mm from the origin"
        )
        fail(path, wanted, f"{got}, read in {unit}; is that the file's unit?")


# ---- the signal


def _cube(
    file: LabFile, layout: DataLayout, sides: tuple[_Side, _Side], points: int, *, descending: bool
) -> np.ndarray:
    """Return the signal of the used channels, shape (n_tx, n_rx, n_freq), complex64, read-only."""
    tx, rx = sides
    shape = (len(tx.chosen), len(rx.chosen), points)
    result_bytes = math.prod(shape) * np.dtype(np.complex64).itemsize
    if result_bytes > MAX_ARRAY_BYTES:
        fail(file.path, f"at most {MAX_ARRAY_BYTES} bytes of data", f"{result_bytes}")
    parts = _parts(file, layout, (tx.channels, rx.channels))
    result = np.empty(shape, np.complex64)
    step = -1 if descending else 1
    # A file can hold any bits as its numbers; what is not finite is counted below.
    with np.errstate(all="ignore"):
        for row, channel in zip(result, tx.chosen, strict=True):
            targets = (row,) if len(parts) == 1 else (row.real, row.imag)
            for part, target in zip(parts, targets, strict=True):
                target[...] = part[channel][rx.chosen, ::step]
    if layout.phase_sign > 0:
        np.conjugate(result, out=result)
    bad = int(result.size - np.count_nonzero(np.isfinite(result)))
    if bad:
        got = f"{bad} of {result.size} that are not"
        fail(file.path, "finite values in the data, within complex64", got)
    result.flags.writeable = False
    return result


def _parts(file: LabFile, layout: DataLayout, channels: tuple[int, int]) -> list[np.ndarray]:
    """Return [tx, rx, freq] views: a complex one, or a real and an imaginary one."""
    path, picked = file.path, {*layout.pick, "frame"}
    rest = [name for name in layout.axes if name not in picked]
    found = []
    for name in layout.keys:
        array = file.read(name, _PURPOSE)
        array = array.reshape(array.shape + (1,) * (len(rest) - array.ndim))
        found.append(_ordered(array, rest, layout, channels))
    array = found[0]
    if len(found) == 2 or "part" in layout.axes:
        if any(one.dtype.kind not in "iuf" for one in found):
            wanted = "real numbers as the real and the imaginary part"
            fail(path, wanted, ", ".join(clean(one.dtype) for one in found))
        return [one[..., 0] for one in found] if len(found) == 2 else [array[..., 0], array[..., 1]]
    array = array[..., 0]
    by_lower = {name.lower(): name for name in array.dtype.names or ()}
    for pair in _FIELD_NAMES:
        if set(by_lower) == set(pair):
            return [array[by_lower[name]] for name in pair]
    if array.dtype.kind != "c":
        wanted = (
            "complex numbers (or fields r and i, real and imag, i and q), 'real' and 'imag', or an "
            'axis "part"'
        )
        fail(path, wanted, f"{clean(array.dtype)} in '{clean(layout.keys[0])}'")
    return [array]


def _ordered(
    array: np.ndarray, names: Sequence[str], layout: DataLayout, channels: tuple[int, int]
) -> np.ndarray:
    """Return a view with the axes tx, rx, freq, part; those that are missing have length 1."""
    names = list(names)
    if "pair" in names:
        at, count = names.index("pair"), dict(zip(("tx", "rx"), channels, strict=True))
        order = ["tx", "rx"] if layout.pair_order == "tx_major" else ["rx", "tx"]
        # Cutting one axis in two needs no copy, whatever the strides are.
        split = (count[name] for name in order)
        array = array.reshape(*array.shape[:at], *split, *array.shape[at + 1 :])
        names[at : at + 1] = order
    array = array.squeeze(axis=tuple(i for i, name in enumerate(names) if name == "one"))
    names = [name for name in names if name != "one"]
    missing = [name for name in _ORDER if name not in names]
    names += missing
    array = array[(..., *[np.newaxis] * len(missing))]
    return array.transpose([names.index(name) for name in _ORDER])
