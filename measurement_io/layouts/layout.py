"""Layouts as frozen records: keys, axes, units and conventions of the files of one lab.

docs/layouts.md explains all settings; the fields have their names.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from clradar.constants import MAX_FREQUENCIES
from clradar.files.failures import shown
from clradar.files.limits import MAX_CHANNELS
from clradar.files.records import (
    FileRecord,
    NumberOrText,
    Numbers,
    Text,
    Vector,
    Whole,
    checked,
    is_whole,
    mistake,
    one_of,
    read_record,
    text,
)

FREQUENCY_UNITS_HZ = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9}
"""Known units of frequency and what one of them is in hertz."""

LENGTH_UNITS_PER_M = {"m": 1.0, "cm": 1e2, "mm": 1e3, "um": 1e6}
"""Known units of length and how many make a metre: 70.5 / 1000 is 0.0705, 70.5 * 0.001 is not."""

KNOWN_ARRAYS = ("qar50",)
SIGNAL_AXES = ("tx", "rx", "pair", "freq", "frame", "part", "one")
"""Names of axes with a meaning: antennas, pairs of them, frequency, the frame to choose, the two
parts of a complex number, and an axis of length one."""

COORDINATES = ("x", "y", "z")
KeyName = Annotated[str, text("a key of the file, as text")]

_EXPECTED = "a layout (a TOML file, see docs/layouts.md)"
_AXES = 'a list of axes, such as ["tx", "rx", "freq"]'
_SIGN = "-1 for exp(-j 2 pi f d / c) or +1 for exp(+j ...)"
_SLICE = re.compile(r"(-?[0-9]{1,9})?:(-?[0-9]{1,9})?(:-?0{0,8}[1-9][0-9]{0,8})?")
_SOURCES = "one of 'key', 'file', 'array', or keys 'x', 'y' and 'z'"
_KEYS = "'key', or 'real' and 'imag'"
_PAIRS = '"tx_major" or "rx_major", for an axis "pair" and for nothing else'
_SELECT = 'a slice "start:stop" (stop excluded) or a list of channels from 0'


def _given(**values: object) -> str:
    names = [f"'{name}'" for name, value in values.items() if value is not None]
    return " and ".join(names) or "none of them"


class DataLayout(FileRecord):
    """Where the signal is.

    A `phase_sign` of -1: a path of length d contributes exp(-j 2 pi f d / c), as here; +1: its
    conjugate. With `pair_order` "tx_major" all Rx of the first Tx come first.
    """

    key: KeyName | None = None
    real: KeyName | None = None
    imag: KeyName | None = None
    axes: tuple[Text, ...] = Field(description=_AXES, min_length=1)
    pick: dict[str, Annotated[Whole, Field(ge=0, lt=2**31)]] = Field(default_factory=dict)
    pair_order: Annotated[str | None, one_of("tx_major", "rx_major")] = None
    phase_sign: Annotated[int, checked(_SIGN, lambda v: is_whole(v) and abs(v) == 1)] = -1

    @property
    def keys(self) -> list[str]:
        """The one of complex numbers, or those of the real and the imaginary part."""
        return [name for name in (self.key, self.real, self.imag) if name is not None]

    @model_validator(mode="after")
    def _fits_together(self) -> DataLayout:
        key, real, imag, axes = self.key, self.real, self.imag, self.axes
        given = _given(key=key, real=real, imag=imag)
        known = ", ".join(f'"{name}"' for name in SIGNAL_AXES)
        unknown = [axis for axis in axes if axis not in (*SIGNAL_AXES, *self.pick)]
        twice = [axis for axis in axes if axis != "one" and axes.count(axis) > 1]
        idle = [name for name in self.pick if name in SIGNAL_AXES or name not in axes]
        pair, order = "pair" in axes, self.pair_order
        _refuse(
            ((key is None) == (real is None and imag is None), "key", _KEYS, given),
            ((real is None) != (imag is None), "key", _KEYS, given),
            (unknown, "axes", f"{known}, or a name with an index in [data.pick]", unknown),
            (twice, "axes", "every axis once", twice),
            (idle, "pick", "axes that are in 'axes' and have no meaning of their own", idle),
            (pair and {"tx", "rx"} & {*axes}, "axes", '"pair", or "tx" and "rx"', list(axes)),
            ("part" in axes and key is None, "axes", "\"part\" only with one 'key'", list(axes)),
            (pair != (order is not None), "pair_order", _PAIRS, order or "none"),
        )
        return self


def _refuse(*checks: tuple[object, str, str, object]) -> None:
    """Raise the first mistake: whether it is one, key, expected, got."""
    for wrong, key, expected, got in checks:
        if wrong:
            raise mistake(expected, got, key=key)


def _select(value: Any) -> Any:
    if isinstance(value, str):
        if not _SLICE.fullmatch(value):
            raise mistake(_SELECT)
        return value
    if not isinstance(value, list) or not value or not all(is_whole(v) and v >= 0 for v in value):
        raise mistake(_SELECT)
    if len(set(value)) != len(value) or len(value) > MAX_CHANNELS:
        raise mistake("every channel once", "repeated channels")
    return tuple(value)


class AntennaLayout(FileRecord):
    """The Tx or the Rx side.

    Exactly one of `key`, `x` with `y` and `z`, `file`, `array` gives the positions.
    """

    channels: Annotated[Whole, Field(ge=1, le=MAX_CHANNELS)] | None = None
    select: Annotated[str | tuple[int, ...], BeforeValidator(_select)] | None = None
    key: KeyName | None = None
    file: Annotated[str, text("the name of an antenna file, as text")] | None = None
    array: Annotated[str, one_of(*KNOWN_ARRAYS)] | None = None
    orientation: Annotated[str, one_of("rows", "columns")] = "rows"
    x: NumberOrText | None = None
    y: NumberOrText | None = None
    z: NumberOrText | None = None

    @property
    def coordinates(self) -> dict[str, str | float]:
        """Keys or numbers of single coordinates."""
        found = {name: getattr(self, name) for name in COORDINATES}
        return {name: value for name, value in found.items() if value is not None}

    def chosen(self, count: int) -> list[int]:
        """Return the used channels of `count`; raises IndexError for one that is not there."""
        if self.select is None or isinstance(self.select, str):
            ends = (int(n) if n else None for n in (self.select or ":").split(":"))
            return list(range(count))[slice(*ends)]
        if max(self.select) >= count:
            raise IndexError(f"channel {max(self.select)}")
        return list(self.select)

    @model_validator(mode="after")
    def _fits_together(self) -> AntennaLayout:
        single = self.coordinates
        keys = any(isinstance(value, str) for value in single.values())
        apart = "x" in single and "y" in single and keys
        sources = {name: getattr(self, name) for name in ("key", "file", "array")}
        whole = sum(value is not None for value in sources.values())
        known = self.array is not None or self.file is not None
        turned = "orientation" in self.model_fields_set and self.key is None
        given = _given(**(sources if whole else single))
        plane = "a key or a number (0.0 for antennas in one plane)"
        _refuse(
            (whole + apart != 1 or (known and single), "key", f"{_SOURCES}, for positions", given),
            (whole and keys, "x, y, z", "numbers, for coordinates that have no column", "a key"),
            (apart and len(single) != 3, "z", plane, "none"),
            (turned, "orientation", "a 'key' that it is about", "none"),
        )
        return self


class FrameOfReference(FileRecord):
    """How the file's positions become those of the antenna frame: unit, origin, then mirror."""

    unit: Annotated[str, one_of(*LENGTH_UNITS_PER_M)] | None = None
    origin: Vector = (0.0, 0.0, 0.0)
    mirror: tuple[Annotated[str, one_of(*COORDINATES)], ...] = Field(
        (), description='coordinates, such as ["x"]: "x", "y" and "z" only'
    )
    columns: tuple[Annotated[str, one_of(*COORDINATES)], ...] = Field(
        COORDINATES, min_length=1,
        description='the coordinates of the columns, such as ["x", "y"]: "x", "y" and "z" only',
    )  # fmt: skip
    name: Text | None = None

    @model_validator(mode="after")
    def _are_different(self) -> FrameOfReference:
        for key in ("mirror", "columns"):
            if len(set(getattr(self, key))) != len(getattr(self, key)):
                raise mistake("every coordinate once", list(getattr(self, key)), key=key)
        return self


class FrequencyLayout(FileRecord):
    """The frequencies: `key`, or `values`, or `start` with `stop` or `step`, and `points`."""

    key: KeyName | None = None
    values: Numbers | None = None
    start: NumberOrText | None = None
    stop: NumberOrText | None = None
    step: NumberOrText | None = None
    points: Annotated[Whole, Field(ge=1, le=MAX_FREQUENCIES)] | KeyName | None = None
    unit: Annotated[str, one_of(*FREQUENCY_UNITS_HZ)] = Field(
        description="the unit: one of Hz, kHz, MHz, GHz"
    )

    @model_validator(mode="after")
    def _is_one_of_them(self) -> FrequencyLayout:
        span = {name: getattr(self, name) for name in ("start", "stop", "step", "points")}
        ranges = any(value is not None for value in span.values())
        whole = None not in (self.start, self.points) and (self.stop is None) != (self.step is None)
        forms = (self.key is not None) + (self.values is not None) + ranges
        expected = "'key', or 'values', or 'start', 'points' and either 'stop' or 'step'"
        given = _given(key=self.key, values=self.values, **span)
        _refuse((forms != 1 or ranges != whole, "key", expected, given))
        return self


class Layout(FileRecord):
    """The keys, axes, units and conventions of a file: docs/layouts.md has them all."""

    data: DataLayout
    tx: AntennaLayout
    rx: AntennaLayout
    antennas: FrameOfReference = Field(default_factory=lambda: FrameOfReference.model_validate({}))
    frequency: FrequencyLayout
    _path: Path = PrivateAttr(Path())

    @model_validator(mode="after")
    def _places_the_antennas(self) -> Layout:
        frame = self.antennas
        if frame.unit is None and any(side.array is None for side in (self.tx, self.rx)):
            expected = "the unit of the positions: one of m, cm, mm, um"
            raise mistake(expected, "none", key="antennas.unit")
        missing = [c for c in COORDINATES if c not in frame.columns]
        for side in (self.tx, self.rx):
            constants = list(side.coordinates)
            if side.key is not None and constants != missing:
                raise mistake(
                    "every coordinate either as a column or as a number in [tx] and [rx]",
                    f"columns {', '.join(frame.columns)} and numbers for "
                    f"{', '.join(constants) or 'none'}",
                    key="antennas.columns",
                )
        return self

    @property
    def array_name(self) -> str:
        """Name of the array; a known one keeps its own."""
        known = self.tx.array if self.tx.array == self.rx.array else None
        return self.antennas.name or known or self._path.stem

    def file_of(self, side: AntennaLayout) -> Path | None:
        """The antenna file of a side, beside the layout; None if it has none."""
        return None if side.file is None else self._path.parent / side.file

    def plain(self) -> dict[str, Any]:
        """The settings in types that JSON knows; what is not set is left out."""
        settings = self.model_dump(mode="json", exclude_none=True)
        for name in ("tx", "rx"):
            if (file := self.file_of(getattr(self, name))) is not None:
                settings[name]["file"] = str(file)
        return {"source": shown(self._path), **settings}


def read_layout(path: str | os.PathLike[str]) -> Layout:
    """Return the layout of a TOML file.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("lab.toml").write_text('''
    ... data = {key = "s", axes = ["tx", "rx", "freq"]}
    ... tx.array = "qar50"
    ... rx.array = "qar50"
    ... frequency = {start = 72, stop = 82, points = 128, unit = "GHz"}
    ... ''')
    >>> measurement_io.read_layout("lab.toml").frequency.points
    128
    """
    found = read_record(Path(path), Layout, _EXPECTED)
    found._path = Path(path).absolute()
    return found
