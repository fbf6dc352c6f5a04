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

MOST_HEADER_BYTES = 2**18
"""Within which the names are: a thousand with 200 characters."""


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


def with_texture(parts: Parts, scene: Any) -> Parts:
    """The texture of a PLY file's mesh, if its vertices have the properties and no NaN in them."""
    columns = [_property(scene, "vertex", name) for name in TEXTURE]
    if any(len(column) != len(parts.vertices) for column in columns):
        return parts
    texture = np.stack(columns, axis=1)
    if texture.dtype.kind not in "iuf" or not np.isfinite(texture).all():
        return parts
    return replace(parts, texture=texture.astype(np.float64))


def _property(scene: Any, element: str, name: str) -> np.ndarray:
    """What trimesh has read of a property, of the first mesh; empty if there is none."""
    properties = [g.metadata.get("_ply_raw", {}).get(element, {}) for g in scene.geometry.values()]
    try:
        return np.asarray(properties[0]["data"][name]).reshape(-1)
    except (KeyError, TypeError, ValueError, IndexError):
        return np.empty(0)


def with_parts(parts: Parts, scene: Any, content: bytes) -> Parts:
    """The parts of a PLY file's mesh as trimesh has read it in one part."""
    numbers = _property(scene, "face", PROPERTY)
    # Polygons that were cut into triangles have fewer numbers than there are faces.
    if numbers.dtype.kind not in "iu" or len(numbers) != len(parts.faces):
        return parts
    present, part = np.unique(numbers, return_inverse=True)
    if len(present) > MOST_PARTS:
        return parts
    header = content[:MOST_HEADER_BYTES].split(b"end_header", 1)[0].decode("utf-8", "replace")
    lines = re.findall(rf"^comment {PROPERTY} (\d+) (.*)$", header, re.MULTILINE)
    named = {number.lstrip("0") or "0": clean(name) for number, name in lines}
    names = tuple(named.get(str(number)) or str(number) for number in present)
    return replace(parts, part=part.reshape(-1).astype(np.int32), names=names)
