"""Triangles of a mesh in named parts, and how a PLY file has these and a texture.

    comment part 0 palm
    property int part          of the element "face": a number for each
    property float texture_x   of the element "vertex", and y and z: coordinates fixed to the body

Other programs read the same triangles and skip all of it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clradar.errors import MeshError
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import MAX_MESH_FACES, MAX_MESH_PARTS, MAX_MESH_VERTICES

PROPERTY = "part"
TEXTURE = ("texture_x", "texture_y", "texture_z")

MOST_PARTS = 1000
"""A property "part" with more values than this is something else, such as a number per face."""

MOST_HEADER_BYTES = 2**18  # within which the names are: a thousand with 200 characters


@dataclass(frozen=True)
class Parts:
    """A mesh of parts: `part` has the index into `names`, which are not unique, of each face.

    `texture` (n_vertices, 3) are coordinates fixed to the body; like `vertices` in the mesh's unit.
    """

    vertices: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    names: tuple[str, ...]
    texture: np.ndarray | None = None


def parts_of(label: str, mesh: Any, *, limited: bool = False, backwards: bool = False) -> Parts:
    """Return the parts with faces of a `trimesh` mesh or scene, `limited` as files, `backwards` as
    OBJ.
    """
    import trimesh

    # trimesh computes with what it finds; what comes of NaN and overflows is checked by the scene.
    with reading(label, "a mesh with a scene graph", error=MeshError), np.errstate(all="ignore"):
        instances = [("mesh", mesh, None)]
        if not isinstance(mesh, trimesh.Trimesh):
            placed = map(mesh.graph.__getitem__, mesh.graph.nodes_geometry)
            instances = [(str(name), mesh.geometry[name], matrix) for matrix, name in placed]
        instances = [i for i in instances if isinstance(i[1], trimesh.Trimesh) and len(i[1].faces)]
        if not instances:
            fail(label, "a mesh with at least one triangle", "none", error=MeshError)
        if backwards:
            instances.reverse()
        if limited:
            for what, count, most in (
                ("parts", len(instances), MAX_MESH_PARTS),
                ("vertices", sum(len(g.vertices) for _, g, _ in instances), MAX_MESH_VERTICES),
                ("triangles", sum(len(g.faces) for _, g, _ in instances), MAX_MESH_FACES),
            ):
                if count > most:
                    wanted = f"a mesh of at most {most} {what}: simplify or join them"
                    fail(label, wanted, f"{count}", error=MeshError)
        vertices, faces, before = [], [], 0
        for name, geometry, matrix in instances:
            n_vertices = len(geometry.vertices)
            low, high = int(geometry.faces.min()), int(geometry.faces.max())
            if low < 0 or high >= n_vertices:
                wanted = f"a mesh with vertex indices in [0, {n_vertices}) in part '{clean(name)}'"
                fail(label, wanted, f"[{low}, {high}]", error=MeshError)
            vertices.append(trimesh.transform_points(geometry.vertices, matrix))
            faces.append(geometry.faces + before)
            before += n_vertices
        return Parts(
            np.concatenate(vertices),
            np.concatenate(faces).astype(np.int32),
            np.repeat(np.arange(len(faces), dtype=np.int32), list(map(len, faces))),
            tuple(name for name, _, _ in instances),
        )


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
