"""Apply a layout to a file: a `Capture`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.failures import fail, reading, shown
from clradar.files.limits import MAX_CHANNELS
from clradar.model import AntennaArray, Capture, Waveform, checks
from measurement_io.layouts.container import Container
from measurement_io.layouts.containers import EXPECTED, open_container
from measurement_io.layouts.cube import DataShape, data_shape, read_cube
from measurement_io.layouts.frequencies import read_frequencies
from measurement_io.layouts.layout import AntennaLayout, Layout
from measurement_io.layouts.positions import Positions, check_plausible, read_positions
from measurement_io.layouts.real_values import meta_value
from measurement_io.layouts.toml_reader import read_layout


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
    >>> from clradar.measurement_io import open_with_layout
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
    with reading(source, EXPECTED), open_container(source) as container:
        return _capture(container, layout, frame)


@dataclass(frozen=True, slots=True)
class _Side:
    """One side of the array: how many channels the file has, which are used, and where they are."""

    channels: int
    chosen: list[int]
    position_m: np.ndarray


def _capture(container: Container, layout: Layout, frame: int | None) -> Capture:
    path = container.path
    shape = data_shape(container, layout.data)
    frames = shape.lengths.get("frame")
    number = _frame_number(path, frame, frames)
    frequency_hz, descending = read_frequencies(container, layout.frequency)
    positions = {
        name: read_positions(container, side, layout.antennas, name)
        for name, side in (("tx", layout.tx), ("rx", layout.rx))
    }
    tx, rx = _sides(path, layout, shape, positions)
    points = shape.lengths.get("freq", 1)
    if points != len(frequency_hz):
        fail(
            path,
            "as many frequencies as the data has",
            f"{points} in the data {shape.keys[0]}, {len(frequency_hz)} frequencies",
        )
    check_plausible(path, tx.position_m, rx.position_m, layout.antennas)
    data = read_cube(
        container,
        layout.data,
        shape,
        number,
        (tx.channels, rx.channels),
        (tx.chosen, rx.chosen),
        descending=descending,
    )
    array = AntennaArray(tx.position_m, rx.position_m, layout.antennas.name)
    meta: dict[str, Any] = {
        "source": shown(path),
        "format": "layout",
        "container": container.kind,
        "frame": number if frames is not None else None,
        "frames": frames,
        "frequencies_reversed": descending,
        "layout": layout.plain(),
    }
    if layout.meta:
        # In a table of their own: a file can use any name.
        meta["file"] = {key: meta_value(container, key) for key in layout.meta}
    return Capture(data, array, Waveform(frequency_hz), meta)


def _frame_number(path: Path, frame: int | None, frames: int | None) -> int:
    if frames is None:
        if frame is not None:
            fail(path, 'a layout with an axis "frame", for a frame to be chosen', "none")
        return 0
    number = 0 if frame is None else frame
    if number >= frames:
        fail(path, f"frame {number}", f"frames 0 to {frames - 1}")
    return number


def _sides(
    path: Path, layout: Layout, shape: DataShape, positions: Mapping[str, Positions]
) -> tuple[_Side, _Side]:
    """Return Tx and Rx, their numbers of channels, positions and the data's shape in agreement."""
    counts = {
        name: side.channels if side.channels is not None else _rows(side, positions[name])
        for name, side in (("tx", layout.tx), ("rx", layout.rx))
    }
    if "pair" in shape.lengths:
        pairs = shape.lengths["pair"]
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
            fail(
                path,
                f"{n_tx} Tx times {n_rx} Rx, so {n_tx * n_rx} pairs",
                f"{pairs} in the data {shape.keys[0]}",
            )
        have = {"tx": n_tx, "rx": n_rx}
    else:
        have = {name: shape.lengths.get(name, 1) for name in ("tx", "rx")}
    return (
        _side(path, "tx", layout.tx, have["tx"], positions["tx"], shape),
        _side(path, "rx", layout.rx, have["rx"], positions["rx"], shape),
    )


def _rows(side: AntennaLayout, positions: Positions) -> int | None:
    """Return the number of channels by the positions, None if `select` hides it."""
    return None if side.select is not None and positions.chosen else len(positions.position_m)


def _side(
    path: Path, name: str, side: AntennaLayout, have: int, positions: Positions, shape: DataShape
) -> _Side:
    if side.channels is not None and side.channels != have:
        fail(path, f"[{name}] channels = {side.channels} in the data", f"{have}: {shape.keys[0]}")
    if have > MAX_CHANNELS:  # what a header claims costs nothing until it is counted out
        fail(path, f"at most {MAX_CHANNELS} {name} channels", f"{have}: {shape.keys[0]}")
    chosen = list(range(have))
    if side.select is not None:
        try:
            chosen = side.select.indices(have)
        except IndexError as error:
            fail(path, f"[{name}] select within {have} channels (from 0)", str(error))
        if not chosen:
            fail(path, f"[{name}] select to keep a channel of {have}", f"none: {side.select}")
    position_m, rows = positions.position_m, len(positions.position_m)
    # Positions of all channels are selected from like the data; those of the used ones are not.
    if rows == have and not positions.chosen:
        position_m = position_m[chosen]
    elif rows != len(chosen):
        used = f", of which {len(chosen)} are selected," if len(chosen) != have else ""
        fail(
            path,
            f"as many {name} positions as {name} channels",
            f"{rows} positions and {have} channels{used} in the data {shape.keys[0]}",
        )
    return _Side(have, chosen, np.ascontiguousarray(position_m))
