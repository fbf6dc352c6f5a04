"""Calibration targets with closed-form echoes: plate (image source), sphere, corner reflector."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M, SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.plausible import check_plausible, place
from clradar.model.record import Record

if TYPE_CHECKING:
    from typing_extensions import Self

MAX_TILT_DEG = 60.0
RADIUS_M = (1e-4, 5.0)  # of a sphere: a third of the shortest wavelength, to the largest aperture


@dataclass(frozen=True, slots=True, eq=False)
class Echo:
    """The specular path of each pair via a target: its length, metres, and whether there is one.

    Both have the shape (n_tx, n_rx); lengths are finite where there is no path, too.
    """

    length_m: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class _AtPosition(Record):
    """A target whose pose is a place in front of the antennas.

    `parameters` are the pose of a target, in the order and units of `parameter_names`.
    """

    parameter_names: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")

    position_m: np.ndarray

    def __post_init__(self) -> None:
        name = type(self).__name__
        position = place(f"{name}.position_m", self.position_m)
        if position[2] <= 0:
            expected = "a place in front of the antennas (z > 0)"
            checks.fail(f"{name}.position_m", expected, f"z = {position[2]:g} m")
        self._set(position_m=position)

    @property
    def parameters(self) -> np.ndarray:
        return self.position_m

    def placed(self, parameters: np.ndarray) -> Self:
        return replace(self, position_m=parameters)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CornerReflector(_AtPosition):
    """A trihedral corner reflector, or a point target: all paths lead via its apex.

    The path length is ``|tx - p| + |p - rx|``: exact for monostatic antennas, and for Tx and Rx
    closer together than the opening.

    Parameters
    ----------
    position_m : array_like, shape (3,)
        The apex, antenna frame.
    """

    kind: ClassVar[str] = "corner"

    def echo(self, array: AntennaArray) -> Echo:
        to_m = np.linalg.norm(array.tx_m - self.position_m, axis=1)[:, None]
        back_m = np.linalg.norm(array.rx_m - self.position_m, axis=1)[None, :]
        _outside("CornerReflector.position_m", "an antenna", min(to_m.min(), back_m.min()), 0.0)
        seen = np.ones((array.n_tx, array.n_rx), dtype=bool)
        return Echo(to_m + back_m, seen)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sphere(_AtPosition):
    """A sphere: one specular path per pair by the law of reflection (Alhazen's problem).

    With a and b the distances of Tx and Rx from the centre, g the angle between them there and t
    that from Tx to the point of reflection, the path length is the minimum over t in [0, g] of::

        L(t) = sqrt(a^2 + r^2 - 2 a r cos t) + sqrt(b^2 + r^2 - 2 b r cos(g - t))

    Parameters
    ----------
    position_m : array_like, shape (3,)
        The centre, antenna frame.
    radius_m : float
    """

    kind: ClassVar[str] = "sphere"

    radius_m: float

    def __post_init__(self) -> None:
        _AtPosition.__post_init__(self)
        radius = checks.positive("Sphere.radius_m", self.radius_m)
        check_plausible("Sphere.radius_m", "a radius", radius, RADIUS_M)
        self._set(radius_m=radius)

    def echo(self, array: AntennaArray) -> Echo:
        from scipy.optimize.elementwise import find_root

        r = self.radius_m
        tx, rx = array.tx_m - self.position_m, array.rx_m - self.position_m
        a, b = np.linalg.norm(tx, axis=1)[:, None], np.linalg.norm(rx, axis=1)[None, :]
        _outside("Sphere.position_m", "the nearest antenna", min(a.min(), b.min()), r)
        across = np.linalg.norm(np.cross(tx[:, None], rx[None]), axis=2)
        between = np.arctan2(across, tx @ rx.T)

        def leg(distance: np.ndarray, angle: np.ndarray) -> np.ndarray:
            return np.asarray(np.sqrt(distance**2 + r**2 - 2 * distance * r * np.cos(angle)))

        def slope(t: np.ndarray, a: np.ndarray, b: np.ndarray, g: np.ndarray) -> np.ndarray:
            return np.asarray(a * np.sin(t) / leg(a, t) - b * np.sin(g - t) / leg(b, g - t))

        t = find_root(slope, (np.zeros_like(between), between), args=(a, b, between)).x
        seen = (np.cos(t) > r / a) & (np.cos(between - t) > r / b)
        return Echo(leg(a, t) + leg(b, between - t), seen)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FlatPlate(Record):
    """A flat mirror, by the image-source method.

    The plane is z = distance_m + x tan(tilt_x) + y tan(tilt_y). With h the distances of the two
    antennas from it, the path length is ``sqrt(|tx - rx|^2 + 4 h_tx h_rx)``.

    Parameters
    ----------
    distance_m : float
        Along z, from the origin to the plate.
    tilt_x_deg, tilt_y_deg : float
        Positive where the plate is farther away towards +x, +y; up to 60.
    size_m : (float, float), optional
        Width (along x) and height, with the middle at x = y = 0. Pairs whose point of reflection is
        not on the plate have no echo. None: large enough for all.
    """

    kind: ClassVar[str] = "plate"
    parameter_names: ClassVar[tuple[str, ...]] = ("distance_m", "tilt_x_deg", "tilt_y_deg")

    distance_m: float
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    size_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        distance = checks.positive("FlatPlate.distance_m", self.distance_m)
        check_plausible("FlatPlate.distance_m", "a distance", distance, PLAUSIBLE_RANGE_M)
        self._set(distance_m=distance)
        for name in ("tilt_x_deg", "tilt_y_deg"):
            ends_deg = -MAX_TILT_DEG, MAX_TILT_DEG
            tilt = checks.within(f"FlatPlate.{name}", getattr(self, name), *ends_deg, " degrees")
            self._set(**{name: tilt})
        if self.size_m is not None:
            size = checks.read_only("FlatPlate.size_m", self.size_m, np.float64, (2,))
            if (size <= 0).any():
                checks.fail("FlatPlate.size_m", "positive lengths", f"{size.tolist()}")

    @property
    def parameters(self) -> np.ndarray:
        return np.array([self.distance_m, self.tilt_x_deg, self.tilt_y_deg])

    def placed(self, parameters: np.ndarray) -> FlatPlate:
        distance_m, x_deg, y_deg = parameters.tolist()
        return FlatPlate(distance_m, x_deg, y_deg, self.size_m)

    def echo(self, array: AntennaArray) -> Echo:
        slope = np.tan(np.radians([self.tilt_x_deg, self.tilt_y_deg]))
        normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)
        offset = self.distance_m * normal[2]
        h_tx = (offset - array.tx_m @ normal)[:, None]
        h_rx = (offset - array.rx_m @ normal)[None, :]
        _outside("FlatPlate", "an antenna", min(h_tx.min(), h_rx.min()), 0.0)
        apart = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
        length_m = np.sqrt(apart**2 + 4 * h_tx * h_rx)
        seen = np.ones(length_m.shape, dtype=bool)
        if self.size_m is not None:
            share = h_tx / (h_tx + h_rx)  # of the path, up to the point of reflection
            # From the image of the Tx in the plane straight on to the Rx.
            image = array.tx_m + 2 * h_tx * normal
            point = image[:, None] + share[:, :, None] * (array.rx_m[None] - image[:, None])
            along_x = np.array([1.0, 0.0, slope[0]]) / np.hypot(1.0, slope[0])
            off_m = point - [0.0, 0.0, self.distance_m]
            u, v = off_m @ along_x, off_m @ np.cross(normal, along_x)
            seen = (np.abs(u) <= self.size_m[0] / 2) & (np.abs(v) <= self.size_m[1] / 2)
        return Echo(length_m, seen)


Target = FlatPlate | Sphere | CornerReflector


def response(target: Target, array: AntennaArray, waveform: Waveform) -> np.ndarray:
    """Simulate the samples that ideal channels record of a target.

    Returns
    -------
    ndarray, shape (n_tx, n_rx, n_freq), complex128
        exp(-j 2 pi f d / c), with d the length of the pair's path; 0 for pairs without an echo.

    Examples
    --------
    The path of 0.6 m is one wavelength:

    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> waveform = clradar.Waveform([299_792_458 / 0.6])
    >>> calibration.response(calibration.FlatPlate(0.3), array, waveform).round(6)
    array([[[1.+0.j]]])
    """
    checks.instance("response: target", target, Target)
    checks.instance("response: array", array, AntennaArray)
    checks.instance("response: waveform", waveform, Waveform)
    echo = target.echo(array)
    cycles = echo.length_m[:, :, None] * (waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S)
    return np.asarray(np.exp(-2j * np.pi * cycles) * echo.seen[:, :, None])


def _outside(name: str, what: str, distance_m: float, least_m: float) -> None:
    if not distance_m > least_m:
        away = f"{what} more than {least_m:g} m away"
        expected = f"a target that no antenna touches or is inside of or behind ({away})"
        checks.fail(name, expected, f"{distance_m:g} m")
