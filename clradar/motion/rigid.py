"""Rigid motions, between places that are given, and bodies that move, on the same faces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.hand.pose import minimum_jerk
from clradar.model import Scene, checks
from clradar.model.record import Record

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

PROFILES = ("linear", "smooth")
BEYOND = ("hold", "continue")

STEEPEST = {"linear": 1.0, "smooth": 1.875}
"""Of the share of the way over the share of the time: of `minimum_jerk` in the middle."""

MOST_TURNS = 2**13  # eighths of a turn between two keys: more than an interpolation is checked at


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RigidMotion(Record):
    """Shift and turn of a body over time: p' = R (p - about) + about + shift.

    Parameters
    ----------
    times_s : array_like, shape (n,), float64
        Of the places, increasing.
    shifts_m : array_like, shape (n, 3), float64
    turns_rad : array_like, shape (n, 3), float64, optional
        Rotation vectors, axis times angle. Between two of one axis the angle is interpolated, over
        any number of turns; between others the shortest rotation. None: it does not turn.
    about_m : array_like, shape (3,)
    profile : {"linear", "smooth"}
        Constant velocity between two places, or from rest to rest with the least jerk.
    beyond : {"hold", "continue"}
        Before the first and after the last place: stay, or go on with the velocity there
        ("linear").
    """

    times_s: Any
    shifts_m: Any
    turns_rad: Any = None
    about_m: Any = (0.0, 0.0, 0.0)
    profile: str = "linear"
    beyond: str = "hold"

    def __post_init__(self) -> None:
        times_s = checks.one_axis("RigidMotion.times_s", self.times_s)
        turns_rad = np.zeros((len(times_s), 3)) if self.turns_rad is None else self.turns_rad
        self._set(times_s=times_s, turns_rad=turns_rad)
        for name in ("shifts_m", "turns_rad"):
            self._set_array(name, np.float64, (len(times_s), 3))
        self._set_array("about_m", np.float64, (3,))
        checks.one_of("RigidMotion.profile", self.profile, PROFILES)
        checks.one_of("RigidMotion.beyond", self.beyond, BEYOND)
        if self.beyond == "continue" and (self.profile == "smooth" or len(times_s) < 2):
            got = f"profile '{self.profile}' and {len(times_s)} places"
            checks.fail("RigidMotion.beyond", "'hold' unless two places are linear", got)

    @classmethod
    def steady(
        cls,
        velocity_m_per_s: Any = (0.0, 0.0, 0.0),
        turn_rad_per_s: Any = (0.0, 0.0, 0.0),
        about_m: Any = (0.0, 0.0, 0.0),
    ) -> RigidMotion:
        """Return the motion of constant velocity and turn that is in its own place at time 0."""
        velocity = checks.read_only("velocity_m_per_s", velocity_m_per_s, np.float64, (3,))
        turn = checks.read_only("turn_rad_per_s", turn_rad_per_s, np.float64, (3,))
        still = np.zeros(3)
        return cls([0.0, 1.0], [still, velocity], [still, turn], about_m, beyond="continue")

    def at(self, time_s: float) -> np.ndarray:
        """Return the rigid transform at a time, shape (4, 4), float64."""
        begin, share = between(self.times_s, time_s, self.profile, hold=self.beyond == "hold")
        end = min(begin + 1, len(self.times_s) - 1)
        made = np.eye(4)
        first, way_rad = _way(self.turns_rad[begin], self.turns_rad[end])
        turn_rad = share * way_rad
        turned = first * type(first).from_rotvec(turn_rad) if turn_rad.any() else first
        made[:3, :3] = turned.as_matrix()
        shift_m = (1.0 - share) * self.shifts_m[begin] + share * self.shifts_m[end]
        made[:3, 3] = self.about_m - made[:3, :3] @ self.about_m + shift_m
        return made

    def marks_s(self, begin_s: float, end_s: float) -> np.ndarray:
        """Return times of a sweep between which it goes one way; none: it stays in its place.

        From one to the next it turns by no more than an eighth of a turn: in whatever sweep, it
        cannot come back to its place between two.

        :meta private:
        """
        found: list[np.ndarray] = []
        hold = self.beyond == "hold"
        for first, from_s, to_s in pieces(self.times_s, begin_s, end_s, hold=hold):
            ends = slice(first, first + 2)
            if np.ptp(np.c_[self.shifts_m, self.turns_rad][ends], axis=0).any():
                _, way_rad = _way(*self.turns_rad[ends])
                share = (to_s - from_s) / (self.times_s[first + 1] - self.times_s[first])
                turn_rad = float(np.linalg.norm(way_rad)) * STEEPEST[self.profile] * share
                count = min(np.ceil(turn_rad / (0.25 * np.pi)), MOST_TURNS)
                found.append(np.linspace(from_s, to_s, int(max(count, 1)) + 1))
        return np.unique(np.concatenate(found)) if found else np.empty(0)


def moved(matrix: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Return points (n, 3) after a rigid transform (4, 4)."""
    return np.asarray(points_m @ matrix[:3, :3].T + matrix[:3, 3])


def pieces(
    times_s: np.ndarray, begin_s: float, end_s: float, *, hold: bool = True
) -> Iterator[tuple[int, float, float]]:
    """Yield the first key of every way between two keys that a sweep sees, and when it does."""
    ends_s = times_s if hold else np.array([-np.inf, *times_s[1:-1], np.inf])
    for first, way_s in enumerate(pairwise(ends_s)):
        seen_s, gone_s = np.clip(way_s, begin_s, end_s).tolist()
        if seen_s < gone_s:
            yield first, seen_s, gone_s


def between(
    times_s: np.ndarray, time_s: float, profile: str, *, hold: bool = True
) -> tuple[int, float]:
    """Return the last key before a time, and the share of the way to the next one."""
    time_s = checks.real("time_s", time_s)
    if len(times_s) == 1:
        return 0, 0.0
    begin = int(np.clip(np.searchsorted(times_s, time_s, "right") - 1, 0, len(times_s) - 2))
    share = (time_s - times_s[begin]) / (times_s[begin + 1] - times_s[begin])
    if hold:
        share = min(max(share, 0.0), 1.0)
    return begin, float(minimum_jerk(share) if profile == "smooth" else share)


def _way(first_rad: np.ndarray, last_rad: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """Return the first rotation, and the rotation vector from it to the last one.

    Of one axis over any number of turns, else the shortest.
    """
    from scipy.spatial.transform import Rotation

    # scipy takes no read-only arrays.
    first, last = (Rotation.from_rotvec(np.array(end_rad)) for end_rad in (first_rad, last_rad))
    across = np.linalg.norm(np.cross(first_rad, last_rad))
    if across <= 1e-12 * np.linalg.norm(first_rad) * np.linalg.norm(last_rad):
        return first, last_rad - first_rad
    return first, (first.inv() * last).as_rotvec()


STILL = RigidMotion([0.0], [(0.0, 0.0, 0.0)])  # of what stays in its place


@dataclass(frozen=True, slots=True, eq=False)
class BodyInSweep:
    """A body during one sweep, on the same faces at all times.

    Between two of `marks_s` it goes one way, and turns by no more than an eighth of a turn; without
    any it stays in its place. `scene(time_s)` is the body, `vertices_m(time_s, rows)` are some of
    its vertices or all, metres. `carried` are the faces of skin that moves with bones, and tears.
    """

    marks_s: np.ndarray
    scene: Callable[[float], Scene]
    vertices_m: Callable[[float, Any], np.ndarray]
    carried: np.ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MovingBody(Record):
    """A scene that moves as a rigid body.

    Parameters
    ----------
    scene : Scene
        In its place before the motion.
    motion : RigidMotion, optional
        Without one it stays.
    """

    scene: Scene
    motion: RigidMotion = STILL

    def __post_init__(self) -> None:
        checks.instance("MovingBody.scene", self.scene, Scene)
        checks.instance("MovingBody.motion", self.motion, RigidMotion)

    def during(self, begin_s: float, end_s: float) -> BodyInSweep:
        """Return the body during a sweep.

        :meta private:
        """
        return BodyInSweep(self.motion.marks_s(begin_s, end_s), self._at, self._vertices_m)

    def _at(self, time_s: float) -> Scene:
        matrix = self.motion.at(time_s)
        # The same record, so that what stays has the bits of a simulation without a motion.
        return self.scene if (matrix == np.eye(4)).all() else self.scene.transformed(matrix)

    def _vertices_m(self, time_s: float, rows: Any) -> np.ndarray:
        return moved(self.motion.at(time_s), self.scene.vertices_m[rows])
