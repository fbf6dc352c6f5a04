"""Calibration targets with closed-form echoes: plate (image source), sphere, corner reflector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M, SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, Waveform, checks
from clradar.model.plausible import check_plausible, place

AMPLITUDES = ("unit", "spreading")
MAX_TILT_DEG = 60.0

RADIUS_M = (1e-4, 5.0)
"""Plausible radius of a sphere: a third of the shortest wavelength, to the largest aperture."""

_NEWTON_STEPS = 60
_NEWTON_TOLERANCE = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class Echo:
    """The specular path of every pair of antennas via a target.

    Attributes
    ----------
    length_m : ndarray, shape (n_tx, n_rx), float64, metres
        Path length; finite where `seen` is False, too.
    amplitude : ndarray, shape (n_tx, n_rx), float64
    seen : ndarray, shape (n_tx, n_rx), bool
        Whether the path exists: the specular point lies on the target and faces both antennas.

    Examples
    --------
    The plate of 10 cm reflects between the first Tx and the Rx, not between the second and the Rx:

    >>> import clradar
    >>> import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0], [0.4, 0, 0]], [[0, 0, 0]])
    >>> echo = calibration.FlatPlate(0.3, size_m=(0.1, 0.1)).echo(array)
    >>> echo.length_m[:, 0].round(3).tolist(), echo.seen[:, 0].tolist()
    ([0.6, 0.721], [True, False])
    """

    length_m: np.ndarray
    amplitude: np.ndarray
    seen: np.ndarray


class Target(Protocol):
    """Interface of a calibration target, as `estimate_channels` uses it.

    Attributes
    ----------
    kind : str
    parameter_names : tuple of str
        Of its pose; a name ends with the unit, "_m" or "_deg".

    Examples
    --------
    >>> import calibration
    >>> plate: calibration.Target = calibration.FlatPlate(0.3, 2.0)
    >>> plate.kind, plate.parameter_names, plate.parameters.tolist()
    ('plate', ('distance_m', 'tilt_x_deg', 'tilt_y_deg'), [0.3, 2.0, 0.0])
    """

    kind: ClassVar[str]
    parameter_names: ClassVar[tuple[str, ...]]

    @property
    def parameters(self) -> np.ndarray:
        """Its pose, in the order and the units of `parameter_names`."""

    def placed(self, parameters: np.ndarray) -> Target:
        """The same target in another pose; `ModelError` if that is invalid."""

    def echo(self, array: AntennaArray) -> Echo:
        """The specular path of every pair."""


@dataclass(frozen=True, slots=True, eq=False)
class CornerReflector:
    """A trihedral corner reflector, or a point target: all paths lead via its apex.

    Three reflections return a ray as if from the apex, with path length
    ``|tx - p| + |p - rx|``: exactly for monostatic antennas, and for Tx and Rx closer together than
    the opening.

    Parameters
    ----------
    position_m : array_like, shape (3,), metres
        The apex (phase centre), antenna frame.
    amplitude : "unit" or "spreading"
        1 for every pair, or 1 / (R1 R2), the path segments in metres, as in `clradar.simulate`.

    Examples
    --------
    >>> import clradar
    >>> import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.4, 0, 0]])
    >>> calibration.CornerReflector([0, 0, 0.3]).echo(array).length_m.round(3).tolist()
    [[0.8]]
    """

    kind: ClassVar[str] = "corner"
    parameter_names: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")

    position_m: np.ndarray
    amplitude: str = field(default="unit", kw_only=True)

    def __post_init__(self) -> None:
        position = _position("CornerReflector.position_m", self.position_m)
        object.__setattr__(self, "position_m", position)
        checks.one_of("CornerReflector.amplitude", self.amplitude, AMPLITUDES)

    @property
    def parameters(self) -> np.ndarray:
        return self.position_m

    def placed(self, parameters: np.ndarray) -> CornerReflector:
        return replace(self, position_m=parameters)

    def echo(self, array: AntennaArray) -> Echo:
        to_m = np.linalg.norm(array.tx_m - self.position_m, axis=1)[:, None]
        back_m = np.linalg.norm(array.rx_m - self.position_m, axis=1)[None, :]
        _outside("CornerReflector.position_m", "an antenna", min(to_m.min(), back_m.min()), 0.0)
        seen = np.ones((array.n_tx, array.n_rx), dtype=bool)
        return _echo(to_m, back_m, seen, self.amplitude)


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A sphere: one specular path per pair by the law of reflection (Alhazen's problem).

    The point of reflection lies in the plane of centre, Tx and Rx. With a and b the distances of
    the two from the centre, g the angle between them there and t the angle from Tx to the point::

        L(t) = sqrt(a^2 + r^2 - 2 a r cos t) + sqrt(b^2 + r^2 - 2 b r cos(g - t))

    It is convex where the point faces both antennas; the path length is its minimum (Fermat's
    principle), found by Newton's method on L'(t) = 0.

    Parameters
    ----------
    position_m : array_like, shape (3,), metres
        The centre, antenna frame.
    radius_m : float, metres
    amplitude : "unit" or "spreading"
        As of `CornerReflector`.

    Examples
    --------
    A monostatic echo comes from the point of the sphere nearest to the antenna:

    >>> import clradar
    >>> import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> calibration.Sphere([0, 0, 0.35], 0.05).echo(array).length_m.round(3).tolist()
    [[0.6]]
    """

    kind: ClassVar[str] = "sphere"
    parameter_names: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")

    position_m: np.ndarray
    radius_m: float
    amplitude: str = field(default="unit", kw_only=True)

    def __post_init__(self) -> None:
        position = _position("Sphere.position_m", self.position_m)
        object.__setattr__(self, "position_m", position)
        radius = checks.positive("Sphere.radius_m", self.radius_m)
        check_plausible("Sphere.radius_m", "a radius", radius, RADIUS_M)
        object.__setattr__(self, "radius_m", radius)
        checks.one_of("Sphere.amplitude", self.amplitude, AMPLITUDES)

    @property
    def parameters(self) -> np.ndarray:
        return self.position_m

    def placed(self, parameters: np.ndarray) -> Sphere:
        return replace(self, position_m=parameters)

    def echo(self, array: AntennaArray) -> Echo:
        r = self.radius_m
        tx, rx = array.tx_m - self.position_m, array.rx_m - self.position_m
        a, b = np.linalg.norm(tx, axis=1)[:, None], np.linalg.norm(rx, axis=1)[None, :]
        _outside("Sphere.position_m", "the nearest antenna", min(a.min(), b.min()), r)
        across = np.linalg.norm(np.cross(tx[:, None], rx[None]), axis=2)
        between = np.arctan2(across, tx @ rx.T)
        t = _reflection_angle(a, b, between, r)
        to_m = np.sqrt(a**2 + r**2 - 2 * a * r * np.cos(t))
        back_m = np.sqrt(b**2 + r**2 - 2 * b * r * np.cos(between - t))
        seen = (np.cos(t) > r / a) & (np.cos(between - t) > r / b)
        return _echo(to_m, back_m, seen, self.amplitude)


@dataclass(frozen=True, slots=True, eq=False)
class FlatPlate:
    """A flat mirror, by the image-source method.

    The plane is z = distance_m + x tan(tilt_x) + y tan(tilt_y). With h the distances of the two
    antennas from it, the path length is ``sqrt(|tx - rx|^2 + 4 h_tx h_rx)``.

    Parameters
    ----------
    distance_m : float, metres
        Along z, from the origin to the plate.
    tilt_x_deg, tilt_y_deg : float, degrees
        Positive where the plate is farther away towards +x, +y.
    size_m : (float, float), metres, optional
        Width (along x) and height of the plate. A pair whose point of reflection is not on it has
        no echo. None for a plate large enough for all pairs.
    centre_m : (float, float), metres
        x and y of the middle of the plate.
    amplitude : "unit" or "spreading"
        As of `CornerReflector`.

    Examples
    --------
    The path length is the distance from the image of the Tx at z = 0.6 m:

    >>> import clradar
    >>> import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0.8, 0, 0]])
    >>> calibration.FlatPlate(0.3).echo(array).length_m.round(3).tolist()
    [[1.0]]
    """

    kind: ClassVar[str] = "plate"
    parameter_names: ClassVar[tuple[str, ...]] = ("distance_m", "tilt_x_deg", "tilt_y_deg")

    distance_m: float
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    size_m: tuple[float, float] | None = field(default=None, kw_only=True)
    centre_m: tuple[float, float] = field(default=(0.0, 0.0), kw_only=True)
    amplitude: str = field(default="unit", kw_only=True)

    def __post_init__(self) -> None:
        distance = checks.positive("FlatPlate.distance_m", self.distance_m)
        check_plausible("FlatPlate.distance_m", "a distance", distance, PLAUSIBLE_RANGE_M)
        object.__setattr__(self, "distance_m", distance)
        for name in ("tilt_x_deg", "tilt_y_deg"):
            tilt = checks.real(f"FlatPlate.{name}", getattr(self, name))
            if abs(tilt) > MAX_TILT_DEG:
                limits = f"an angle within {MAX_TILT_DEG:g} degrees of upright"
                checks.fail(f"FlatPlate.{name}", limits, f"{tilt:g}")
            object.__setattr__(self, name, tilt)
        if self.size_m is not None:
            size = checks.read_only("FlatPlate.size_m", self.size_m, np.float64, (2,))
            if (size <= 0).any():
                checks.fail("FlatPlate.size_m", "positive lengths", f"{size.tolist()}")
            object.__setattr__(self, "size_m", (float(size[0]), float(size[1])))
        centre = checks.read_only("FlatPlate.centre_m", self.centre_m, np.float64, (2,))
        aside, within = np.abs(centre).max(), (0.0, PLAUSIBLE_RANGE_M[1])
        check_plausible("FlatPlate.centre_m", "a distance from the axis", aside, within)
        object.__setattr__(self, "centre_m", (float(centre[0]), float(centre[1])))
        checks.one_of("FlatPlate.amplitude", self.amplitude, AMPLITUDES)

    @property
    def parameters(self) -> np.ndarray:
        return np.array([self.distance_m, self.tilt_x_deg, self.tilt_y_deg])

    def placed(self, parameters: np.ndarray) -> FlatPlate:
        distance, tilt_x, tilt_y = (float(p) for p in parameters)
        return replace(self, distance_m=distance, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y)

    def echo(self, array: AntennaArray) -> Echo:
        slope = np.tan(np.radians([self.tilt_x_deg, self.tilt_y_deg]))
        normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)
        offset = self.distance_m * normal[2]
        h_tx = (offset - array.tx_m @ normal)[:, None]
        h_rx = (offset - array.rx_m @ normal)[None, :]
        _outside("FlatPlate", "an antenna", min(h_tx.min(), h_rx.min()), 0.0)
        apart = np.linalg.norm(array.tx_m[:, None] - array.rx_m[None], axis=2)
        length_m = np.sqrt(apart**2 + 4 * h_tx * h_rx)
        share = h_tx / (h_tx + h_rx)  # of the path, up to the point of reflection
        if self.size_m is None:
            seen = np.ones(length_m.shape, dtype=bool)
        else:
            # From the image of the Tx in the plane straight on to the Rx.
            image = array.tx_m + 2 * h_tx * normal
            point = image[:, None] + share[:, :, None] * (array.rx_m[None] - image[:, None])
            middle = np.array([*self.centre_m, self.distance_m + slope @ np.array(self.centre_m)])
            along_x = np.array([1.0, 0.0, slope[0]]) / np.hypot(1.0, slope[0])
            along_y = np.cross(normal, along_x)
            u, v = (point - middle) @ along_x, (point - middle) @ along_y
            seen = (np.abs(u) <= self.size_m[0] / 2) & (np.abs(v) <= self.size_m[1] / 2)
        return _echo(share * length_m, (1 - share) * length_m, seen, self.amplitude)


def response(target: Target, array: AntennaArray, waveform: Waveform) -> np.ndarray:
    """Simulate the samples that ideal channels record of a target.

    Parameters
    ----------
    target : CornerReflector, Sphere or FlatPlate
    array : AntennaArray
    waveform : Waveform

    Returns
    -------
    ndarray, shape (n_tx, n_rx, n_freq), complex128
        a exp(-j 2 pi f d / c), with d the length and a the amplitude of the pair's path; 0 for
        pairs without an echo.

    Raises
    ------
    ModelError
        An antenna is on, in or behind the target.

    Examples
    --------
    The path of 0.6 m is one wavelength at the first frequency, 1.25 at the second:

    >>> import clradar, numpy as np
    >>> import calibration
    >>> array = clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]])
    >>> waveform = clradar.Waveform([299_792_458 / 0.6, 1.25 * 299_792_458 / 0.6])
    >>> samples = calibration.response(calibration.FlatPlate(0.3), array, waveform)[0, 0]
    >>> [round(float(np.degrees(np.angle(s)))) for s in samples]
    [0, -90]
    """
    echo = target.echo(array)
    cycles = echo.length_m[:, :, None] * (waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S)
    phasors: np.ndarray = np.exp(-2j * np.pi * cycles)
    return phasors * (echo.amplitude * echo.seen)[:, :, None]


def _position(name: str, value: Sequence[float] | np.ndarray) -> np.ndarray:
    position = place(name, value)
    if position[2] <= 0:
        checks.fail(name, "a place in front of the antennas (z > 0)", f"z = {position[2]:g} m")
    return position


def _outside(name: str, what: str, distance_m: float, least_m: float) -> None:
    if not distance_m > least_m:
        checks.fail(
            name,
            f"a target that no antenna touches or is inside of or behind ({what} more than "
            f"{least_m:g} m away)",
            f"{distance_m:g} m",
        )


def _echo(to_m: np.ndarray, back_m: np.ndarray, seen: np.ndarray, amplitude: str) -> Echo:
    length_m = to_m + back_m
    strength = np.ones(length_m.shape) if amplitude == "unit" else 1.0 / (to_m * back_m)
    return Echo(length_m, strength, seen)


def _reflection_angle(a: np.ndarray, b: np.ndarray, between: np.ndarray, r: float) -> np.ndarray:
    """Angle at the sphere's centre from Tx to the point of reflection, radians."""
    low, high = np.zeros_like(between), between.copy()
    t = between * ((b - r) / (a + b - 2 * r))  # exact for a plane
    for _ in range(_NEWTON_STEPS):
        sides = [(a, t), (b, between - t)]
        lengths = [np.sqrt(d**2 + r**2 - 2 * d * r * np.cos(u)) for d, u in sides]
        pull = [d * r * np.sin(u) / n for (d, u), n in zip(sides, lengths, strict=True)]
        curve = [
            (d * r * np.cos(u) - p**2) / n
            for (d, u), n, p in zip(sides, lengths, pull, strict=True)
        ]
        slope, curvature = pull[0] - pull[1], curve[0] + curve[1]
        # Safeguarded by bisection: the root stays between low and high.
        low, high = np.where(slope < 0, t, low), np.where(slope > 0, t, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = t - slope / curvature
        inside = (curvature > 0) & (newton >= low) & (newton <= high)
        new = np.where(inside, newton, (low + high) / 2)
        moved = np.abs(new - t).max()
        t = new
        if moved < _NEWTON_TOLERANCE:
            break
    return t
