"""Read a mesh file in a confined process; the ending of its name decides the format."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from clradar.errors import MeshError
from clradar.files.confined import process
from clradar.files.failures import clean, fail, reading, regular_file_size
from clradar.files.limits import (
    MAX_MESH_BYTES,
    MAX_MESH_FACES,
    MAX_MESH_VERTICES,
    MESH_CPU_BYTES,
    MESH_CPU_S,
    MESH_MEMORY_BYTES,
    MESH_MEMORY_FACTOR,
)
from clradar.files.meshes import gltf_document, obj_text
from clradar.files.meshes.parts import Parts, parts_of
from clradar.files.meshes.ply_parts import with_properties

FORMATS = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Endings of the names of files that are read."""

EXPECTED = f"a mesh file ({', '.join(FORMATS)})"

_MODULES = ("trimesh", "trimesh.path.entities")  # the latter for lines among the triangles

_MOST_BYTES = 48 * MAX_MESH_VERTICES + 16 * MAX_MESH_FACES


def read_mesh_file(path: Path) -> Parts:
    """Return the parts of a mesh file."""
    regular_file_size(path, EXPECTED, error=MeshError)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        fail(path, EXPECTED, f"a name that ends in '{suffix}'", error=MeshError)
    options = {"most_bytes": _MOST_BYTES, "error": MeshError, "modules": _MODULES}
    found = run_confined(_contents, path, expected=EXPECTED, **options)
    return Parts(**{**found, "names": tuple(found["names"])})


def run_confined(function: Callable[..., Any], path: Path, *arguments: Any, **options: Any) -> Any:
    """As `process.run`, with the limits of processor time and memory of a mesh or rig."""
    size = regular_file_size(path, options["expected"], error=options["error"])
    options["cpu_s"] = MESH_CPU_S + size // MESH_CPU_BYTES
    options["memory_bytes"] = MESH_MEMORY_BYTES + MESH_MEMORY_FACTOR * size
    return process.run(function, path, *arguments, **options)


def _contents(path: Path) -> dict[str, Any]:
    """Read a mesh file, in the confined process."""
    kind, options = path.suffix.lower()[1:], dict[str, Any]()
    content = process.file_bytes(path, EXPECTED, MAX_MESH_BYTES, error=MeshError)
    with reading(path, EXPECTED, error=MeshError):
        if kind in ("glb", "gltf"):
            content = gltf_document.for_trimesh(path, content)
            options = {"skip_materials": True}
        if kind == "obj":
            content, files = obj_text.for_trimesh(path, content)
            # By default its objects and groups are merged under the first one's name.
            options = {"split_objects": True, "split_groups": True, "resolver": files}
        scene = _loaded(path, content, kind, options)
        parts = parts_of(str(path), scene, limited=True, backwards=kind == "obj")
        name, *others = parts.names
        if not options and not others and name.startswith("geometry_"):  # trimesh's for none
            parts = replace(parts, names=(path.name,))
        if kind == "ply":
            parts = with_properties(parts, scene, content)
    return vars(parts)


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
            stream: Any = io.BytesIO(content)
            if kind == "obj":
                stream.name = path.name  # by which trimesh calls a mesh without a name
            return trimesh.load_scene(stream, file_type=kind, process=False, **options)
    except Exception as error:  # trimesh's readers raise whatever their parsers raise
        got = f"{type(error).__name__}: {clean(error)}"
        if isinstance(error, ModuleNotFoundError):
            got = "bytes that are neither of such a format nor UTF-8 text"
        fail(path, f"a mesh file (.{kind})", got, error=MeshError, cause=error)
