"""Motion files: how bodies and hands move, and when the imager records; docs/movement.md."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clradar.errors import MeasurementError, ModelError
from clradar.files.failures import fail, read_bytes, reading, shown
from clradar.files.limits import MAX_TIMES_BYTES

if TYPE_CHECKING:
    from clradar.motion.motion_record import Motion


def read_motion(path: str | os.PathLike[str]) -> Motion:
    """Return what a motion file says; docs/movement.md has the format.

    Examples
    --------
    >>> from pathlib import Path
    >>> import clradar
    >>> text = '''
    ... [[body]]
    ... velocity_mm_per_s = [0, 0, 500]
    ... '''
    >>> _ = Path("away.toml").write_text(text)
    >>> clradar.read_motion("away.toml").bodies[""].at(0.1)[:3, 3].tolist()
    [0.0, 0.0, 0.05]
    """
    from clradar.files.records import read_record
    from clradar.motion.motion_record import Motion

    path = Path(path)
    found = read_record(path, Motion, "a motion (a TOML file, see docs/movement.md)")
    found.files.append(path)
    for i, hand in enumerate(found.hand):
        try:
            found.hands.append(hand.moving(path.parent, found.files))
        except ModelError as error:
            raise MeasurementError(f"{shown(path)}: hand[{i}]: {error}") from error
    if found.sweep.table_us is not None:
        found.files.append(path.parent / found.sweep.table_us)
        found.times_s.append(_times_s(found.files[-1]))
    return found


def _times_s(path: Path) -> np.ndarray:
    """Times of a table in microseconds, in seconds, shape (rows, columns)."""
    expected = "a table of times in microseconds, numbers between commas"
    content = read_bytes(path, expected, MAX_TIMES_BYTES)
    with reading(path, expected):
        lines = content.decode("utf-8-sig").splitlines()
        rows = [[float(text) for text in line.split(",")] for line in lines if line.strip()]
    if not rows or len({len(row) for row in rows}) > 1:
        fail(path, "rows of numbers, all as long as each other", "rows of different lengths")
    times_us = np.array(rows)
    if not np.isfinite(times_us).all() or np.abs(times_us).max() > 1e12:
        fail(path, "finite times in microseconds", "others")
    return times_us / 1e6
