"""Mesh files for tests: glTF from a few numbers, and the OBJ texts that programs write."""

import json
from typing import Any

import numpy as np

CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]], "<f4")
FACES = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]], "<u2")

OBJ_START = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
"""The four corners as lines of an OBJ file."""


def tetrahedron(**changes: Any) -> dict[str, Any]:
    """Return the JSON of a glTF file with one mesh of four triangles; `changes` replace keys."""
    faces, corners = FACES.tobytes(), CORNERS.tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "node", "mesh": 0}],
        "meshes": [{"name": "rock", "primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": FACES.size, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": len(CORNERS), "type": "VEC3"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(faces)},
            {"buffer": 0, "byteOffset": len(faces), "byteLength": len(corners)},
        ],
        "buffers": [{"byteLength": len(faces) + len(corners)}],
    }
    return document | changes


def binary() -> bytes:
    """Return the buffer of `tetrahedron`."""
    return FACES.tobytes() + CORNERS.tobytes()


def glb(document: dict[str, Any], content: bytes | None = None) -> bytes:
    """Return a GLB file of a document and a binary chunk, that of `tetrahedron` if not given."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    content = binary() if content is None else content
    content += bytes(-len(content) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text
    chunks += len(content).to_bytes(4, "little") + b"BIN\0" + content
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks
