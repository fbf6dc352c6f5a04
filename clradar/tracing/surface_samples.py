"""Samples of a body that moves: as many on each face as in one of its states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from clradar.geometry.bvh import face_normals
from clradar.model import Scene

_STATE: ContextVar[Scene | None] = ContextVar("state", default=None)


@contextmanager
def sampled_as(state: Scene) -> Iterator[None]:
    """Give scenes that are simulated in the block the samples of another state of their faces.

    How many samples a face gets depends on the areas of all faces before it: where a body bends,
    samples would otherwise jump from face to face, and what they add from instant to instant.
    """
    token = _STATE.set(state)
    try:
        yield
    finally:
        _STATE.reset(token)


def sampled_triangles_m(scene: Scene) -> np.ndarray:
    """Return the triangles that decide on samples, shape (n_faces, 3, 3), metres."""
    state = _STATE.get()
    if state is None or state.n_faces != scene.n_faces:
        return scene.triangles_m
    return state.triangles_m


def sampled_areas_m2(scene: Scene) -> np.ndarray:
    """Return the areas that decide on samples, shape (n_faces,): 0 where a face has none now."""
    area_m2: np.ndarray = face_normals(scene.triangles_m)[1]
    if _STATE.get() is None:
        return area_m2
    return np.where(area_m2 > 0, face_normals(sampled_triangles_m(scene))[1], 0.0)
