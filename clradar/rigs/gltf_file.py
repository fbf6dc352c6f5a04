"""A glTF 2.0 file, its buffers, and its accessors as arrays.

Khronos Group, glTF 2.0 Specification, sections 3.6 (binary data storage) and 4 (GLB file format).
"""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np

from clradar.errors import RigError
from clradar.files.confined.process import forbid_opening
from clradar.files.limits import MAX_GLTF_NUMBERS, MAX_MESH_BUFFERS_BYTES
from clradar.files.meshes.gltf_document import EXPECTED, GLB_MAGIC, bytes_beside, parsed
from clradar.rigs.failures import fail, reading

_GLB_HEADER = 12

_COMPONENTS = {
    "5120": "<i1", "5121": "<u1", "5122": "<i2", "5123": "<u2", "5125": "<u4", "5126": "<f4",
}  # fmt: skip
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class GltfFile:
    """A glTF file, GLB or JSON, with its buffers, which may be in files beside it.

    Once they are read, the confined process that this runs in can open nothing any more. Nothing of
    `document` is known to be of the right type.
    """

    def __init__(self, path: Path, content: bytes) -> None:
        self.path = path
        self._lists: dict[str, list[dict[str, Any]]] = {}
        self._numbers_left = MAX_GLTF_NUMBERS
        self._bytes_left = MAX_MESH_BUFFERS_BYTES
        with reading(path, EXPECTED):
            text, self._binary = content, None
            if content.startswith(GLB_MAGIC):
                text, self._binary = self._chunks(content)
            self.document = parsed(path, text, RigError)
            self._buffers = [self._buffer(i, b) for i, b in enumerate(self.listed("buffers"))]
        forbid_opening()

    def fail(self, expected: str, got: object) -> NoReturn:
        """Raise the error that names the file, what was expected and what was found."""
        fail(self.path, expected, got)

    def index(self, what: str, value: Any, count: int) -> int:
        """Return `value` if it is a whole number in [0, count)."""
        if type(value) is not int or not 0 <= value < count:
            self.fail(f"{what}: a whole number in [0, {count})", repr(value))
        return value

    def listed(self, name: str) -> list[dict[str, Any]]:
        """Return the objects that the document lists under a name, such as "nodes"."""
        if name not in self._lists:
            self._lists[name] = self.objects(name, self.document.get(name))
        return self._lists[name]

    def objects(self, what: str, values: Any) -> list[dict[str, Any]]:
        """Return `values` if it is a list of objects; nothing given is an empty one."""
        values = [] if values is None else values
        if not isinstance(values, list) or not all(isinstance(v, dict) for v in values):
            self.fail(f"{what}: a list of objects", type(values).__name__)
        return values

    def numbers_of(self, what: str, values: Any) -> list[Any]:
        """Return `values` if it is a list; nothing given is an empty one."""
        values = [] if values is None else values
        if not isinstance(values, list):
            self.fail(f"{what}: a list", type(values).__name__)
        return values

    def _chunks(self, content: bytes) -> tuple[bytes, bytes | None]:
        """Return the JSON of a GLB file, and its binary chunk if there is one."""
        version, length = np.frombuffer(content[4:_GLB_HEADER].ljust(8, b"\0"), "<u4").tolist()
        if version != 2:
            self.fail("a GLB file of version 2", f"version {version}")
        if len(content) < max(length, _GLB_HEADER):
            self.fail(f"a GLB file of {length} bytes", f"{len(content)}: it is cut short")
        found: list[tuple[bytes, bytes]] = []
        at = _GLB_HEADER
        while at < length:
            if at + 8 > length:
                self.fail("a GLB file of whole chunks", f"{length - at} bytes at its end")
            size, kind = int.from_bytes(content[at : at + 4], "little"), content[at + 4 : at + 8]
            at += 8
            if at + size > length:
                self.fail(f"a GLB chunk of {size} bytes", f"{length - at}: cut short")
            if not found and kind != b"JSON":
                self.fail("a GLB file whose first chunk is JSON", kind)
            if len(found) < 2:  # those behind are extensions, to be skipped
                found.append((kind, content[at : at + size]))
            at += size
        if not found:
            self.fail("a GLB file with a JSON chunk", "none")
        second = found[1:] and found[1][0] == b"BIN\0"
        return found[0][1], found[1][1] if second else None

    def _buffer(self, at: int, buffer: dict[str, Any]) -> bytes:
        what, uri = f"buffer {at}", buffer.get("uri")
        if uri is None:
            if at > 0 or self._binary is None:
                self.fail(f"{what} with data", "neither a uri nor a binary chunk")
            data = self._binary
        elif not isinstance(uri, str):
            self.fail(f"{what}: a uri", repr(uri))
        elif uri.startswith("data:"):
            header, _, body = uri.partition(",")
            if not header.endswith(";base64"):
                self.fail(f"{what} in base64", header)
            try:
                data = base64.b64decode(unquote(body), validate=True)
            except (binascii.Error, ValueError) as error:
                self.fail(f"{what} in base64", error)
        else:
            data = bytes_beside(self.path, what, unquote(uri), self._bytes_left, RigError)
            self._bytes_left -= len(data)
        length = self.index(f"byteLength of {what}", buffer.get("byteLength"), 2**40)
        if len(data) < length:
            self.fail(f"{what} of {length} bytes", f"{len(data)}: the file is cut short")
        return data[:length]

    def array(self, what: str, accessor: Any) -> np.ndarray:
        """Return the numbers (count, n) of an accessor of the file, normalised if it is flagged.

        The accessor is given by its index, which is checked; `what` names the array in messages.
        """
        with reading(self.path, what):
            listed = self.listed("accessors")
            entry = listed[self.index(f"accessor of {what}", accessor, len(listed))]
            component, kind = entry.get("componentType"), entry.get("type")
            # As text, since what is no number may not even be a key.
            code, n = _COMPONENTS.get(str(component)), _NUMBERS.get(str(kind))
            if code is None or n is None:
                found = f"type {kind} of component type {component}"
                self.fail(f"{what}: numbers of a known type", found)
            dtype = np.dtype(code)
            count = self.index(f"count of {what}", entry.get("count"), 2**40)
            self._numbers_left -= count * n
            if self._numbers_left < 0:
                most = f"a mesh of at most {MAX_GLTF_NUMBERS} numbers, with all uses of them"
                self.fail(most, f"{count} elements more for {what}")
            if entry.get("bufferView") is None:
                values = np.zeros((count, n), dtype)
            else:
                view, offset = entry["bufferView"], entry.get("byteOffset")
                values = self._strided(what, view, offset, dtype, count, n)
            if entry.get("sparse") is not None:
                values = self._replaced(what, values, entry["sparse"])
            if dtype.kind == "f" or not entry.get("normalized"):
                return values
            # glTF 2.0, 3.6.2.2: the most negative signed value means -1, too.
            return np.maximum(values / np.iinfo(dtype).max, -1.0)

    def _strided(
        self, what: str, view: Any, offset: Any, dtype: np.dtype[Any], count: int, n: int
    ) -> np.ndarray:
        views = self.listed("bufferViews")
        entry = views[self.index(f"bufferView of {what}", view, len(views))]
        at = self.index(f"buffer of {what}", entry.get("buffer"), len(self._buffers))
        size = n * dtype.itemsize
        stride = self.index(f"byteStride of {what}", entry.get("byteStride") or size, 253)
        begin = self.index(f"byteOffset of {what}", entry.get("byteOffset") or 0, 2**40)
        end = begin + self.index(f"byteLength of {what}", entry.get("byteLength"), 2**40)
        first = begin + self.index(f"byteOffset of {what}", offset or 0, 2**40)
        last = first + (count - 1) * stride + size
        have = min(end, len(self._buffers[at]))
        if stride < size or (count and last > have):
            self.fail(f"{what}: {count} elements up to byte {last} of buffer {at}", f"{have}")
        if count == 0:
            return np.zeros((0, n), dtype)
        return np.ndarray(
            (count, n), dtype, self._buffers[at], first, strides=(stride, dtype.itemsize)
        )

    def _replaced(self, what: str, values: np.ndarray, sparse: Any) -> np.ndarray:
        """Return `values` with the elements that a sparse accessor lists put in their place."""
        sparse, indices, given = self.objects(
            f"sparse {what}, its indices and values",
            [sparse, *(sparse.get(name) for name in ("indices", "values"))]
            if isinstance(sparse, dict)
            else [sparse],
        )
        count = self.index(f"sparse count of {what}", sparse.get("count"), len(values) + 1)
        kind = str(indices.get("componentType"))
        if kind not in ("5121", "5123", "5125"):
            self.fail(f"sparse indices of {what}: unsigned integers", f"type {kind}")
        place = self._strided(
            what, indices.get("bufferView"), indices.get("byteOffset"),
            np.dtype(_COMPONENTS[kind]), count, 1,
        )[:, 0]  # fmt: skip
        if count and int(place.max()) >= len(values):
            self.fail(f"sparse indices of {what} below {len(values)}", int(place.max()))
        replacing = self._strided(
            what, given.get("bufferView"), given.get("byteOffset"),
            values.dtype, count, values.shape[1],
        )  # fmt: skip
        replaced = values.copy()
        replaced[place] = replacing
        return replaced
