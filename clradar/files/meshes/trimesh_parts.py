"""Parts of what trimesh holds or reads."""

from __future__ import annotations

import io
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import MeshError
from clradar.files.confined.process import forbid_opening
from clradar.files.failures import clean, fail, reading
from clradar.files.meshes import gltf_document, obj_text
from clradar.files.meshes.parts import Parts, Piece, check_counts
from clradar.files.meshes.ply_parts import with_parts, with_texture


def parts_of(label: str, mesh: Any, *, limited: bool = False, backwards: bool = False) -> Parts:
    """Return the parts of a `trimesh` mesh or scene, `limited` as files, `backwards` as OBJ."""
    import trimesh

    if isinstance(mesh, trimesh.Trimesh):
        piece = Piece("mesh", np.asarray(mesh.vertices), np.asarray(mesh.faces))
        return Parts.joined(label, [piece])
    instances = []
    # trimesh computes with what it finds; what comes of NaN and overflows is checked here.
    with reading(label, "a mesh with a scene graph", error=MeshError), np.errstate(all="ignore"):
        for node in mesh.graph.nodes_geometry:
            matrix, name = mesh.graph[node]
            geometry = mesh.geometry[name]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
                instances.append((str(name), geometry, matrix))
        if backwards:
            instances.reverse()
        if limited:
            vertices = sum(len(geometry.vertices) for _, geometry, _ in instances)
            faces = sum(len(geometry.faces) for _, geometry, _ in instances)
            check_counts(label, parts=len(instances), vertices=vertices, faces=faces)
        pieces = (
            Piece(name, trimesh.transform_points(geometry.vertices, matrix), geometry.faces)
            for name, geometry, matrix in instances
        )
        return Parts.joined(label, pieces)


class _Named(dict[str, bytes]):
    """What trimesh may ask for by the names in a file; it calls a mesh without a name like it."""

    def __init__(self, path: Path, files: dict[str, bytes]) -> None:
        super().__init__(files)
        self.file_name = path.name


class _AnyName(_Named):
    """The same content for every name."""

    def __missing__(self, name: str) -> bytes:
        return self["*"]


def read_with_trimesh(path: Path, content: bytes, kind: str) -> Parts:
    """Return the parts of a mesh file's content; only buffers of glTF are opened for it."""
    options: dict[str, Any] = {}
    if kind in ("glb", "gltf"):
        content, buffers = gltf_document.for_trimesh(path, content)
        options = {"resolver": _Named(path, buffers), "skip_materials": True}
    forbid_opening()
    if kind == "obj":
        content, materials = obj_text.for_trimesh(path, content)
        # By default its objects and groups are merged under the first one's name.
        options = {"split_objects": True, "split_groups": True}
        options["resolver"] = _AnyName(path, {"*": materials})
    scene = _loaded(path, content, kind, options)
    parts = parts_of(str(path), scene, limited=True, backwards=kind == "obj")
    name, *others = parts.names
    if not options and not others and name.startswith("geometry_"):  # trimesh's for none
        parts = replace(parts, names=(path.name,))
    return with_texture(with_parts(parts, scene, content), scene) if kind == "ply" else parts


def _loaded(path: Path, content: bytes, kind: str, options: dict[str, Any]) -> Any:
    import trimesh

    # trimesh would guess the encoding of a text that is no UTF-8, if that package were there.
    sys.modules["charset_normalizer"] = None  # type: ignore[assignment]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # numpy's for numbers that it has left out.
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            # process=False keeps the faces in the file's order, which alpha per face relies on.
            stream = io.BytesIO(content)
            return trimesh.load_scene(stream, file_type=kind, process=False, **options)
    except Exception as error:  # trimesh's readers raise whatever their parsers raise
        got = f"{type(error).__name__}: {clean(error)}"
        if isinstance(error, ModuleNotFoundError):
            got = "bytes that are neither of such a format nor UTF-8 text"
        fail(path, f"a mesh file (.{kind})", got, error=MeshError, cause=error)
