"""Triangles of a mesh in named parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.errors import MeshError
from clradar.files.failures import clean, fail, reading
from clradar.files.limits import MAX_MESH_FACES, MAX_MESH_PARTS, MAX_MESH_VERTICES


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
