"""A glTF 2.0 file, its buffers, and its accessors as arrays.

Khronos Group, glTF 2.0 Specification, sections 3.6 (binary data storage) and 4 (GLB file format).
"""

from __future__ import annotations

import base64
import binascii
import warnings
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from clradar.rigs.failures import fail, file_bytes, index, reading

EXPECTED = "a glTF 2.0 file"

GLB_MAGIC = b"glTF"
_GLB_HEADER = 12

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

MAX_COUNT = 4_000_000
"""Most elements of an array: an array of zeros needs no bytes of the file."""

# Extensions that do not change the geometry, or are read here.
_HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_light")


class GltfFile:
    """A parsed glTF file, GLB or JSON, with its buffers, which may be in files beside it.

    Its `document` is a `pygltflib.GLTF2`.

    Raises
    ------
    RigError
        Truncated, damaged, of another version, or with a required extension that is not supported.
    """

    def __init__(self, path: Path, content: bytes) -> None:
        self.path = path
        with reading(path, EXPECTED):
            self.document = _parsed(path, content)
            version = str(self.document.asset.version)
            if not version.startswith("2."):
                fail(path, f"{EXPECTED}", f"version {version}")
            for name in self.document.extensionsRequired or []:
                if not str(name).startswith(_HARMLESS):
                    fail(path, "a glTF file that needs no extension for its geometry", name)
            self._buffers = [
                self._buffer(i, buffer) for i, buffer in enumerate(self.document.buffers)
            ]

    def _buffer(self, at: int, buffer: Any) -> bytes:
        what, uri = f"buffer {at}", buffer.uri
        if uri is None:
            blob = self.document.binary_blob() if at == 0 else None
            if blob is None:
                fail(self.path, f"{what} with data", "neither a uri nor a binary chunk")
            data = bytes(blob)
        elif uri.startswith("data:"):
            header, _, body = uri.partition(",")
            if not header.endswith(";base64"):
                fail(self.path, f"{what} in base64", header)
            try:
                data = base64.b64decode(unquote(body), validate=True)
            except (binascii.Error, ValueError) as error:
                fail(self.path, f"{what} in base64", error)
        else:
            data = self._beside(what, unquote(uri))
        length = index(self.path, f"byteLength of {what}", buffer.byteLength, 2**40)
        if len(data) < length:
            fail(self.path, f"{what} of {length} bytes", f"{len(data)}: the file is cut short")
        return data[:length]

    def _beside(self, what: str, name: str) -> bytes:
        folder = self.path.parent.resolve()
        file = (folder / name).resolve()
        if "://" in name or not file.is_relative_to(folder):
            fail(self.path, f"{what} in a file beside it or below", repr(name))
        return file_bytes(file, f"{what} of {self.path.name}")

    def array(self, what: str, accessor: Any) -> np.ndarray:
        """Return the numbers (count, n) of an accessor of the file, normalised if it is flagged.

        The accessor is given by its index, which is checked; `what` names the array in messages.
        """
        with reading(self.path, what):
            listed = self.document.accessors
            entry = listed[index(self.path, f"accessor of {what}", accessor, len(listed))]
            if entry.componentType not in _COMPONENTS or entry.type not in _NUMBERS:
                found = f"type {entry.type} of component type {entry.componentType}"
                fail(self.path, f"{what}: numbers of a known type", found)
            dtype, n = np.dtype(_COMPONENTS[entry.componentType]), _NUMBERS[entry.type]
            count = index(self.path, f"count of {what}", entry.count, MAX_COUNT)
            if entry.bufferView is None:
                values = np.zeros((count, n), dtype)
            else:
                values = self._strided(what, entry.bufferView, entry.byteOffset, dtype, count, n)
            if entry.sparse is not None:
                values = self._replaced(what, values, entry.sparse)
            if dtype.kind == "f" or not entry.normalized:
                return values
            # glTF 2.0, 3.6.2.2: the most negative signed value means -1, too.
            return np.maximum(values / np.iinfo(dtype).max, -1.0)

    def _strided(
        self, what: str, view: Any, offset: Any, dtype: np.dtype[Any], count: int, n: int
    ) -> np.ndarray:
        views = self.document.bufferViews
        entry = views[index(self.path, f"bufferView of {what}", view, len(views))]
        at = index(self.path, f"buffer of {what}", entry.buffer, len(self._buffers))
        size = n * dtype.itemsize
        stride = index(self.path, f"byteStride of {what}", entry.byteStride or size, 253)
        begin = index(self.path, f"byteOffset of {what}", entry.byteOffset or 0, 2**40)
        end = begin + index(self.path, f"byteLength of {what}", entry.byteLength, 2**40)
        first = begin + index(self.path, f"byteOffset of {what}", offset or 0, 2**40)
        last = first + (count - 1) * stride + size
        have = min(end, len(self._buffers[at]))
        if stride < size or (count and last > have):
            fail(self.path, f"{what}: {count} elements up to byte {last} of buffer {at}", f"{have}")
        if count == 0:
            return np.zeros((0, n), dtype)
        return np.ndarray(
            (count, n), dtype, self._buffers[at], first, strides=(stride, dtype.itemsize)
        )

    def _replaced(self, what: str, values: np.ndarray, sparse: Any) -> np.ndarray:
        """Return `values` with the elements that a sparse accessor lists put in their place."""
        count = index(self.path, f"sparse count of {what}", sparse.count, len(values) + 1)
        kind = sparse.indices.componentType
        if kind not in (5121, 5123, 5125):
            fail(self.path, f"sparse indices of {what}: unsigned integers", f"type {kind}")
        place = self._strided(
            what, sparse.indices.bufferView, sparse.indices.byteOffset,
            np.dtype(_COMPONENTS[kind]), count, 1,
        )[:, 0]  # fmt: skip
        if count and int(place.max()) >= len(values):
            fail(self.path, f"sparse indices of {what} below {len(values)}", int(place.max()))
        given = self._strided(
            what, sparse.values.bufferView, sparse.values.byteOffset,
            values.dtype, count, values.shape[1],
        )  # fmt: skip
        replaced = values.copy()
        replaced[place] = given
        return replaced


def _parsed(path: Path, content: bytes) -> Any:
    """Return the document; pygltflib warns of content that it cannot parse, which is refused."""
    from pygltflib import GLTF2

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if not content.startswith(GLB_MAGIC):
            document = GLTF2.gltf_from_json(content.decode("utf-8-sig"))
        else:
            version, length = np.frombuffer(content[4:_GLB_HEADER].ljust(8, b"\0"), "<u4").tolist()
            if version != 2:
                fail(path, "a GLB file of version 2", f"version {version}")
            if len(content) < max(length, _GLB_HEADER):
                fail(path, f"a GLB file of {length} bytes", f"{len(content)}: it is cut short")
            _check_chunks(path, content[:length])
            # Chunks of other types are extensions, to be skipped, of which pygltflib warns.
            warnings.simplefilter("ignore", UserWarning)
            document = GLTF2.load_from_bytes(content[:length])
    if document is None:
        fail(path, "a GLB file with a JSON chunk", "none")
    return document


def _check_chunks(path: Path, content: bytes) -> None:
    at = _GLB_HEADER
    while at < len(content):
        if at + 8 > len(content):
            fail(path, "a GLB file of whole chunks", f"{len(content) - at} bytes at its end")
        length = int.from_bytes(content[at : at + 4], "little")
        if at == _GLB_HEADER and content[at + 4 : at + 8] != b"JSON":
            fail(path, "a GLB file whose first chunk is JSON", content[at + 4 : at + 8])
        at += 8 + length
        if at > len(content):
            fail(path, f"a GLB chunk of {length} bytes", f"{len(content) - at + length}: cut short")
