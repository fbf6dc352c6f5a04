"""Files of antenna arrays: TOML, positions or rules that place them; ``docs/arrays.md``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clradar.arrays.instruments import KNOWN
from clradar.arrays.position_rules import MOST_ANTENNAS, positions_of
from clradar.errors import ModelError, warn
from clradar.files.limits import MAX_ARRAY_FILE_BYTES
from clradar.files.table import StrictTable
from clradar.files.toml_file import read_toml, toml_document, toml_string
from clradar.model import AntennaArray, AntennaPattern

_EXPECTED = "an antenna array (a TOML file, see docs/arrays.md)"
_BOTH = "antennas"
_SIDES = ("tx", "rx", _BOTH)
ALL, CLUSTER = "all", "cluster"
"""Values of `pairs`: every Tx with every Rx, or with those of its own pose."""

MOST_CLUSTERS = 1024

SAME_PLACE_DIGITS = 6
"""Of metres: two antennas are not as close as this."""


def read_array(path: str | os.PathLike[str]) -> AntennaArray:
    """Return the array of a TOML file.

    ``[[tx]]``, ``[[rx]]`` and ``[[antennas]]`` (which transmit and receive) each have one rule:
    ``points_m``, ``line``, ``cross``, ``plane`` or ``ring``; or ``copy_of`` names a known array.
    Beside a rule are ``gain_db``, ``phase_deg`` and ``boresight`` of these antennas. ``[[pose]]``
    (a rule, and ``rotation_deg``) places a copy of all of them. ``[tx_pattern]`` and
    ``[rx_pattern]`` are the fields of `clradar.AntennaPattern`.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    MeasurementError
        Missing, too large, not TOML, an unknown key, an invalid value; a file with
        ``pairs = "cluster"`` and several poses, which `read_clusters` reads. The message names the
        file, the key, what was expected and found.

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
    return array_of(_content(path), str(path), path.stem)


def read_clusters(path: str | os.PathLike[str]) -> tuple[AntennaArray, ...]:
    """Return the arrays of a TOML file, one for each pose where it has ``pairs = "cluster"``.

    A Tx then is measured with the Rx of its own pose only, so that each pose has a capture of its
    own; `clradar.backproject` makes one image of them all. Without that key it is one array.

    Raises
    ------
    MeasurementError
        As `read_array`; more than 1024 clusters.

    Examples
    --------
    >>> from pathlib import Path
    >>> import clradar
    >>> rules = '''
    ... copy_of = "qar50"
    ... pairs = "cluster"
    ... [[pose]]
    ... line = { first_m = [-0.1, 0, 0], last_m = [0.1, 0, 0], n = 2 }
    ... '''
    >>> _ = Path("two.toml").write_text(rules)
    >>> for array in clradar.arrays.read_clusters("two.toml"):
    ...     print(f"{array.name}: {array.n_tx} Tx about x = {array.tx_m[:, 0].mean():.1f} m")
    two, cluster 1 of 2: 94 Tx about x = -0.1 m
    two, cluster 2 of 2: 94 Tx about x = 0.1 m
    """
    path = Path(path)
    return _arrays(StrictTable(str(path), "", _content(path)), path.stem)


def array_of(content: Mapping[str, Any], source: str, name: str) -> AntennaArray:
    """Return the array of a table in the vocabulary of files; `source` is named in messages."""
    table = StrictTable(source, "", dict(content))
    found = _arrays(table, name)
    if len(found) > 1:
        words = f"{len(found)} clusters, which simulate and image take"
        table.fail("pairs", f'one array ("{ALL}", or a single pose)', words)
    return found[0]


def array_record(array: AntennaArray) -> dict[str, Any]:
    """Return a table that `array_of` makes the same array of, to the bit."""
    record: dict[str, Any] = {"name": array.name}
    for name, side in zip(("tx", "rx"), array.sides, strict=True):
        own: dict[str, Any] = {"points_m": side.antennas_m.tolist()}
        if side.gain is not None:
            own["gain"] = np.stack([side.gain.real, side.gain.imag], axis=1).tolist()
        if side.boresight is not None:
            own["boresight"] = side.boresight.tolist()
        record[name] = [own]
    for name, side in zip(("tx_pattern", "rx_pattern"), array.sides, strict=True):
        pattern = side.pattern
        if pattern is None:
            continue
        record[name] = {"gain_dbi": pattern.gain_dbi, "exponent": pattern.exponent}
        if pattern.angle_deg is not None and pattern.field is not None:
            record[name] |= {
                "angle_deg": pattern.angle_deg.tolist(), "field": pattern.field.tolist()
            }  # fmt: skip
    return record


def array_text(array: AntennaArray) -> str:
    """Return the text of a file that `read_array` makes the same array of, to the bit."""
    tables = {**array_record(array)}
    lines = [f"name = {toml_string(tables.pop('name'))}"]
    for name, table in tables.items():
        own, brackets = (table[0], "[[{}]]") if isinstance(table, list) else (table, "[{}]")
        lines += ["", brackets.format(name), toml_document(own).strip()]
    return "\n".join(lines) + "\n"


def _content(path: Path) -> dict[str, Any]:
    return read_toml(path, _EXPECTED, limit=MAX_ARRAY_FILE_BYTES)


@dataclass(frozen=True, slots=True, eq=False)
class _Antennas:
    """Antennas of one side: positions (n, 3), metres, gains (n,) and boresights (n, 3) or None."""

    at_m: np.ndarray
    gain: np.ndarray | None = None
    boresight: np.ndarray | None = None

    def placed(self, rotation: np.ndarray, at_m: np.ndarray) -> _Antennas:
        """Turned about the origin, then moved; +z is turned where they have no boresight."""
        turned = self.boresight
        if turned is not None or not np.allclose(rotation[:, 2], [0.0, 0.0, 1.0]):
            turned = (_along_z(len(self.at_m)) if turned is None else turned) @ rotation.T
        return _Antennas(self.at_m @ rotation.T + at_m, self.gain, turned)

    @classmethod
    def joined(cls, parts: Sequence[_Antennas]) -> _Antennas:
        """All of them in one, with 1 for gains and +z for boresights that only others have."""
        if len(parts) == 1:
            return parts[0]
        gain = boresight = None
        if any(part.gain is not None for part in parts):
            gain = np.concatenate(
                [np.ones(len(p.at_m)) if p.gain is None else p.gain for p in parts]
            )
        if any(part.boresight is not None for part in parts):
            boresight = np.concatenate(
                [_along_z(len(p.at_m)) if p.boresight is None else p.boresight for p in parts]
            )
        return cls(np.concatenate([part.at_m for part in parts]), gain, boresight)


def _along_z(count: int) -> np.ndarray:
    return np.tile([0.0, 0.0, 1.0], (count, 1))


def _arrays(table: StrictTable, default_name: str) -> tuple[AntennaArray, ...]:
    """The arrays of a file: one, or one for each pose."""
    name = table.text("name") or default_name
    pairs = table.one_of("pairs", ALL, (ALL, CLUSTER))
    sides = _antennas(table)
    copies = [_pose(own) for own in table.tables("pose")]
    places = [(turn, at) for turn, placed_m in copies for at in placed_m]
    places = places or [(np.eye(3), np.zeros(3))]
    patterns = [_pattern(table, side) for side in ("tx_pattern", "rx_pattern")]
    table.done([*_SIDES, "pose", "copy_of", "tx_pattern", "rx_pattern"])
    most = max(len(side.at_m) for side in sides)
    if pairs == CLUSTER and len(places) > MOST_CLUSTERS:
        table.fail("pose", f"at most {MOST_CLUSTERS} clusters", f"{len(places)}")
    if most * (1 if pairs == CLUSTER else len(places)) > MOST_ANTENNAS:
        table.fail("pose", f"at most {MOST_ANTENNAS} antennas in all", f"{most * len(places)}")
    for key, side, pattern in zip(("tx", "rx"), sides, patterns, strict=True):
        if side.boresight is not None and pattern is None:
            table.fail(key, f"[{key}_pattern] for its boresight", "none")
    placed = [[side.placed(turn, at) for side in sides] for turn, at in places]
    if pairs == ALL:
        placed = [[_Antennas.joined(own) for own in zip(*placed, strict=True)]]
    _warn_of_same_places(name, *placed[0])
    found = []
    for i, (tx, rx) in enumerate(placed, start=1):
        own = name if len(placed) == 1 else f"{name}, cluster {i} of {len(placed)}"
        found.append(_array(table, own, (tx, rx), patterns))
    return tuple(found)


def _warn_of_same_places(name: str, tx: _Antennas, rx: _Antennas) -> None:
    found = []
    for side, at_m in (("Tx", tx.at_m), ("Rx", rx.at_m)):
        places = len(np.unique(at_m.round(SAME_PLACE_DIGITS), axis=0))
        if places < len(at_m):
            found.append(f"{len(at_m)} {side} at {places} places")
    if found:
        words = ", ".join(found)
        warn(
            f"{name}: antennas at the same place all count, {words}; are rules and poses as they "
            "are meant?"
        )


def _array(
    table: StrictTable,
    name: str,
    sides: tuple[_Antennas, _Antennas],
    patterns: Sequence[AntennaPattern | None],
) -> AntennaArray:
    (tx, rx), (tx_pattern, rx_pattern) = sides, patterns
    try:
        return AntennaArray(
            tx.at_m, rx.at_m, name, tx_pattern, rx_pattern, tx.gain, rx.gain,
            None if tx_pattern is None else tx.boresight,
            None if rx_pattern is None else rx.boresight,
        )  # fmt: skip
    except ModelError as error:
        table.fail_with(str(error))


def _antennas(table: StrictTable) -> tuple[_Antennas, _Antennas]:
    """Tx and Rx without poses."""
    known = table.one_of("copy_of", None, tuple(KNOWN))
    if known is not None:
        if any(table.has(side) for side in _SIDES):
            table.fail("copy_of", f"no {', '.join(_SIDES)} beside it", "both")
        copied = KNOWN[known]()
        return _Antennas(copied.tx_m), _Antennas(copied.rx_m)
    sides: dict[str, list[_Antennas]] = {}
    for side in _SIDES:
        sides[side] = [_of_table(own) for own in table.tables(side)]
    both = sides[_BOTH]
    for side in ("tx", "rx"):
        if not sides[side] + both:
            table.fail(side, f"[[{side}]] or [[{_BOTH}]], each with a rule", "none")
    return _Antennas.joined(sides["tx"] + both), _Antennas.joined(sides["rx"] + both)


def _of_table(table: StrictTable) -> _Antennas:
    """The antennas of one rule, with their gains and boresights."""
    at_m = positions_of(table)
    gain, count = None, len(at_m)
    if table.has("gain"):
        if table.has("gain_db") or table.has("phase_deg"):
            table.fail("gain", "no gain_db and no phase_deg beside it", "both")
        gain = _rows(table, "gain", 2, count) @ [1.0, 1j]
    elif table.has("gain_db") or table.has("phase_deg"):
        level_db, phase_deg = (_each(table, key, count) for key in ("gain_db", "phase_deg"))
        gain = 10 ** (level_db / 20) * np.exp(1j * np.deg2rad(phase_deg))
    boresight = _rows(table, "boresight", 3, count) if table.has("boresight") else None
    table.done()
    return _Antennas(at_m, gain, boresight)


def _each(table: StrictTable, key: str, count: int) -> np.ndarray:
    """One number for all antennas of a rule, or one for each; 0 where it is not there."""
    if not isinstance(table.raw(key, 0.0), list):
        return np.full(count, table.number(key) or 0.0)
    values = table.numbers(key) or ()
    if len(values) != count:
        table.fail(key, f"one number, or one for each of {count} antennas", f"{len(values)}")
    return np.array(values)


def _rows(table: StrictTable, key: str, columns: int, count: int) -> np.ndarray:
    """One row of numbers for all antennas of a rule, or one for each, shape (count, columns)."""
    value = table.raw(key)
    if isinstance(value, list) and not any(isinstance(row, list) for row in value):
        return np.tile(table.numbers(key, columns) or (), (count, 1))
    rows = table.rows(key) or ()
    if len(rows) != count or len(rows[0]) != columns:
        expected = f"one row of {columns} numbers for each of {count} antennas, or one for all"
        table.fail(key, expected, f"{len(rows)} of {len(rows[0])}")
    return np.array(rows)


def _pose(table: StrictTable) -> tuple[np.ndarray, np.ndarray]:
    """Rotation of copies, shape (3, 3), and their positions, shape (n, 3), metres."""
    from scipy.spatial.transform import Rotation

    vector_deg = table.numbers("rotation_deg", 3) or (0.0, 0.0, 0.0)
    placed = positions_of(table)
    table.done()
    return Rotation.from_rotvec(vector_deg, degrees=True).as_matrix(), placed


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
