"""Records of array files: rules that place antennas, sides, poses and patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator
from scipy.spatial.transform import Rotation

from clradar.arrays.instruments import KNOWN
from clradar.errors import warn
from clradar.files.records import (
    FileRecord,
    Number,
    Numbers,
    Rows,
    Text,
    Vector,
    Whole,
    is_number,
    made,
    mistake,
    number_tuple,
    numbers,
    one_of,
    row_tuple,
)
from clradar.model import AntennaArray, AntennaPattern

ALL, CLUSTER = "all", "cluster"
"""Values of `pairs`: every Tx with every Rx, or with those of its own pose."""

MOST_CLUSTERS = 1024
MOST_ANTENNAS = 20_000
"""Of one rule: a whole wall of imaging clusters has some thousands."""

SAME_PLACE_DIGITS = 6
"""Of metres: two antennas are not as close as this."""

Place = Annotated[Vector, Field(description="[x, y, z] in metres")]
Length = Annotated[Number, Field(gt=0, description="a length above 0, in metres")]
_WHOLE = f"a whole number from {{}} to {MOST_ANTENNAS}"
Count = Annotated[Whole, Field(ge=1, le=MOST_ANTENNAS, description=_WHOLE.format(1))]


class Line(FileRecord):
    """`n` antennas from first_m to last_m, both included."""

    first_m: Place
    last_m: Place
    n: Count

    def placed_m(self) -> np.ndarray:
        return np.linspace(self.first_m, self.last_m, self.n)


class Cross(FileRecord):
    """A line of `n` along x and one along y, both of length_m about center_m; one middle."""

    length_m: Length
    n: Annotated[Whole, Field(ge=2, le=MOST_ANTENNAS, description=_WHOLE.format(2))]
    center_m: Place = (0.0, 0.0, 0.0)

    def placed_m(self) -> np.ndarray:
        steps = np.linspace(-self.length_m / 2, self.length_m / 2, self.n)
        placed = np.zeros((2 * self.n, 3))
        placed[: self.n, 0] = placed[self.n :, 1] = steps
        middle = [self.n + self.n // 2] if self.n % 2 else []
        return np.delete(placed, middle, axis=0) + np.array(self.center_m)


class Plane(FileRecord):
    """n = [n_x, n_y] antennas on size_m = [width, height] about center_m, row by row."""

    size_m: Annotated[tuple[float, ...], numbers(2), Field(description="[width, height] in metres")]
    n: tuple[Count, Count] = Field(description=f"[n_x, n_y], each {_WHOLE.format(1)}")
    center_m: Place = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _are_not_too_many(self) -> Plane:
        if self.n[0] * self.n[1] > MOST_ANTENNAS:
            raise mistake(f"at most {MOST_ANTENNAS} antennas", self.n[0] * self.n[1], key="n")
        return self

    def placed_m(self) -> np.ndarray:
        x, y = (
            np.linspace(-size / 2, size / 2, count) if count > 1 else np.zeros(1)
            for size, count in zip(self.size_m, self.n, strict=True)
        )
        return np.stack(np.meshgrid(x, y, 0.0), axis=-1).reshape(-1, 3) + np.array(self.center_m)


class Ring(FileRecord):
    """`n` antennas on a circle about center_m; the first at first_deg from x towards y."""

    radius_m: Length
    n: Count
    first_deg: Number = 0.0
    center_m: Place = (0.0, 0.0, 0.0)

    def placed_m(self) -> np.ndarray:
        angle = np.deg2rad(self.first_deg) + 2 * np.pi * np.arange(self.n) / self.n
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(self.n)], axis=1)
        return self.radius_m * circle + np.array(self.center_m)


class Placed(FileRecord):
    """A table with one rule, and the positions (n, 3) that it gives."""

    points_m: Rows | None = None
    line: Line | None = None
    cross: Cross | None = None
    plane: Plane | None = None
    ring: Ring | None = None
    _at_m: np.ndarray = PrivateAttr()

    @model_validator(mode="after")
    def _has_one_rule(self) -> Placed:
        names = tuple(Placed.model_fields)
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) != 1:
            raise mistake(f"one of {', '.join(names)}", " and ".join(given) or "none")
        rule = getattr(self, given[0])
        if self.points_m is not None and len(self.points_m[0]) != 3:
            got = f"rows of {len(self.points_m[0])}"
            raise mistake("rows of three numbers", got, key="points_m")
        self._at_m = np.array(rule) if self.points_m is not None else rule.placed_m()
        return self


def _once_or_for_each(value: Any) -> Any:
    if isinstance(value, list):
        is_row = not any(isinstance(row, list) for row in value)
        return number_tuple(value, "a list of numbers", ()) if is_row else row_tuple(value)
    if not is_number(value):
        raise mistake("a finite number, or a list of one for each antenna")
    return value


ForEach = Annotated[Any, BeforeValidator(_once_or_for_each)]


class Antennas(Placed):
    """Antennas of one rule, with a gain and a boresight for all of them or for each."""

    gain: ForEach = None
    gain_db: ForEach = None
    phase_deg: ForEach = None
    boresight: ForEach = None
    _side: Side = PrivateAttr()

    @model_validator(mode="after")
    def _is_for_each(self) -> Antennas:
        gain, boresight = self._for_each("gain", 2), self._for_each("boresight", 3)
        level_db, phase_deg = self._for_each("gain_db"), self._for_each("phase_deg")
        complex_gain = None if gain is None else gain @ [1.0, 1j]
        if level_db is not None or phase_deg is not None:
            if gain is not None:
                raise mistake("no gain_db and no phase_deg beside it", "both", key="gain")
            level_db, phase_deg = (0.0 if v is None else v for v in (level_db, phase_deg))
            turned = np.exp(1j * np.deg2rad(phase_deg))
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused
                complex_gain = np.ones(len(self._at_m)) * 10 ** (level_db / 20) * turned
        self._side = Side(self._at_m, complex_gain, boresight)
        return self

    def _for_each(self, key: str, *columns: int) -> Any:
        """Return what is given once or for each of n antennas, shape (n, *columns), or None."""
        value, shape = getattr(self, key), (len(self._at_m), *columns)
        if value is None:
            return None
        rows = np.array(value, np.float64)
        if rows.shape not in (columns, shape):
            one = f"one row of {columns[0]} numbers" if columns else "one number"
            got = " of ".join(map(str, rows.shape))
            raise mistake(f"{one}, or one for each of {shape[0]} antennas", got, key=key)
        return np.array(np.broadcast_to(rows, shape))


class Pose(Placed):
    """Copies of all antennas at some positions, turned."""

    rotation_deg: Vector = (0.0, 0.0, 0.0)


class Pattern(FileRecord):
    """The fields of `AntennaPattern`."""

    gain_dbi: Number = 0.0
    exponent: Number = 0.0
    angle_deg: Numbers | None = None
    field: Numbers | None = None
    _pattern: AntennaPattern = PrivateAttr()

    @model_validator(mode="after")
    def _is_a_pattern(self) -> Pattern:
        self._pattern = made(AntennaPattern, **dict(self))
        return self


_TABLES = "tables [[{}]]"


class ArrayFile(FileRecord):
    """What an array file says."""

    name: Text | None = None
    pairs: Annotated[str, one_of(ALL, CLUSTER)] = ALL
    copy_of: Annotated[str, one_of(*KNOWN)] | None = None
    tx: tuple[Antennas, ...] = Field((), description=_TABLES.format("tx"))
    rx: tuple[Antennas, ...] = Field((), description=_TABLES.format("rx"))
    antennas: tuple[Antennas, ...] = Field((), description=_TABLES.format("antennas"))
    pose: tuple[Pose, ...] = Field((), description=_TABLES.format("pose"))
    tx_pattern: Pattern | None = None
    rx_pattern: Pattern | None = None

    @model_validator(mode="after")
    def _has_both_sides(self) -> ArrayFile:
        if self.copy_of is not None:
            if self.tx or self.rx or self.antennas:
                raise mistake("no tx, rx, antennas beside it", "both", key="copy_of")
        else:
            for key in ("tx", "rx"):
                if not getattr(self, key) + self.antennas:
                    expected = f"[[{key}]] or [[antennas]], each with a rule"
                    raise mistake(expected, "none", key=key)
        most = max(len(side.at_m) for side in self._sides())
        places = len(self._places())
        if self.pairs == CLUSTER and places > MOST_CLUSTERS:
            raise mistake(f"at most {MOST_CLUSTERS} clusters", places, key="pose")
        if most * (1 if self.pairs == CLUSTER else places) > MOST_ANTENNAS:
            raise mistake(f"at most {MOST_ANTENNAS} antennas in all", most * places, key="pose")
        for key, side in zip(("tx", "rx"), self._sides(), strict=True):
            if side.boresight is not None and getattr(self, f"{key}_pattern") is None:
                raise mistake(f"[{key}_pattern] for its boresight", "none", key=key)
        return self

    def _sides(self) -> tuple[Side, Side]:
        """Tx and Rx without poses."""
        if self.copy_of is not None:
            copied = KNOWN[self.copy_of]()
            return Side(copied.tx_m), Side(copied.rx_m)
        tx, rx = ([own._side for own in side + self.antennas] for side in (self.tx, self.rx))
        return Side.joined(tx), Side.joined(rx)

    def _places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Rotation (3, 3) and position (3,), metres, of each copy of all antennas."""
        places = []
        for pose in self.pose:
            turn = Rotation.from_rotvec(pose.rotation_deg, degrees=True).as_matrix()
            places += [(turn, at_m) for at_m in pose._at_m]
        return places or [(np.eye(3), np.zeros(3))]

    def arrays(self, default_name: str) -> tuple[AntennaArray, ...]:
        """Return the arrays: one, or one for each pose."""
        name = self.name or default_name
        placed = [[side.placed(*place) for side in self._sides()] for place in self._places()]
        if self.pairs == ALL:
            placed = [[Side.joined(own) for own in zip(*placed, strict=True)]]
        _warn_of_same_places(name, *placed[0])
        lobes: Any = [own and own._pattern for own in (self.tx_pattern, self.rx_pattern)]
        names = [name]
        if len(placed) > 1:
            names = [f"{name}, cluster {i} of {len(placed)}" for i in range(1, len(placed) + 1)]
        return tuple(
            AntennaArray(
                tx.at_m, rx.at_m, own, lobes[0], lobes[1], tx.gain, rx.gain,
                lobes[0] and tx.boresight, lobes[1] and rx.boresight,
            )
            for own, (tx, rx) in zip(names, placed, strict=True)
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """Antennas of one side: positions (n, 3), metres, gains (n,) and boresights (n, 3) or None."""

    at_m: np.ndarray
    gain: np.ndarray | None = None
    boresight: np.ndarray | None = None

    def placed(self, rotation: np.ndarray, at_m: np.ndarray) -> Side:
        """Turned about the origin, then moved; +z is turned where they have no boresight."""
        turned = self.boresight
        if turned is not None or not np.allclose(rotation[:, 2], [0.0, 0.0, 1.0]):
            turned = (_along_z(len(self.at_m)) if turned is None else turned) @ rotation.T
        return Side(self.at_m @ rotation.T + at_m, self.gain, turned)

    @classmethod
    def joined(cls, parts: Sequence[Side]) -> Side:
        """All of them in one, with 1 for gains and +z for boresights that only others have."""
        if len(parts) == 1:
            return parts[0]
        ones = [np.ones(len(part.at_m)) if part.gain is None else part.gain for part in parts]
        axes = [_along_z(len(p.at_m)) if p.boresight is None else p.boresight for p in parts]
        gain = None if all(p.gain is None for p in parts) else np.concatenate(ones)
        boresight = None if all(p.boresight is None for p in parts) else np.concatenate(axes)
        return cls(np.concatenate([part.at_m for part in parts]), gain, boresight)


def _along_z(count: int) -> np.ndarray:
    return np.tile([0.0, 0.0, 1.0], (count, 1))


def _warn_of_same_places(name: str, tx: Side, rx: Side) -> None:
    found = []
    for label, side in (("Tx", tx), ("Rx", rx)):
        places = len(np.unique(side.at_m.round(SAME_PLACE_DIGITS), axis=0))
        if places < len(side.at_m):
            found.append(f"{len(side.at_m)} {label} at {places} places")
    if found:
        warn(
            f"{name}: antennas at the same place all count, {', '.join(found)}; are rules and "
            "poses as they are meant?"
        )
