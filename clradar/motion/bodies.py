"""Bodies that move: where their vertices are at any time of a sweep, on the same faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import Scene, checks
from clradar.model.record import Record
from clradar.motion.rigid import STILL, RigidMotion, moved


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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MovingScene(Record):
    """Bodies that move, seen together.

    Parameters
    ----------
    bodies : sequence of MovingBody or MovingHand
    finish : callable, optional
        Sets alphas or materials of the scene of all bodies, with the same faces.

    Examples
    --------
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(radius=0.02).apply_translation([0, 0, 0.3])
    >>> fall = clradar.RigidMotion.steady(velocity_m_per_s=(0, -1.0, 0))
    >>> body = clradar.MovingBody(clradar.Scene.from_mesh(ball), fall)
    >>> print(clradar.MovingScene([body]).at(0.1).vertices_m.min(axis=0).round(3))
    [-0.02 -0.12  0.28]
    """

    bodies: Sequence[Any]
    finish: Callable[[Scene], Scene] | None = None

    def __post_init__(self) -> None:
        bodies = tuple(checks.several("MovingScene.bodies", self.bodies))
        if not bodies or not all(hasattr(body, "during") for body in bodies):
            checks.fail("MovingScene.bodies", "MovingBody or MovingHand, at least one", bodies)
        self._set(bodies=bodies)

    def at(self, time_s: float) -> Scene:
        """Return the scene at a time, as a sweep without duration sees it."""
        return self.seen([body.during(time_s, time_s) for body in self.bodies], time_s)

    def seen(self, bodies: Sequence[BodyInSweep], time_s: float) -> Scene:
        """Return the scene at a time of the sweep that its bodies are of.

        :meta private:
        """
        scenes = [body.scene(time_s) for body in bodies]
        scene = scenes[0] if len(scenes) == 1 else Scene.combine(scenes)
        return scene if self.finish is None else self.finish(scene)
