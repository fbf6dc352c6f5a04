"""Static echoes: walls by the image method, point reflectors, and direct Tx-Rx coupling (E10)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Capture, Waveform, checks
from clradar.model.plausible import place
from clradar.model.record import Record


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wall(Record):
    """An infinite plane that reflects like a mirror.

    Parameters
    ----------
    point_m : array_like, shape (3,), float64
        Any point of the plane.
    normal : array_like, shape (3,), float64
        Of any length and either sign.
    amplitude : float
        RMS over the pairs of its echo, in the units of a capture; negative where the reflection
        reverses the sign.
    """

    point_m: np.ndarray
    normal: np.ndarray
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        amplitude = checks.real("Wall.amplitude", self.amplitude)
        self._set(point_m=place("Wall.point_m", self.point_m), amplitude=amplitude)
        normal = self._set_array("normal", np.float64, (3,))
        length = float(np.linalg.norm(normal))
        if not 0 < length < np.inf:
            checks.fail("Wall.normal", "a direction", f"{normal.tolist()}")
        self._set(normal=normal / length)
        self._set_array("normal", np.float64, (3,))


def room_capture(
    array: AntennaArray,
    waveform: Waveform,
    walls: Iterable[Wall],
    *,
    points_m: Any = None,
    point_amplitudes: Any = None,
) -> Capture:
    """Return the capture of an empty room: walls and small reflectors (E10 in docs/equations.md).

    Parameters
    ----------
    array : AntennaArray
    waveform : Waveform
    walls : iterable of Wall
        Each gives one specular reflection per pair.
    points_m : array_like, shape (n, 3), float64, optional
        Small isotropic reflectors, such as lamps and screws.
    point_amplitudes : array_like, shape (n,), complex128, optional
        As received, without patterns and gains; default 1.

    Returns
    -------
    Capture
        `meta["room"]` holds the walls and the points.

    Examples
    --------
    The slope of the phase is the path by way of the wall: ``2 |(0.3 m, 0.4 m)| = 1 m``.

    >>> array = clradar.AntennaArray([[-0.3, 0, 0]], [[0.3, 0, 0]])
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 128)
    >>> wall = clradar.Wall(point_m=(0, 0, 0.4), normal=(0, 0, -1), amplitude=2.0)
    >>> room = clradar.room_capture(array, waveform, [wall])
    >>> k = 2 * np.pi * waveform.frequencies_hz / 299_792_458
    >>> print(f"{-np.polyfit(k, np.unwrap(np.angle(room.data[0, 0])), 1)[0]:.3f} m")
    1.000 m
    """
    checks.instance("room_capture: array", array, AntennaArray)
    checks.instance("room_capture: waveform", waveform, Waveform)
    planes = list(checks.several("room_capture: walls", walls))
    for wall in planes:
        checks.instance("room_capture: walls", wall, Wall)
    empty: Any = {"allow_empty": True}
    points = np.empty((0, 3)) if points_m is None else points_m
    points = checks.read_only("room_capture: points_m", points, np.float64, (None, 3), **empty)
    given = np.ones(len(points)) if point_amplitudes is None else point_amplitudes
    own = points.shape[:1]
    amplitudes = checks.read_only(
        "room_capture: point_amplitudes", given, np.complex128, own, **empty
    )
    if not planes and not len(points):
        checks.fail("room_capture", "at least one wall or one point", "none")
    lengths = [wall_lengths_m(array, wall) for wall in planes]
    levels = [spreading_loss(wall.amplitude, d) for wall, d in zip(planes, lengths, strict=True)]
    for point, amplitude in zip(points, amplitudes, strict=True):
        to_tx, to_rx = (np.linalg.norm(side - point, axis=1) for side in (array.tx_m, array.rx_m))
        lengths.append(to_tx[:, None] + to_rx)
        levels.append(np.full(lengths[-1].shape, amplitude))
    data = np.empty((array.n_tx, array.n_rx, waveform.n_freq), np.complex64)
    for tx, row in enumerate(data):
        ways = zip(lengths, levels, strict=True)
        row[:] = sum(echo(waveform.frequencies_hz, d[tx], a[tx]) for d, a in ways)
    data.flags.writeable = False
    record = {
        "walls": [
            {"point_m": w.point_m.tolist(), "normal": w.normal.tolist(), "amplitude": w.amplitude}
            for w in planes
        ],
        "points_m": points.tolist(),
        "point_amplitudes": [[a.real, a.imag] for a in amplitudes.tolist()],
    }
    return Capture(data, array, waveform, {"room": record})


def wall_lengths_m(array: AntennaArray, wall: Wall) -> np.ndarray:
    """Return the length of the path Tx -> wall -> Rx, shape (n_tx, n_rx), metres."""
    heights = [(side - wall.point_m) @ wall.normal for side in (array.tx_m, array.rx_m)]
    both = np.concatenate(heights)
    if not (both > 0).all() and not (both < 0).all():
        got = f"heights of {1e3 * both.min():g} to {1e3 * both.max():g} mm over one"
        checks.fail("room_capture: walls", "all antennas on one side of each wall", got)
    image = array.tx_m - 2 * heights[0][:, None] * wall.normal
    return np.linalg.norm(image[:, None] - array.rx_m, axis=2)


def spreading_loss(rms: float, length_m: np.ndarray) -> np.ndarray:
    """Return amplitudes proportional to 1 / length, with this RMS over the pairs."""
    return rms / length_m / np.sqrt((1 / length_m**2).mean())


def echo(
    frequencies_hz: np.ndarray, length_m: np.ndarray, amplitude: np.ndarray, later_s: float = 0.0
) -> np.ndarray:
    """Return a exp(-j 2 pi f tau), shape (n, n_freq), for n lengths and amplitudes."""
    cycles = (length_m / SPEED_OF_LIGHT_M_PER_S + later_s)[:, None] * frequencies_hz
    return amplitude[:, None] * np.exp(-2j * np.pi * cycles)
