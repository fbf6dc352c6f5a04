"""Records of array files: rules that place antennas, sides, poses and patterns."""

from __future__ import annotations

from collections.abc import Sequence
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
    made,
    mistake,
    one_of,
)
from clradar.model import AntennaArray, AntennaPattern
from clradar.model.antenna_side import AntennaSide

ALL, CLUSTER = "all", "cluster"  # of `pairs`: each Tx with each Rx, or with those of its own pose
MOST_CLUSTERS = 1024
MOST_ANTENNAS = 20_000  # of one rule: a whole wall of imaging clusters has some thousands

Length = Annotated[Number, Field(gt=0, description="a length above 0, in metres")]
Place = Annotated[Vector, Field(description="[x, y, z] in metres")]
COUNT = f"a whole number from 1 to {MOST_ANTENNAS}"
Count = Annotated[Whole, Field(ge=1, le=MOST_ANTENNAS, description=COUNT)]


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
    n: Count
    center_m: Place = (0.0, 0.0, 0.0)

    def placed_m(self) -> np.ndarray:
        placed = np.zeros((2 * self.n, 3))
        steps = np.linspace(-self.length_m / 2, self.length_m / 2, self.n)
        placed[: self.n, 0] = placed[self.n :, 1] = steps
        middle = [self.n + self.n // 2] if self.n % 2 else []
        return np.delete(placed, middle, axis=0) + np.array(self.center_m)


class Plane(FileRecord):
    """n = [n_x, n_y] antennas on size_m = [width, height] about center_m, row by row."""

    size_m: tuple[Number, Number] = Field(description="[width, height] in metres")
    n: tuple[Count, Count] = Field(description=f"[n_x, n_y], each {COUNT}")
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
        rules = {name: getattr(self, name) for name in Placed.model_fields}
        given = [name for name, rule in rules.items() if rule is not None]
        if len(given) != 1:
            raise mistake(f"one of {', '.join(rules)}", " and ".join(given) or "none")
        rule = rules[given[0]]
        self._at_m = np.array(rule) if self.points_m is not None else rule.placed_m()
        if (columns := self._at_m.shape[1]) != 3:
            raise mistake("rows of three numbers", f"rows of {columns}", key="points_m")
        return self


def _one_is_enough(value: Any) -> Any:
    """The list of one row, or of one number, that stands for all antennas."""
    is_row = isinstance(value, list) and value and not isinstance(value[0], list)
    return [value] if is_row or not isinstance(value, list) else value


ForEach = Annotated[Rows, BeforeValidator(_one_is_enough)]
Levels = Annotated[Numbers, BeforeValidator(lambda v: v if isinstance(v, list) else [v])]


class Antennas(Placed):
    """Antennas of one rule, with a gain and a boresight for all of them or for each."""

    gain: ForEach | None = None
    gain_db: Levels = (0.0,)
    phase_deg: Levels = (0.0,)
    boresight: ForEach | None = None
    _side: AntennaSide = PrivateAttr()

    @model_validator(mode="after")
    def _is_for_each(self) -> Antennas:
        gain, boresight = self._for_each("gain", 2), self._for_each("boresight", 3)
        complex_gain = None if gain is None else gain @ [1.0, 1j]
        if self.model_fields_set & {"gain_db", "phase_deg"}:
            if gain is not None:
                raise mistake("no gain_db and no phase_deg beside it", "both", key="gain")
            phasor = np.exp(1j * np.deg2rad(self._for_each("phase_deg", 1)))
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused
                complex_gain = (10 ** (self._for_each("gain_db", 1) / 20) * phasor)[:, 0]
        self._side = AntennaSide(self._at_m, None, boresight, complex_gain)
        return self

    def _for_each(self, key: str, columns: int) -> Any:
        """Return what is given once or for each of n antennas, shape (n, columns), or None."""
        rows, shape = getattr(self, key), (len(self._at_m), columns)
        if rows is None:
            return None
        rows = np.array(rows) if columns > 1 else np.array(rows)[:, None]
        if rows.shape not in ((1, columns), shape):
            one = f"a row of {columns} numbers" if columns > 1 else "a number"
            got = " of ".join(map(str, rows.shape[: 1 if columns == 1 else 2]))
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


class ArrayFile(FileRecord):
    """What an array file says."""

    name: Text | None = None
    pairs: Annotated[str, one_of(ALL, CLUSTER)] = ALL
    copy_of: Annotated[str, one_of(*KNOWN)] | None = None
    tx: tuple[Antennas, ...] = Field((), description="tables [[tx]]")
    rx: tuple[Antennas, ...] = Field((), description="tables [[rx]]")
    antennas: tuple[Antennas, ...] = Field((), description="tables [[antennas]]")
    pose: tuple[Pose, ...] = Field((), description="tables [[pose]]")
    tx_pattern: Pattern | None = None
    rx_pattern: Pattern | None = None
    _clusters: list[list[AntennaSide]] = PrivateAttr()

    @model_validator(mode="after")
    def _has_both_sides(self) -> ArrayFile:
        sides: list[AntennaSide] = []
        for key in ("tx", "rx"):
            tables, pattern = getattr(self, key) + self.antennas, getattr(self, f"{key}_pattern")
            if self.copy_of is not None and tables:
                raise mistake("no tx, rx, antennas beside it", "both", key="copy_of")
            if self.copy_of is None and not tables:
                raise mistake(f"[[{key}]] or [[antennas]], each with a rule", "none", key=key)
            own = [table._side for table in tables]
            if self.copy_of is not None:
                own = [KNOWN[self.copy_of]().sides[len(sides)]]
            sides.append(_joined(own, pattern and pattern._pattern))
            if sides[-1].boresight is not None and pattern is None:
                raise mistake(f"[{key}_pattern] for its boresight", "none", key=key)
        most = max(len(side.antennas_m) for side in sides)
        places = sum(len(pose._at_m) for pose in self.pose) or 1
        if self.pairs == CLUSTER and places > MOST_CLUSTERS:
            raise mistake(f"at most {MOST_CLUSTERS} clusters", places, key="pose")
        if most * (1 if self.pairs == CLUSTER else places) > MOST_ANTENNAS:
            raise mistake(f"at most {MOST_ANTENNAS} antennas in all", most * places, key="pose")
        self._clusters = [] if self.pose else [sides]
        for pose in self.pose:
            turn = Rotation.from_rotvec(pose.rotation_deg, degrees=True).as_matrix()
            self._clusters += [[_placed(side, turn, at_m) for side in sides] for at_m in pose._at_m]
        if self.pairs == ALL:
            self._clusters = [[_joined(o, o[0].pattern) for o in zip(*self._clusters, strict=True)]]
        return self

    def arrays(self, default_name: str) -> tuple[AntennaArray, ...]:
        """Return the arrays: one, or one for each pose."""
        name, count = self.name or default_name, len(self._clusters)
        crowded = []
        for label, side in zip(("Tx", "Rx"), self._clusters[0], strict=True):
            at_m = side.antennas_m.round(6)  # two antennas are not as close as this
            if (places := len(np.unique(at_m, axis=0))) < len(at_m):
                crowded.append(f"{len(at_m)} {label} at {places} places")
        if crowded:
            warn(
                f"{name}: antennas at the same place all count, {', '.join(crowded)}; are rules "
                "and poses as they are meant?"
            )
        return tuple(
            AntennaArray(
                tx.antennas_m, rx.antennas_m,
                name if count == 1 else f"{name}, cluster {number} of {count}",
                tx.pattern, rx.pattern, tx.gain, rx.gain, tx.boresight, rx.boresight,
            )
            for number, (tx, rx) in enumerate(self._clusters, start=1)
        )  # fmt: skip


def _placed(side: AntennaSide, turn: np.ndarray, at_m: np.ndarray) -> AntennaSide:
    """Turn antennas about the origin, then move them; +z is turned where they have no boresight."""
    axes = side.boresight
    if side.pattern is not None and (axes is not None or not np.allclose(turn[:, 2], [0, 0, 1])):
        axes = side.axes @ turn.T
    return AntennaSide(side.antennas_m @ turn.T + at_m, side.pattern, axes, side.gain)


def _joined(sides: Sequence[AntennaSide], pattern: AntennaPattern | None) -> AntennaSide:
    """All of them in one, with 1 for gains and +z for boresights that only others have."""
    gain = boresight = None
    if any(side.gain is not None for side in sides):
        ones = (np.ones(len(side.antennas_m)) if side.gain is None else side.gain for side in sides)
        gain = np.concatenate([*ones])
    if any(side.boresight is not None for side in sides):
        boresight = np.concatenate([side.axes for side in sides])
    at_m = np.concatenate([side.antennas_m for side in sides])
    return AntennaSide(at_m, pattern, boresight, gain)
