"""The signal of a file as data[tx, rx, freq]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clradar.files.failures import clean, fail
from clradar.files.limits import MAX_ARRAY_BYTES
from measurement_io.layouts.container import Container, Key
from measurement_io.layouts.layout import DataLayout

_FIELD_NAMES = (("r", "i"), ("real", "imag"), ("re", "im"))
_PURPOSE = "the data"
_COMPLEX64_BYTES = 8


@dataclass(frozen=True, slots=True)
class DataShape:
    """Shape and keys of the data, from the header of the file.

    Attributes
    ----------
    keys : tuple of Key
        One, or those of the real and the imaginary part.
    lengths : dict of str to int
        Length of every axis that the layout names; those that it does not name have length 1.
    """

    keys: tuple[Key, ...]
    lengths: Mapping[str, int]


def data_shape(container: Container, layout: DataLayout) -> DataShape:
    """Return keys and axes of the data, checked against the layout's axes."""
    names = [name for name in (layout.key, layout.real, layout.imag) if name is not None]
    keys = tuple(container.find(name, _PURPOSE) for name in names)
    path = container.path
    for key in keys[1:]:
        if key.shape != keys[0].shape:
            fail(path, f"the shape of {keys[0]} for the imaginary part", str(key))
    shape = full_shape(container, keys[0], layout)
    lengths = dict(zip(layout.axes, shape, strict=True))
    ones = [n for axis, n in zip(layout.axes, shape, strict=True) if axis == "one" and n != 1]
    if ones:
        fail(path, f'every axis "one" of {keys[0]} to have length 1', f"{ones[0]}")
    if lengths.get("part", 2) != 2:
        fail(path, f'the axis "part" of {keys[0]} to have length 2', f"{lengths['part']}")
    for axis, index in layout.pick:
        if index >= lengths[axis]:
            fail(path, f"an index {index} on the axis '{clean(axis)}'", f"length {lengths[axis]}")
    if 0 in shape:
        fail(path, "data with at least one element", str(keys[0]))
    return DataShape(keys, lengths)


def full_shape(container: Container, key: Key, layout: DataLayout) -> tuple[int, ...]:
    """Return the shape with the last axes of length 1 that MATLAB leaves out."""
    shape = key.shape
    missing = len(layout.axes) - len(shape)
    if container.matlab and missing > 0:
        shape = shape + (1,) * missing
    if len(shape) != len(layout.axes):
        fail(
            container.path,
            f"the data to have {len(layout.axes)} axes ({', '.join(layout.axes)})",
            str(key),
        )
    return shape


def read_cube(
    container: Container,
    layout: DataLayout,
    shape: DataShape,
    frame: int,
    channels: tuple[int, int],
    chosen: tuple[Sequence[int], Sequence[int]],
    *,
    descending: bool,
) -> np.ndarray:
    """Return the signal.

    Parameters
    ----------
    container, layout, shape
        Where it is.
    frame : int
        Index on the axis "frame", if there is one.
    channels : (int, int)
        Number of Tx and Rx that the file has.
    chosen : (sequence of int, sequence of int)
        The Tx and the Rx that are used.
    descending : bool
        Whether the file's frequencies descend, so that they are reversed.

    Returns
    -------
    ndarray, shape (n_tx, n_rx, n_freq), complex64, read-only
    """
    path = container.path
    count = len(chosen[0]) * len(chosen[1]) * shape.lengths.get("freq", 1)
    if count * _COMPLEX64_BYTES > MAX_ARRAY_BYTES:
        fail(path, f"at most {MAX_ARRAY_BYTES // _COMPLEX64_BYTES} complex numbers", f"{count}")
    picked = dict(layout.pick)
    if "frame" in layout.axes:
        picked["frame"] = frame
    cubes = _parts(container, layout, shape, picked, channels)
    result = np.empty((len(chosen[0]), len(chosen[1]), shape.lengths.get("freq", 1)), np.complex64)
    step = -1 if descending else 1
    bad = 0
    for i, tx in enumerate(chosen[0]):
        # In double precision one Tx at a time: the whole would take several times the memory.
        row = np.empty(result.shape[1:], np.complex128)
        # A file can hold any bits as its numbers; what is not finite is counted below.
        with np.errstate(all="ignore"):
            for part, target in ((0, row.real), (1, row.imag)):
                if len(cubes) == 2:
                    target[...] = cubes[part][tx][chosen[1], ::step]
            if len(cubes) == 1:
                row[...] = cubes[0][tx][chosen[1], ::step]
            if layout.phase_sign > 0:
                np.conjugate(row, out=row)
            if layout.scale != 1.0:
                row *= layout.scale
            bad += int(row.size - np.count_nonzero(np.isfinite(row)))
            result[i] = row
    if bad:
        fail(path, "finite values in the data", f"{bad} of {count} that are NaN or infinite")
    if not np.isfinite(result).all():
        fail(path, "data that complex64 can hold", "an overflow")
    result.flags.writeable = False
    return result


def _parts(
    container: Container,
    layout: DataLayout,
    shape: DataShape,
    picked: Mapping[str, int],
    channels: tuple[int, int],
) -> list[np.ndarray]:
    """Return [tx, rx, freq] views: a complex one, or a real and an imaginary one."""
    path = container.path
    arrays = []
    for key in shape.keys:
        # Axes that MATLAB leaves out have length 1; there is nothing to pick from.
        pick = {a: picked[n] for a, n in enumerate(layout.axes[: len(key.shape)]) if n in picked}
        array = container.read(key.name, _PURPOSE, pick)
        rest = [n for n in layout.axes if n not in picked]
        array = array.reshape(array.shape + (1,) * (len(rest) - array.ndim))
        arrays.append(_ordered(array, rest, layout, channels))
    if len(arrays) == 2:
        for array in arrays:
            if array.dtype.kind not in "iuf":
                fail(path, "real numbers for the real and the imaginary part", clean(array.dtype))
        return [array[..., 0] for array in arrays]
    array = arrays[0]
    if "part" in layout.axes:
        if array.dtype.kind not in "iuf":
            fail(path, 'real numbers where there is an axis "part"', clean(array.dtype))
        order = [layout.parts.index(name) for name in ("real", "imag")]
        return [array[..., i] for i in order]
    array = array[..., 0]
    if array.dtype.names is not None:
        return [array[name] for name in _fields(container, layout, array.dtype.names)]
    if layout.fields is not None:
        fail(
            path, f"a compound type with the fields {', '.join(layout.fields)}", clean(array.dtype)
        )
    if array.dtype.kind != "c":
        fail(
            path,
            "complex numbers, or 'real' and 'imag', or an axis \"part\"",
            f"{array.dtype} in '{clean(shape.keys[0].name)}'",
        )
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
    kept = tuple(slice(None) if name != "one" else 0 for name in names)
    array = array[kept]
    names = [name for name in names if name != "one"]
    for name in ("tx", "rx", "freq", "part"):
        if name not in names:
            array = array[..., np.newaxis]
            names.append(name)
    return array.transpose([names.index(name) for name in ("tx", "rx", "freq", "part")])


def _fields(container: Container, layout: DataLayout, names: tuple[str, ...]) -> tuple[str, str]:
    """Return which field of a compound type is the real and which the imaginary part."""
    if layout.fields is not None:
        if set(layout.fields) != set(names):
            wanted = ", ".join(layout.fields)
            fail(container.path, f"the fields {clean(wanted)}", clean(", ".join(names)))
        return layout.fields
    by_lower = {name.lower(): name for name in names}
    for real, imag in _FIELD_NAMES:
        if set(by_lower) == {real, imag}:
            return by_lower[real], by_lower[imag]
    fail(
        container.path,
        "a compound type with fields r and i or real and imag; [data] fields names others",
        clean(", ".join(names)),
    )
