"""Guess which axis of the data is which."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from measurement_io.layouts.draft_lines import UNKNOWN
from measurement_io.layouts.guessed_antennas import AntennaGuess

_QAR50_CHANNELS = (94, 96)


@dataclass(frozen=True, slots=True)
class GuessedAxes:
    """The probable axes of the data.

    Attributes
    ----------
    names : tuple of str
        As a layout's `axes`, "?" for what cannot be said.
    remarks : tuple of str
        What is not certain.
    channels : mapping of str to int or None
        How many Tx and Rx the data has.
    points : int
        How many frequencies.
    """

    names: tuple[str, ...]
    remarks: tuple[str, ...]
    channels: Mapping[str, int | None]
    points: int


def guess_axes(
    shape: tuple[int, ...], part: int | None, points: int | None, sides: Mapping[str, AntennaGuess]
) -> GuessedAxes:
    """Return names for the axes of a shape.

    Parameters
    ----------
    shape : tuple of int
    part : int or None
        The axis of the real and imaginary parts.
    points : int or None
        Number of frequencies that was found.
    sides : mapping of str to AntennaGuess
        The antennas that were found.
    """
    names = [UNKNOWN] * len(shape)
    if part is not None:
        names[part] = "part"
    counts = {name: side.count for name, side in sides.items()}
    remarks = _by_length(shape, names, points, counts)
    ones = [axis for axis, n in enumerate(shape) if n == 1 and names[axis] == UNKNOWN]
    for name, count in (*counts.items(), ("freq", points)):
        there = name in names or (name != "freq" and "pair" in names)
        if not there and ones and count == 1:
            names[ones.pop()] = name
    for axis in ones:
        names[axis] = "one"
    remarks += _by_elimination(shape, names)
    if "pair" in names:
        pairs = shape[names.index("pair")]
        root = next((n for n in _QAR50_CHANNELS if n * n == pairs), None)
        channels = {name: count or root for name, count in counts.items()}
    else:
        channels = {name: shape[names.index(name)] if name in names else None for name in counts}
    n_freq = shape[names.index("freq")] if "freq" in names else 1
    return GuessedAxes(tuple(names), tuple(remarks), channels, n_freq)


def _by_length(
    shape: tuple[int, ...],
    names: list[str],
    points: int | None,
    counts: Mapping[str, int | None],
) -> list[str]:
    """Name the axes whose length is that of the frequencies or of the antennas."""
    remarks = []

    def free(length: int | None) -> list[int]:
        return [a for a, n in enumerate(shape) if 1 < n == length and names[a] == UNKNOWN]

    fitting = free(points)
    if fitting:
        names[fitting[-1]] = "freq"  # most often the last
        if len(fitting) > 1:
            remarks.append(f"freq is one of the axes {_listed(fitting)} by its length {points}")
    n_tx, n_rx = counts["tx"], counts["rx"]
    if n_tx is None and n_rx is None:
        squares = [n for n in shape if n in [c * c for c in _QAR50_CHANNELS]]
        twins = [n for a, n in enumerate(shape) if len(free(n)) == 2 and names[a] == UNKNOWN]
        if squares:
            at = shape.index(squares[0])
            names[at] = "pair"
            remarks.append(f"axis {at} counts pairs of antennas, {squares[0]} being a square")
        elif twins:
            # Two axes of one length are the antennas, more likely than others.
            names[free(twins[0])[0]], names[free(twins[0])[-1]] = "tx", "rx"
            remarks.append("the file does not distinguish the tx axis from the rx axis")
        return remarks
    if n_tx is not None and n_rx is not None and not free(n_tx) and not free(n_rx):
        pairs = free(n_tx * n_rx)
        if pairs:
            names[pairs[0]] = "pair"
            return remarks
    for name, count in counts.items():
        fitting = free(count)
        if not fitting:
            continue
        # Frames come first, so of three alike the last two are the antennas.
        at = fitting[-2] if name == "tx" and n_tx == n_rx and len(fitting) > 1 else fitting[-1]
        names[at] = name
        if len(fitting) > 1:
            remarks.append(f"{name} is one of the axes {_listed(fitting)} by its length {count}")
    return remarks


def _by_elimination(shape: tuple[int, ...], names: list[str]) -> list[str]:
    """Name the axes that are left."""
    left = [axis for axis, name in enumerate(names) if name == UNKNOWN]
    wanted = ("freq",) if "pair" in names else ("tx", "rx", "freq")
    missing = [name for name in wanted if name not in names]
    if len(left) == len(missing) + 1:
        # One axis more than there are meanings: frames, which come first.
        missing.insert(0, "frame")
    if len(left) != len(missing):
        return []
    remarks = []
    for axis, name in zip(left, missing, strict=True):
        names[axis] = name
        remarks.append(f"{name} is axis {axis} of length {shape[axis]} by elimination")
    return remarks


def _listed(axes: list[int]) -> str:
    return " or ".join(str(axis) for axis in axes)
