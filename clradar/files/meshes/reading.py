"""Read a mesh file in a confined process; the ending of its name decides the format."""

from __future__ import annotations

import io
import re
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from clradar.errors import MeshError
from clradar.files.confined import process
from clradar.files.failures import clean, fail, read_bytes, reading, regular_file_size
from clradar.files.limits import (
    MAX_MESH_BYTES,
    MAX_MESH_FACES,
    MAX_MESH_VERTICES,
    MESH_CPU_BYTES,
    MESH_CPU_S,
    MESH_MEMORY_BYTES,
    MESH_MEMORY_FACTOR,
)
from clradar.files.meshes import gltf_document
from clradar.files.meshes.parts import Parts, parts_of, with_properties

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
    """Read a mesh file, in the confined process; only buffers of glTF are opened for it."""
    kind, options = path.suffix.lower()[1:], dict[str, Any]()
    content = read_bytes(path, EXPECTED, MAX_MESH_BYTES, error=MeshError)
    with reading(path, EXPECTED, error=MeshError):
        if kind in ("glb", "gltf"):
            content, buffers = gltf_document.for_trimesh(path, content)
            options = {"resolver": buffers, "skip_materials": True}
        process.forbid_opening()
        if kind == "obj":
            content, files = _obj_for_trimesh(path, content)
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


# Wavefront OBJ: Object Files (.obj), Advanced Visualizer manual, appendix B1

_UNUSUAL = re.compile(r"^[ \t]+\S|^[fv][tn]?\t|^[ \t]*[fv].*#", re.MULTILINE)
_LINE = re.compile(r"^[ \t]*(v|vt|vn|f)[ \t]+([^#\n]*).*$", re.MULTILINE)
_INDENTED = re.compile(r"^[ \t]+(?=\S)", re.MULTILINE)
_LONG_VERTEX = re.compile(r"^(v(?:[ \t]+[^\s]+){3})[ \t]+\S.*$", re.MULTILINE)
_FEW_CORNERS = r"f(?:[ \t]+[^\s]+){0,2}[ \t]*$"
_NO_VERTEX = r"f (?:.*[ \t])?(?:/|[+]?0+(?=[/ \t]|$)).*$"
_COUNTED_BACK = r"f .*-.*$"  # from their line, which trimesh does from the file's end
_REFUSED = re.compile(f"^(?:{_FEW_CORNERS}|{_NO_VERTEX}|{_COUNTED_BACK})", re.MULTILINE)
_MATERIALS = re.compile(r"^mtllib\b.*", re.MULTILINE)
_MATERIAL = re.compile(r"^usemtl (.*)", re.MULTILINE)


def _obj_for_trimesh(path: Path, content: bytes) -> tuple[bytes, dict[str, bytes]]:
    """Return an OBJ file's content for trimesh, and by its name a file of materials for its own.

    Lines are neither indented nor continued, and vertices are three numbers. With a material file
    of several materials, trimesh calls parts by theirs; that file is not opened, so those that are
    used count.
    """
    # Other encodings occur in comments and names only.
    text = content.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\\\n", " ")
    if _UNUSUAL.search(text):
        text = _INDENTED.sub("", _LINE.sub(r"\1 \2", text))
    text = _LONG_VERTEX.sub(r"\1", text)  # by a weight or colour, which not all need to have
    if refused := _REFUSED.search(text):
        wanted = "a mesh with faces of three corners or more, counted from 1: export it so"
        fail(path, wanted, f"'{clean(refused[0])}'", error=MeshError)
    several = len({name.strip() for name in _MATERIAL.findall(text)}) > 1
    text = _MATERIALS.sub("mtllib materials", text)
    return text.encode(), {"materials": b"newmtl 1\nnewmtl 2\n" if several else b""}
