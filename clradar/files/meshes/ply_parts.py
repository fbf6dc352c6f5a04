"""Named parts of the mesh in a PLY file: a number for each face, and comments with the names.

    comment part 0 palm
    property int part          of the element "face"

Other programs read the same triangles and skip both.
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

MOST_PARTS = 1000
"""A property "part" with more values than this is something else, such as a number per face."""

MOST_HEADER_BYTES = 2**18
"""Within which the names are: a thousand with 200 characters."""


def ply_of_parts(
    vertices_m: np.ndarray, faces: np.ndarray, part: np.ndarray, names: Sequence[str]
) -> bytes:
    """The content of a PLY file with vertices and faces in this order, coordinates in float32.

    Parameters
    ----------
    vertices_m : ndarray, shape (n_vertices, 3), metres
    faces : ndarray, shape (n_faces, 3)
    part : ndarray, shape (n_faces,)
        Index into `names` of each face.
    names : sequence of str

    Examples
    --------
    >>> import numpy as np
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> ply_of_parts(corners, np.array([[0, 1, 2]]), np.array([0]), ["palm"]).splitlines()[2]
    b'comment part 0 palm'
    """
    import trimesh

    mesh = trimesh.Trimesh(vertices_m, faces, process=False)
    mesh.face_attributes[PROPERTY] = np.asarray(part, np.int32)
    content: bytes = mesh.export(file_type="ply", vertex_normal=False)
    comments = "".join(f"comment {PROPERTY} {i} {clean(n)}\n" for i, n in enumerate(names))
    magic, form, rest = content.split(b"\n", 2)
    return b"\n".join([magic, form, comments.encode() + rest])


def with_parts(parts: Parts, scene: Any, content: bytes) -> Parts:
    """The parts of a PLY file's mesh, if its faces have a property "part" of whole numbers.

    Parameters
    ----------
    parts : Parts
        As read, in one part.
    scene : trimesh.Scene
        What trimesh has read from the file.
    content : bytes
        Of the file. A part without a name in it has its number as name.
    """
    properties = [g.metadata.get("_ply_raw", {}).get("face", {}) for g in scene.geometry.values()]
    try:
        numbers = np.asarray(properties[0]["data"][PROPERTY]).reshape(-1)
    except (KeyError, TypeError, ValueError, IndexError):
        return parts
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
