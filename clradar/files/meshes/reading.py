"""Read a mesh file in a confined process; the ending of its name decides the format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clradar.errors import ClradarError, MeshError
from clradar.files.confined import process
from clradar.files.failures import fail, read_bytes, reading, regular_file_size
from clradar.files.limits import (
    MAX_MESH_BYTES,
    MAX_MESH_FACES,
    MAX_MESH_VERTICES,
    MESH_CPU_BYTES,
    MESH_CPU_S,
    MESH_MEMORY_BYTES,
    MESH_MEMORY_FACTOR,
)
from clradar.files.meshes.parts import Parts
from clradar.files.meshes.trimesh_parts import read_with_trimesh

FORMATS = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Endings of the names of files that are read."""

EXPECTED = f"a mesh file ({', '.join(FORMATS)})"

_MODULES = ("trimesh", "trimesh.path.entities")  # the latter for lines among the triangles

_MOST_BYTES = 48 * MAX_MESH_VERTICES + 16 * MAX_MESH_FACES


def read_mesh_file(path: Path) -> Parts:
    """Return the parts of a mesh file."""
    size = regular_file_size(path, EXPECTED, error=MeshError)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        fail(path, EXPECTED, f"a name that ends in '{suffix}'", error=MeshError)
    reader = confined_reader(EXPECTED, size, _MOST_BYTES, MeshError, _MODULES)
    found = process.run(reader, _contents, path)
    return Parts(**{**found, "names": tuple(found["names"])})


def confined_reader(
    expected: str,
    size: int,
    most_bytes: int,
    error: type[ClradarError],
    modules: tuple[str, ...] = (),
) -> process.Reader:
    """Return the limits of processor time and memory for reading a mesh or rig of `size` bytes."""
    return process.Reader(
        expected=expected,
        library="its reader",
        cpu_s=MESH_CPU_S + size // MESH_CPU_BYTES,
        memory_bytes=MESH_MEMORY_BYTES + MESH_MEMORY_FACTOR * size,
        most_bytes=most_bytes,
        modules=modules,
        error=error,
    )


def _contents(path: Path) -> dict[str, Any]:
    """Read a mesh file, in the confined process."""
    content = read_bytes(path, EXPECTED, MAX_MESH_BYTES, error=MeshError)
    with reading(path, EXPECTED, error=MeshError):
        parts = read_with_trimesh(path, content, path.suffix.lower()[1:])
    found = {"vertices": parts.vertices, "faces": parts.faces, "part": parts.part}
    if parts.texture is not None:
        found["texture"] = parts.texture
    return {**found, "names": list(parts.names)}
