"""Draft a layout for a file that has none, from names, lengths and values of its keys."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from clradar.errors import MeasurementError
from clradar.files.failures import clean, shown
from measurement_io.layouts.container import Container, Key
from measurement_io.layouts.containers import open_container
from measurement_io.layouts.draft_lines import GUESS, UNKNOWN, Line
from measurement_io.layouts.guessed_antennas import AntennaGuess, guess_length_unit, guess_sides
from measurement_io.layouts.guessed_axes import GuessedAxes, guess_axes
from measurement_io.layouts.guesses import (
    Frequencies,
    guess_frequencies,
    guess_signal,
    small_values,
)

_LISTED = 200
_RIVALS = 10
_IMAGING = 'select = "1:95"'
_IMAGING_REMARK = f"{GUESS}the imaging ones of 96"


class LayoutNeeded(MeasurementError):
    """A file of another program was opened without a layout.

    Attributes
    ----------
    skeleton : str
        A draft of a layout; comments mark guesses.

    Examples
    --------
    >>> import numpy as np
    >>> from clradar.measurement_io import LayoutNeeded, open_capture
    >>> np.savez("lab.npz", signal=np.ones((4, 3, 8), np.complex64), f_ghz=np.linspace(72, 82, 8))
    >>> try:
    ...     open_capture("lab.npz")
    ... except LayoutNeeded as error:
    ...     draft = error.skeleton
    >>> print(draft[draft.index("[frequency]"):].strip())
    [frequency]
    key = "f_ghz"
    unit = "GHz"
    """

    skeleton: str = ""


def layout_needed(path: Path) -> LayoutNeeded:
    """Return the error that lists the keys of a file and carries a draft of its layout."""
    with open_container(path) as container:
        error = LayoutNeeded(
            f"{shown(path)}: expected a layout (layout=, --layout, see docs/layouts.md) for "
            f"a file of another program, got {container.kind} "
            f"with the keys {container.listed()}"
        )
        error.skeleton = layout_draft(container)
        return error


def layout_draft(container: Container) -> str:
    """Return a layout file for an opened container.

    Lengths, names and values give what they can. What is not certain has a remark that begins with
    "guess"; where nothing can be said the value is "?", and the layout is refused until it is
    filled in.
    """
    keys = [key for key in container.keys.values() if _usable(key)]
    signal = guess_signal(keys)
    others = [key for key in keys if key.name not in signal.names]
    values = small_values(container, others)
    frequencies = guess_frequencies(others, values)
    found = guess_sides(others, values, signal.shape)
    axes = guess_axes(signal.shape, signal.part_axis, frequencies.count, found)
    sides = {name: _completed(side, axes.channels[name]) for name, side in found.items()}
    blocks = [
        _head(container),
        ["[data]", *map(str, signal.lines), *_axes_lines(axes)],
        *(["[" + name + "]", *map(str, side.lines)] for name, side in sides.items()),
        *_frame_of_reference(sides, frequencies.center_hz),
        ["[frequency]", *map(str, _with_points(frequencies, axes.points))],
    ]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _usable(key: Key) -> bool:
    return key.content == "numbers" and math.prod(key.shape) > 0 and key.name.isprintable()


def _head(container: Container) -> list[str]:
    lines = [f"# Layout of {container.kind} with these keys:"]
    keys = list(container.keys.values())
    lines += [f"#   {key}" for key in keys[:_LISTED]]
    if len(keys) > _LISTED:
        lines.append(f"#   and {len(keys) - _LISTED} more")
    return [
        *lines,
        "# Check every remark that begins with 'guess', and fill in every \"?\".",
        "# docs/layouts.md explains all settings.",
    ]


def _completed(side: AntennaGuess, channels: int | None) -> AntennaGuess:
    """Return a side with what was found, with the known array that fits, or with "?"."""
    if side.lines:
        if (channels, side.count) != (96, 94):
            return side
        return replace(side, lines=(Line(_IMAGING, _IMAGING_REMARK), *side.lines))
    if side.names:
        rivals = ", ".join(clean(name) for name in side.names[:_RIVALS])
        remark = f"positions: one of {rivals}?"
        return replace(side, lines=(Line(f'key = "{UNKNOWN}"', remark),))
    array = Line('array = "qar50"', f"{GUESS}{channels} channels and no positions in the file")
    if channels == 94:
        return replace(side, lines=(array,))
    if channels == 96:
        lines = (Line("channels = 96"), Line(_IMAGING, _IMAGING_REMARK), array)
        return replace(side, lines=lines)
    remark = "no positions found: a key, or 'values', 'file', 'array'"
    return replace(side, lines=(Line(f'key = "{UNKNOWN}"', remark),))


def _axes_lines(axes: GuessedAxes) -> list[str]:
    listed = ", ".join(f'"{name}"' for name in axes.names) or f'"{UNKNOWN}"'
    lines = [*(f"# {GUESS}{remark}" for remark in axes.remarks), f"axes = [{listed}]"]
    if "pair" in axes.names:
        lines.append(str(Line('pair_order = "tx_major"', f"{GUESS}or rx_major")))
    remark = "exp(-j 2 pi f d / c); not in any file: `clradar diagnose` finds out"
    return [*lines, str(Line("phase_sign = -1", remark))]


def _frame_of_reference(sides: dict[str, AntennaGuess], center_hz: float | None) -> list[list[str]]:
    """Return the table of units, if there are positions in the file."""
    if all(any(line.text.startswith("array =") for line in s.lines) for s in sides.values()):
        return []
    lines = [guess_length_unit(list(sides.values()), center_hz)]
    columns = next((side.columns for side in sides.values() if side.columns is not None), None)
    if columns is not None and len(columns) == 2:
        lines.append(Line('columns = ["x", "y"]', f"{GUESS}or others"))
    return [["[antennas]", *map(str, lines)]]


def _with_points(frequencies: Frequencies, points: int) -> tuple[Line, ...]:
    if frequencies.lines:
        return frequencies.lines
    return (
        Line(f'start = "{UNKNOWN}"', "no frequencies found: a number, or a key"),
        Line(f'stop = "{UNKNOWN}"', "or step"),
        Line(f"points = {points}"),
        Line('unit = "GHz"'),
    )
