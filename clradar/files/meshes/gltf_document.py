"""The JSON of a glTF 2.0 file, and the buffers that it has in files beside it.

Khronos Group, glTF 2.0 Specification, sections 3.3 (scenes), 3.6 (buffers) and 4 (GLB).
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from clradar.errors import ClradarError, MeshError, ModelError
from clradar.files import limits
from clradar.files.failures import clean, fail, read_bytes, reading
from clradar.files.json_file import parse_object

EXPECTED = "a glTF 2.0 file"

GLB_MAGIC = b"glTF"
_GLB_START = 20  # the header, and that of the first chunk, which is JSON

# Extensions that do not change the geometry, or that every reader of accessors knows.
_HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_light")

_FAN = 6
_URI = re.compile(rb'"uri"\s*:\s*("(?!data:)(?:[^"\\]|\\.)+")')


def check_document(version: object, extensions: object) -> None:
    """Raise `ModelError` unless it is glTF 2 that needs no extension for its geometry."""
    if not str(version).startswith("2."):
        raise ModelError(f"asset: expected glTF 2.0, got version {version}")
    for name in extensions if isinstance(extensions, list) else []:
        if not str(name).startswith(_HARMLESS):
            raise ModelError(f"extensionsRequired: expected none for the geometry, got {name}")


def bytes_beside(path: Path, what: str, name: str, most: int, error: type[ClradarError]) -> bytes:
    """Return the content of a regular file in the folder of `path` or below, of `most` bytes."""
    folder = path.parent.resolve()
    file = (folder / name).resolve()
    if "://" in name or not file.is_relative_to(folder):
        fail(path, f"{what} in a file beside it or below", clean(repr(name)), error=error)
    return read_bytes(file, f"{what} of {path.name}", most, error=error)


def files_of(path: Path) -> list[Path]:
    """Return the file of a mesh or rig, and the files that glTF names: buffers and pictures."""
    if path.suffix.lower() not in (".glb", ".gltf"):
        return [path]
    content = read_bytes(path, EXPECTED, limits.MAX_MESH_BYTES, error=MeshError)
    with reading(path, EXPECTED, error=MeshError):
        named = (unquote(json.loads(name)) for name in _URI.findall(content))
        # Each once, however it is spelled.
        beside = dict.fromkeys(Path(os.path.normpath(path.parent / name)) for name in named)
        return [path, *filter(Path.is_file, beside)]


def glb_text(content: bytes) -> bytes:
    """Return the JSON of a binary glTF file, its first chunk."""
    return content[_GLB_START : _GLB_START + int.from_bytes(content[12:16], "little")]


def for_trimesh(path: Path, content: bytes) -> tuple[bytes, dict[str, bytes]]:
    """Return a glTF file's content for trimesh, and by their names the buffers in other files."""
    text, rest, binary = content, b"", content.startswith(GLB_MAGIC)
    if binary:
        text = glb_text(content)
        rest = content[_GLB_START + len(text) :]
    with reading(path, EXPECTED, error=MeshError):
        document = parse_object(text.decode("utf-8-sig"))
        version = (document.get("asset") or {}).get("version")
        check_document(version, document.get("extensionsRequired"))
        nodes = document.get("nodes") or []
        parents, _ = parents_and_order([node.get("children") or [] for node in nodes])
        _check_meshes(document)
        buffers = _buffers_beside(path, document.get("buffers") or [], binary=binary)
        if not document.get("scenes"):
            scene = {"nodes": [at for at, parent in enumerate(parents) if parent < 0]}
            document |= {"scene": 0, "scenes": [scene]}
        for node in nodes:
            node.pop("camera", None)  # trimesh takes none of such a node's triangles
        text = json.dumps(document).encode()
    if binary:
        text = content[:12] + len(text).to_bytes(4, "little") + content[16:_GLB_START] + text
    return text + rest, buffers


def parents_and_order(children: list[list[int]]) -> tuple[list[int], list[int]]:
    """Return the parent of each node, -1 of a root, and all nodes, each after its parent."""
    count, order = len(children), list[int]()
    parents = [-1] * count
    if count > limits.MAX_MESH_NODES:
        raise ModelError(f"nodes: expected at most {limits.MAX_MESH_NODES}, got {count}")
    for at, below in enumerate(children):
        for child in below:
            if child not in range(count) or parents[child] >= 0:
                wanted = f"one of {count} nodes, and of no other node"
                raise ModelError(f"child {child!r} of node {at}: expected {wanted}")
            parents[child] = at
    level = [at for at, parent in enumerate(parents) if parent < 0]
    for _ in range(limits.MAX_MESH_DEPTH):
        order += level
        level = [child for at in level for child in children[at]]
    if level:
        raise ModelError(f"nodes: expected at most {limits.MAX_MESH_DEPTH} levels, got more")
    if len(order) < count:
        raise ModelError(f"nodes: expected trees, got {count - len(order)} in a cycle")
    return parents, order


def _check_meshes(document: dict[str, Any]) -> None:
    """Raise `ModelError` for triangles that trimesh passes over or reads as others."""
    meshes, accessors = document.get("meshes") or [], document.get("accessors") or []
    for at, node in enumerate(document.get("nodes") or []):
        if (index := node.get("mesh")) is not None and index not in range(len(meshes)):
            raise ModelError(f"mesh of node {at}: expected below {len(meshes)}, got {index!r}")
    for mesh in meshes:
        for primitive in mesh["primitives"]:
            got = "a fan" if primitive.get("mode") == _FAN else ""
            position = accessors[primitive["attributes"]["POSITION"]]
            used = [position]
            if primitive.get("indices") is not None:
                used.append(accessors[primitive["indices"]])
            if any(accessor.get("sparse") is not None for accessor in used):
                got = "sparse ones"
            if position.get("normalized"):
                got = "normalized positions"
            if got:
                wanted = "plain lists or strips of triangles: export it so"
                raise ModelError(f"glTF mesh: expected {wanted}, got {got}")


def _buffers_beside(path: Path, buffers: list[Any], *, binary: bool) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for at, buffer in enumerate(buffers):
        uri = buffer.get("uri")
        if uri is None and not (binary and at == 0):
            raise ModelError(f"buffer {at}: expected a uri or a binary chunk, got neither")
        if uri is None or "base64," in uri or uri in found:
            continue
        left = limits.MAX_MESH_BUFFERS_BYTES - sum(map(len, found.values()))
        found[uri] = bytes_beside(path, f"buffer {at}", unquote(uri), left, MeshError)
    return found
