"""Messages between processes: plain values and arrays, with everything that arrives checked.

A message is the length of a JSON text (8 bytes), the text, and the bytes of its arrays behind one
another, for each of which the text has an object with type and shape. It can hold numbers, strings,
None, lists, mappings with string keys and arrays of numbers or text, and nothing else: unlike a
pickle it cannot ask for anything.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np

from clradar.files.limits import MAX_ANSWER_HEADER_BYTES

_ARRAY = "\0array"
_CODE = re.compile(r"[<>|](b1|[iuf][1248]|c8|c16|[SU][0-9]{1,9})\Z")


class BrokenMessage(Exception):
    """The message ends early, or is none."""


def send(stream: Any, value: Any) -> None:
    """Write `value` to a binary file; raises TypeError for what a message cannot hold."""
    arrays: list[np.ndarray] = []

    def described(array: Any) -> dict[str, Any]:
        if not isinstance(array, np.ndarray) or array.dtype.hasobject:
            raise TypeError(f"{type(array).__name__} cannot be sent")
        code: Any = array.dtype.str
        if array.dtype.names is not None:
            code = [(name, array.dtype[name].str) for name in array.dtype.names]
        arrays.append(np.ascontiguousarray(array, code))  # without padding
        return {_ARRAY: [code, array.shape]}

    text = json.dumps(value, default=described).encode("ascii")
    if text.count(json.dumps(_ARRAY).encode()) != len(arrays):
        raise TypeError("a text that stands for arrays cannot be sent")
    stream.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        if array.nbytes:
            stream.write(array.reshape(-1).view(np.uint8).data)
    stream.flush()


def receive(stream: Any, most_bytes: int) -> Any:
    """Return the next value of a buffered file, whose arrays may have `most_bytes` in all."""
    length = int.from_bytes(_filled(stream, bytearray(8)), "little")
    if length > MAX_ANSWER_HEADER_BYTES:
        raise BrokenMessage(f"a header of {length} bytes")
    left = most_bytes

    def with_arrays(mapping: dict[str, Any]) -> Any:
        """Called for the innermost mappings first, and of arrays in their order."""
        nonlocal left
        if _ARRAY not in mapping:
            return mapping
        code, shape = mapping[_ARRAY]
        dtype = _dtype(code)
        if not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError("a shape")
        left -= math.prod(shape) * dtype.itemsize
        if left < 0:
            raise ValueError("more bytes than were requested")
        array = np.empty(shape, dtype)
        if array.nbytes:
            _filled(stream, array.reshape(-1).view(np.uint8).data)
        return array

    try:
        return json.loads(_filled(stream, bytearray(length)), object_hook=with_arrays)
    except Exception as error:
        raise BrokenMessage(f"{type(error).__name__}") from error


def _dtype(code: Any) -> np.dtype[Any]:
    if isinstance(code, list):
        return np.dtype([(str(name), _dtype(part)) for name, part in code])
    if not isinstance(code, str) or not _CODE.match(code):
        raise ValueError(f"type {code!r:.40}")
    return np.dtype(code)


def _filled(stream: Any, buffer: Any) -> Any:
    if stream.readinto(buffer) < len(buffer):
        raise BrokenMessage("the other end is closed")
    return buffer
