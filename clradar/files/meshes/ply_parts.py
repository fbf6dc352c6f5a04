"""Named parts and the texture of the mesh in a PLY file.

    comment part 0 palm
    property int part          of the element "face": a number for each
    property float texture_x   of the element "vertex", and y and z: coordinates fixed to the body

Other programs read the same triangles and skip all of it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clradar.files.failures import clean
from clradar.files.meshes.parts import Parts

PROPERTY = "part"
TEXTURE = ("texture_x", "texture_y", "texture_z")

MOST_PARTS = 1000
"""A property "part" with more values than this is something else, such as a number per face."""

MOST_HEADER_BYTES = 2**18  # within which the names are: a thousand with 200 characters


def ply_of_parts(
    vertices_m: np.ndarray,
    faces: np.ndarray,
    part: np.ndarray,
    names: Sequence[str],
    texture_m: np.ndarray | None = None,
) -> bytes:
    """The content of a PLY file with vertices and faces in this order, coordinates in float32."""
    import trimesh

    mesh = trimesh.Trimesh(vertices_m, faces, process=False)
    mesh.face_attributes[PROPERTY] = np.asarray(part, np.int32)
    if texture_m is not None:
        for name, column in zip(TEXTURE, np.asarray(texture_m, np.float32).T, strict=True):
            mesh.vertex_attributes[name] = column
    content: bytes = mesh.export(file_type="ply", vertex_normal=False)
    comments = "".join(f"comment {PROPERTY} {i} {clean(n)}\n" for i, n in enumerate(names))
    magic, form, rest = content.split(b"\n", 2)
    return b"\n".join([magic, form, comments.encode() + rest])


def with_properties(parts: Parts, scene: Any, content: bytes) -> Parts:
    """The mesh of a PLY file, read by trimesh in one part, with its texture and parts if it has."""
    raw = [g.metadata.get("_ply_raw", {}) for g in scene.geometry.values()]

    def column(element: str, name: str, count: int, kinds: str) -> Any:
        """A property of the first mesh as trimesh has read it, or None."""
        try:
            found = np.asarray(raw[0][element]["data"][name]).reshape(-1)
        except (KeyError, TypeError, ValueError, IndexError):
            return None
        return found if len(found) == count and found.dtype.kind in kinds else None

    columns = [column("vertex", name, len(parts.vertices), "iuf") for name in TEXTURE]
    if all(values is not None and np.isfinite(values).all() for values in columns):
        parts = replace(parts, texture=np.stack(columns, axis=1).astype(np.float64))
    # Polygons that were cut into triangles have fewer numbers than there are faces.
    numbers = column("face", PROPERTY, len(parts.faces), "iu")
    if numbers is None:
        return parts
    present, part = np.unique(numbers, return_inverse=True)
    if len(present) > MOST_PARTS:
        return parts
    header = content[:MOST_HEADER_BYTES].split(b"end_header", 1)[0].decode("utf-8", "replace")
    lines = re.findall(rf"^comment {PROPERTY} (\d+) (.*)$", header, re.MULTILINE)
    named = {number.lstrip("0") or "0": clean(name) for number, name in lines}
    names = tuple(named.get(str(number)) or str(number) for number in present)
    return replace(parts, part=part.reshape(-1).astype(np.int32), names=names)
