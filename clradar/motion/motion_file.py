"""Motion files: how bodies and hands move, and when the imager records; docs/movement.md."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from clradar.errors import MeasurementError, ModelError
from clradar.files.failures import shown

if TYPE_CHECKING:
    from clradar.motion.motion_record import Motion


def read_motion(path: str | os.PathLike[str]) -> Motion:
    """Return what a motion file says; docs/movement.md has the format.

    Examples
    --------
    >>> from pathlib import Path
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
    return found
