"""Bodies that move: where their vertices are at any time of a sweep, on the same faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from clradar.model import Scene, checks
from clradar.model.record import Record
from clradar.motion.rigid import RigidMotion, marks_s


class BodyInSweep(Protocol):
    """A body during one sweep, on the same faces at all times.

    `marks_s` are times between which it goes one way, and turns by no more than an eighth of a
    turn; none: it stays in its place all the time.
    """

    @property
    def marks_s(self) -> np.ndarray: ...

    def vertices_m(self, time_s: float, rows: np.ndarray | None = None) -> np.ndarray:
        """Vertices at a time, or those of `rows`, shape (n, 3), metres."""

    def scene(self, time_s: float) -> Scene:
        """The body at a time."""

    def stretch(self, at_m: np.ndarray) -> float:
        """By how much skin tears that is carried: 1 % of the faces become longer by this at least.

        Of vertices at some times (n_times, V, 3), the second in the middle of the sweep.
        """


class Body(Protocol):
    """What a `MovingScene` is made of."""

    def during(self, begin_s: float, end_s: float) -> BodyInSweep:
        """The body from one time to another."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MovingBody(Record):
    """A scene that moves as a rigid body.

    Parameters
    ----------
    scene : Scene
        In its place before the motion.
    motion : RigidMotion, optional
        None: it stays.

    Examples
    --------
    >>> import clradar, trimesh
    >>> ball = clradar.Scene.from_mesh(trimesh.creation.icosphere(radius=0.02))
    >>> away = clradar.RigidMotion.steady(velocity_m_per_s=(0, 0, 1.0))
    >>> body = clradar.MovingBody(ball, away)
    >>> print(body.during(0.0, 0.5).scene(0.5).vertices_m[:, 2].mean().round(3))
    0.5
    """

    scene: Scene
    motion: RigidMotion | None = None

    def __post_init__(self) -> None:
        checks.instance("MovingBody.scene", self.scene, Scene)
        if self.motion is not None:
            checks.instance("MovingBody.motion", self.motion, RigidMotion)

    def during(self, begin_s: float, end_s: float) -> BodyInSweep:
        """Return the body during a sweep."""
        marks = np.empty(0) if self.motion is None else marks_s(self.motion, begin_s, end_s)
        return _RigidInSweep(self.scene, self.motion, marks)


@dataclass(frozen=True, slots=True)
class _RigidInSweep:
    body: Scene
    motion: RigidMotion | None
    marks_s: np.ndarray

    def stretch(self, at_m: np.ndarray) -> float:
        return 1.0

    def vertices_m(self, time_s: float, rows: np.ndarray | None = None) -> np.ndarray:
        vertices_m = self.body.vertices_m if rows is None else self.body.vertices_m[rows]
        if self.motion is None:
            return vertices_m
        matrix = self.motion.at(time_s)
        return np.asarray(vertices_m @ matrix[:3, :3].T + matrix[:3, 3])

    def scene(self, time_s: float) -> Scene:
        matrix = np.eye(4) if self.motion is None else self.motion.at(time_s)
        # The same record, so that what stays has the bits of a simulation without a motion.
        return self.body if (matrix == np.eye(4)).all() else self.body.transformed(matrix)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MovingScene(Record):
    """Bodies that move, seen together.

    Parameters
    ----------
    bodies : sequence of MovingBody or MovingHand
    finish : callable, optional
        From the scene of all bodies to that which is simulated, with the same faces: sets alphas
        or materials.

    Examples
    --------
    A ball that falls in front of a plate.

    >>> import clradar, trimesh
    >>> ball = trimesh.creation.icosphere(radius=0.02).apply_translation([0, 0, 0.3])
    >>> plate = trimesh.creation.box([0.1, 0.1, 0.01]).apply_translation([0, 0, 0.4])
    >>> fall = clradar.RigidMotion.steady(velocity_m_per_s=(0, -1.0, 0))
    >>> scene = clradar.MovingScene(
    ...     [
    ...         clradar.MovingBody(clradar.Scene.from_mesh(ball), fall),
    ...         clradar.MovingBody(clradar.Scene.from_mesh(plate)),
    ...     ]
    ... )
    >>> print(scene.at(0.1).vertices_m.min(axis=0).round(3))
    [-0.05 -0.12  0.28]
    """

    bodies: Sequence[Body]
    finish: Callable[[Scene], Scene] | None = None

    def __post_init__(self) -> None:
        bodies: Any = (self.bodies,) if hasattr(self.bodies, "during") else tuple(self.bodies)
        if not bodies or not all(hasattr(body, "during") for body in bodies):
            checks.fail("MovingScene.bodies", "MovingBody or MovingHand, at least one", bodies)
        self._set(bodies=bodies)

    def during(self, begin_s: float, end_s: float) -> SceneInSweep:
        """Return the scene during a sweep."""
        if not begin_s <= end_s:
            checks.fail("begin_s, end_s", "begin_s <= end_s", f"{begin_s:g}, {end_s:g}")
        return SceneInSweep(tuple(b.during(begin_s, end_s) for b in self.bodies), self.finish)

    def at(self, time_s: float) -> Scene:
        """Return the scene at a time, as a sweep without duration sees it."""
        return self.during(time_s, time_s).scene(time_s)


@dataclass(frozen=True, slots=True)
class SceneInSweep:
    """A moving scene during one sweep, on the same faces at all times."""

    bodies: tuple[BodyInSweep, ...]
    finish: Callable[[Scene], Scene] | None

    def scene(self, time_s: float) -> Scene:
        """Return the scene at a time."""
        scenes = [body.scene(time_s) for body in self.bodies]
        scene = scenes[0] if len(scenes) == 1 else Scene.combine(scenes)
        return scene if self.finish is None else self.finish(scene)
