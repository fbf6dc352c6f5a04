"""Files of antenna arrays: TOML, positions or rules that place them; ``docs/arrays.md``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from clradar.arrays.instruments import KNOWN
from clradar.arrays.position_rules import MOST_ANTENNAS, positions_of
from clradar.errors import ModelError
from clradar.files.table import StrictTable
from clradar.files.toml_file import read_toml
from clradar.model import AntennaArray, AntennaPattern

_EXPECTED = "an antenna array (a TOML file, see docs/arrays.md)"
_BOTH = "antennas"
_SIDES = ("tx", "rx", _BOTH)


def read_array(path: str | os.PathLike[str]) -> AntennaArray:
    """Return the array of a TOML file.

    ``[[tx]]``, ``[[rx]]`` and ``[[antennas]]`` (which transmit and receive) each have one rule:
    ``points_m``, ``line``, ``cross``, ``plane`` or ``ring``; or ``copy_of`` names a known array.
    ``[[pose]]`` (a rule, and ``rotation_deg``) places a copy of all of them. ``[tx_pattern]`` and
    ``[rx_pattern]`` are the fields of `clradar.AntennaPattern`.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    MeasurementError
        Missing, too large, not TOML, an unknown key, an invalid value; patterns together with
        poses that turn them. The message names the file, the key, what was expected and found.

    Examples
    --------
    Twelve transmitters along x and sixteen receivers along y.

    >>> from pathlib import Path
    >>> import clradar
    >>> rules = '''
    ... [[tx]]
    ... line = { first_m = [-0.0275, 0, 0], last_m = [0.0275, 0, 0], n = 12 }
    ... [[rx]]
    ... line = { first_m = [0, -0.0375, 0], last_m = [0, 0.0375, 0], n = 16 }
    ... '''
    >>> _ = Path("cross60.toml").write_text(rules)
    >>> array = clradar.arrays.read_array("cross60.toml")
    >>> array.name, array.n_tx, array.n_rx
    ('cross60', 12, 16)
    """
    path = Path(path)
    table = StrictTable(str(path), "", read_toml(path, _EXPECTED))
    name = table.text("name") or path.stem
    tx_m, rx_m = _antennas(table)
    copies = [_pose(own) for own in table.tables("pose")] or [(np.zeros((1, 3)), np.eye(3))]
    tx_pattern, rx_pattern = (_pattern(table, side) for side in ("tx_pattern", "rx_pattern"))
    table.done([*_SIDES, "pose", "copy_of"])
    patterned = tx_pattern is not None or rx_pattern is not None
    if patterned and any(not _keeps_z(turn) for _, turn in copies):
        table.fail(
            "pose", "rotations about z beside a pattern, which is about +z", "another rotation"
        )
    placed_tx_m, placed_rx_m = (_placed(table, side_m, copies) for side_m in (tx_m, rx_m))
    try:
        return AntennaArray(placed_tx_m, placed_rx_m, name, tx_pattern, rx_pattern)
    except ModelError as error:
        table.fail_with(str(error))


def _antennas(table: StrictTable) -> tuple[np.ndarray, np.ndarray]:
    """Positions of Tx and Rx without poses."""
    known = table.one_of("copy_of", None, tuple(KNOWN))
    if known is not None:
        if any(table.has(side) for side in _SIDES):
            table.fail("copy_of", f"no {', '.join(_SIDES)} beside it", "both")
        copied = KNOWN[known]()
        return copied.tx_m, copied.rx_m
    sides: dict[str, list[np.ndarray]] = {}
    for side in _SIDES:
        sides[side] = []
        for own in table.tables(side):
            sides[side].append(positions_of(own))
            own.done()
    both = sides[_BOTH]
    for side in ("tx", "rx"):
        if not sides[side] + both:
            table.fail(side, f"[[{side}]] or [[{_BOTH}]], each with a rule", "none")
    return np.concatenate(sides["tx"] + both), np.concatenate(sides["rx"] + both)


def _pose(table: StrictTable) -> tuple[np.ndarray, np.ndarray]:
    """Positions of copies, shape (n, 3), metres, and their rotation, shape (3, 3)."""
    from scipy.spatial.transform import Rotation

    vector_deg = table.numbers("rotation_deg", 3) or (0.0, 0.0, 0.0)
    placed = positions_of(table)
    table.done()
    return placed, Rotation.from_rotvec(vector_deg, degrees=True).as_matrix()


def _keeps_z(rotation: np.ndarray) -> bool:
    return bool(np.allclose(rotation[:, 2], [0.0, 0.0, 1.0]))


def _placed(
    table: StrictTable, antennas_m: np.ndarray, copies: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """The antennas of every pose, pose by pose."""
    count = len(antennas_m) * sum(len(at_m) for at_m, _ in copies)
    if count > MOST_ANTENNAS:
        table.fail("pose", f"at most {MOST_ANTENNAS} antennas in all", f"{count}")
    turned = [(at_m, antennas_m @ rotation.T) for at_m, rotation in copies]
    return np.concatenate([own + at for at_m, own in turned for at in at_m])


def _pattern(table: StrictTable, side: str) -> AntennaPattern | None:
    if not table.has(side):
        return None
    own = table.table(side)
    fields: dict[str, Any] = {key: own.number(key) for key in ("gain_dbi", "exponent")}
    fields |= {key: own.numbers(key) for key in ("angle_deg", "field")}
    own.done()
    try:
        return AntennaPattern(**{key: v for key, v in fields.items() if v is not None})
    except ModelError as error:
        own.fail_with(str(error).removeprefix("AntennaPattern"))
