"""Layouts as frozen records: keys, axes, units and conventions of the files of one lab."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

FREQUENCY_UNITS_HZ = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9}
"""Known units of frequency and what one of them is in hertz."""

LENGTH_UNITS_PER_M = {"m": 1.0, "cm": 1e2, "mm": 1e3, "um": 1e6}
"""Known units of length and how many make a metre: 70.5 / 1000 is 0.0705, 70.5 * 0.001 is not."""

KNOWN_ARRAYS = ("qar50",)
SIGNAL_AXES = ("tx", "rx", "pair", "freq", "frame", "part", "one")
"""Names of axes with a meaning: antennas, pairs of them, frequency, the frame to choose, the two
parts of a complex number, and an axis of length one."""


@dataclass(frozen=True, slots=True)
class DataLayout:
    """Where the signal is.

    Attributes
    ----------
    key : str or None
        The key of the complex numbers, or of real ones with an axis "part".
    real, imag : str or None
        The keys of the parts where they are apart; then `key` is None.
    axes : tuple of str
        What each axis is: names of `SIGNAL_AXES`, or one of `pick`.
    pick : tuple of (str, int)
        Other axes, and the index that is used of each.
    parts : tuple of str
        Order on the axis "part": ("real", "imag") or ("imag", "real").
    fields : tuple of str or None
        The fields of the real and the imaginary part of a compound type; None finds r, i, real, ...
    pair_order : str or None
        "tx_major": all Rx of the first Tx come first; "rx_major": the other way round.
    phase_sign : int
        -1: a path of length d contributes exp(-j 2 pi f d / c), as here; +1: its conjugate.
    scale : float
        The numbers are multiplied by it.
    """

    key: str | None
    real: str | None
    imag: str | None
    axes: tuple[str, ...]
    pick: tuple[tuple[str, int], ...]
    parts: tuple[str, str]
    fields: tuple[str, str] | None
    pair_order: str | None
    phase_sign: int
    scale: float


@dataclass(frozen=True, slots=True)
class Select:
    """Which channels are used: a slice (stop excluded, as in Python) or a list.

    Attributes
    ----------
    start, stop, step : int or None
    channels : tuple of int or None
        The list; None for a slice.
    """

    start: int | None
    stop: int | None
    step: int | None
    channels: tuple[int, ...] | None

    def indices(self, count: int) -> list[int]:
        """Return the chosen channels of `count`; raises IndexError for one that is not there."""
        if self.channels is None:
            return list(range(count))[self.start : self.stop : self.step]
        for channel in self.channels:
            if not 0 <= channel < count:
                raise IndexError(f"channel {channel}")
        return list(self.channels)

    def __str__(self) -> str:
        if self.channels is not None:
            return f"{len(self.channels)} listed channels"
        ends = ["" if n is None else str(n) for n in (self.start, self.stop)]
        return ":".join(ends) + ("" if self.step is None else f":{self.step}")


@dataclass(frozen=True, slots=True)
class AntennaLayout:
    """The Tx or the Rx side. Exactly one of `key`, `x` with `y` (and `z`), `values`, `file` and
    `array` gives the positions of the antennas.

    Attributes
    ----------
    channels : int or None
        How many there are on the data's axis; None to see it there.
    select : Select or None
        Which of them are used; None for all.
    key : str or None
        One key for all coordinates.
    coordinates : tuple of (str, str or float)
        A key or a number for single coordinates.
    values : tuple of tuple of float or None
    file : str or None
        An antenna file (a header x,y,z and rows of numbers), beside the layout.
    array : str or None
        A known array; its positions are those of the used channels.
    orientation : str
        Of `key`: "rows", one antenna per row, or "columns".
    """

    channels: int | None
    select: Select | None
    key: str | None
    coordinates: tuple[tuple[str, str | float], ...]
    values: tuple[tuple[float, ...], ...] | None
    file: str | None
    array: str | None
    orientation: str


@dataclass(frozen=True, slots=True)
class FrameOfReference:
    """How the file's positions become those of the antenna frame: unit, origin, then mirror.

    Attributes
    ----------
    unit : str
    origin : tuple of float
        The aperture's centre in the file's frame and unit.
    mirror : tuple of str
        Coordinates whose sign is turned.
    columns : tuple of str
        Which coordinate each column of a `key`, of `values` or of a `file` holds.
    name : str
        What the array is called.
    """

    unit: str
    origin: tuple[float, float, float]
    mirror: tuple[str, ...]
    columns: tuple[str, ...]
    name: str


@dataclass(frozen=True, slots=True)
class FrequencyLayout:
    """The frequencies: `key`, or `values`, or `start` with `stop` or `step`, and `points`.

    Attributes
    ----------
    key : str or None
    values : tuple of float or None
    start, stop, step, points : str or float or None
        A number, or the key of one.
    unit : str
    """

    key: str | None
    values: tuple[float, ...] | None
    start: str | float | None
    stop: str | float | None
    step: str | float | None
    points: str | int | None
    unit: str


@dataclass(frozen=True, slots=True)
class Layout:
    """The keys, axes, units and conventions of a file.

    Attributes
    ----------
    source : str
        The TOML file's name, for messages.
    data : DataLayout
    tx, rx : AntennaLayout
    antennas : FrameOfReference
    frequency : FrequencyLayout
    meta : tuple of str
        Keys whose numbers and text go into `Capture.meta`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.measurement_io import read_layout
    >>> _ = Path("lab.toml").write_text('''
    ... data = {key = "array", axes = ["tx", "rx", "freq"]}
    ... tx.array = "qar50"
    ... rx.array = "qar50"
    ... frequency = {start = 72, stop = 82, points = 128, unit = "GHz"}
    ... ''')
    >>> layout = read_layout("lab.toml")
    >>> layout.data.axes, layout.frequency.points, layout.data.phase_sign
    (('tx', 'rx', 'freq'), 128, -1)
    """

    source: str
    data: DataLayout
    tx: AntennaLayout
    rx: AntennaLayout
    antennas: FrameOfReference
    frequency: FrequencyLayout
    meta: tuple[str, ...]

    def plain(self) -> dict[str, Any]:
        """Return all settings in types that JSON knows; what is not set is left out."""
        settings = asdict(self)
        settings["data"]["pick"] = dict(self.data.pick)
        return _plain(settings)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value
