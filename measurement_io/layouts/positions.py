"""Antenna positions by a layout, in the antenna frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from clradar import arrays
from clradar.constants import PLAUSIBLE_APERTURE_M
from clradar.files.failures import clean, fail
from measurement_io.antenna_file import read_position_file
from measurement_io.layouts.container import Container
from measurement_io.layouts.layout import (
    LENGTH_UNITS_PER_M,
    AntennaLayout,
    FrameOfReference,
)
from measurement_io.layouts.real_values import real_array, real_list

_COORDINATES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Positions:
    """Antennas of one side.

    Attributes
    ----------
    position_m : ndarray, shape (n, 3), float64, metres
        In the antenna frame.
    chosen : bool
        Whether they are those of the channels that are used, whatever the layout selects.
    """

    position_m: np.ndarray
    chosen: bool


def read_positions(
    container: Container, side: AntennaLayout, frame: FrameOfReference, name: str
) -> Positions:
    """Return the positions of one side, `name` is "tx" or "rx"."""
    purpose = f"the {name} positions"
    if side.array is not None:
        known = getattr(arrays, side.array)()
        position_m = np.array(known.tx_m if name == "tx" else known.rx_m)
    else:
        position_m = _coordinates(container, side, frame, purpose)
        position_m /= LENGTH_UNITS_PER_M[frame.unit]
    position_m -= np.array(frame.origin) / LENGTH_UNITS_PER_M[frame.unit]
    for axis in frame.mirror:
        column = _COORDINATES.index(axis)
        position_m[:, column] = 0.0 - position_m[:, column]  # a zero keeps its sign
    return Positions(position_m, side.array is not None)


def check_plausible(
    path: Path, tx_m: np.ndarray, rx_m: np.ndarray, frame: FrameOfReference
) -> None:
    """Raise if the aperture has a size of another unit, or lies far away."""
    both = np.concatenate([tx_m, rx_m])
    extent_m = float(np.ptp(both, axis=0).max())
    low_m, high_m = PLAUSIBLE_APERTURE_M
    # One Tx and one Rx can be as close together as they like.
    too_small = extent_m < low_m and len(both) > 2
    if too_small or extent_m > high_m:
        _implausible(path, f"an aperture of {extent_m * 1e3:g} mm", frame)
    away_m = float(np.abs(both).max())
    if away_m > high_m:
        _implausible(path, f"an antenna {away_m * 1e3:g} mm away from the origin", frame)


def _implausible(path: Path, got: str, frame: FrameOfReference) -> NoReturn:
    low_m, high_m = PLAUSIBLE_APERTURE_M
    fail(
        path,
        f"antennas within {high_m * 1e3:g} mm, over more than {low_m * 1e3:g} mm",
        f"{got}, read in {frame.unit}; is that the file's unit?",
    )


def _coordinates(
    container: Container, side: AntennaLayout, frame: FrameOfReference, purpose: str
) -> np.ndarray:
    """Return x, y, z in the unit of the file, shape (n, 3)."""
    if side.file is not None:
        return read_position_file(side.file)
    if side.key is None and side.values is None:
        return _from_single_keys(container, side, purpose)
    if side.values is not None:
        table, source = np.array(side.values), "values"
    else:
        assert side.key is not None
        table, source = real_array(container, side.key, purpose), side.key
    across = 1 if side.orientation == "rows" else 0
    if table.ndim != 2 or table.shape[across] != len(frame.columns):
        want = [len(frame.columns), "N"] if across == 0 else ["N", len(frame.columns)]
        other = "columns" if side.orientation == "rows" else "rows"
        turned = table.ndim == 2 and table.shape[1 - across] == len(frame.columns)
        hint = f'; orientation = "{other}" would fit' if turned else ""
        fail(
            container.path,
            f"'{clean(source)}' ({purpose}: {', '.join(frame.columns)}) of shape "
            f"({want[0]}, {want[1]})",
            f"shape {table.shape}{hint}",
        )
    columns = table if across == 1 else table.T
    result = np.zeros((len(columns), 3))
    for i, axis in enumerate(frame.columns):
        result[:, _COORDINATES.index(axis)] = columns[:, i]
    for axis, value in side.coordinates:
        result[:, _COORDINATES.index(axis)] = value
    return result


def _from_single_keys(container: Container, side: AntennaLayout, purpose: str) -> np.ndarray:
    lists = {
        axis: real_list(container, value, f"{purpose}, {axis}")
        for axis, value in side.coordinates
        if isinstance(value, str)
    }
    lengths = {axis: len(values) for axis, values in lists.items()}
    if len(set(lengths.values())) != 1:
        counts = ", ".join(f"{n} of {axis}" for axis, n in lengths.items())
        fail(container.path, f"as many values of every coordinate ({purpose})", counts)
    result = np.zeros((next(iter(lengths.values())), 3))
    for axis, value in side.coordinates:
        result[:, _COORDINATES.index(axis)] = lists[axis] if isinstance(value, str) else value
    return result
