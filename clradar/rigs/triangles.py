"""The triangles of a primitive of glTF 2.0 (specification, section 3.7.2)."""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.files.limits import MAX_MESH_FACES
from clradar.rigs.gltf_file import GltfFile

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def triangles(
    file: GltfFile, what: str, primitive: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return positions (n, 3), float64, and faces (m, 3); None for points, lines and no face."""
    mode = _TRIANGLES if primitive.get("mode") is None else primitive["mode"]
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        return None
    attributes = attributes_of(file, what, primitive)
    if attributes.get("POSITION") is None:
        file.fail(f"{what}: positions", "none")
    positions = file.array(f"{what}: POSITION", attributes["POSITION"]).astype(np.float64)
    if positions.shape[1] != 3 or not np.isfinite(positions).all():
        file.fail(f"{what}: finite positions with 3 coordinates", "NaN, infinite or other ones")
    if primitive.get("indices") is None:
        corners = np.arange(len(positions))
    else:
        raw = file.array(f"{what}: indices", primitive["indices"])
        if raw.dtype.kind != "u" or raw.shape[1] != 1:
            file.fail(f"{what}: indices that are unsigned integers", raw.dtype)
        corners = raw[:, 0].astype(np.int64)
    if len(corners) // (3 if mode == _TRIANGLES else 1) > MAX_MESH_FACES:
        file.fail(f"{what}: at most {MAX_MESH_FACES} triangles", f"{len(corners)} indices")
    if len(corners) and int(corners.max()) >= len(positions):
        file.fail(f"{what}: indices below {len(positions)}", int(corners.max()))
    faces = _faces(file, what, corners, mode)
    return (positions, faces) if len(faces) else None


def attributes_of(file: GltfFile, what: str, primitive: dict[str, Any]) -> dict[str, Any]:
    """Return the accessors of a primitive by the names of their attributes."""
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        file.fail(f"{what}: attributes", type(attributes).__name__)
    return attributes


def _faces(file: GltfFile, what: str, corners: np.ndarray, mode: int) -> np.ndarray:
    if mode == _TRIANGLES:
        if len(corners) % 3:
            file.fail(f"{what}: three indices per triangle", f"{len(corners)}")
        return corners.reshape(-1, 3)
    n = max(len(corners) - 2, 0)
    at = np.arange(n)
    if mode == _FAN:
        return np.stack([corners[np.zeros(n, np.int64)], corners[at + 1], corners[at + 2]], axis=1)
    odd = at % 2  # every second triangle of a strip is turned over
    return np.stack([corners[at], corners[at + 1 + odd], corners[at + 2 - odd]], axis=1)
