"""Messages between processes: plain values and arrays, with everything that arrives checked.

A message is the length of a JSON header (8 bytes), the header, and the bytes of its arrays behind
one another. It can hold numbers, strings, None, lists, mappings with string keys and arrays
of numbers or text, and nothing else: unlike a pickle it cannot ask for anything.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np

from clradar.files.limits import MAX_ANSWER_HEADER_BYTES

_CODE = re.compile(r"[<>|](b1|[iuf][1248]|c8|c16|[SU][0-9]{1,9})\Z")


class BrokenMessage(Exception):
    """The message ends early, or is none."""


Link = Any
"""What a message goes through: a socket, or pipes with its `sendall` and `recv_into`."""


def send(link: Link, value: Any) -> None:
    """Send `value`; raises TypeError for what a message cannot hold."""
    arrays: list[np.ndarray] = []
    header = json.dumps(_plain(value, arrays)).encode("ascii")
    link.sendall(len(header).to_bytes(8, "little") + header)
    for array in arrays:
        if array.nbytes:
            link.sendall(array.reshape(-1).view(np.uint8).data)


def receive(link: Link, most_bytes: int) -> Any:
    """Return the next value, whose arrays may have `most_bytes` in all."""
    length = int.from_bytes(_filled(link, bytearray(8)), "little")
    if length > MAX_ANSWER_HEADER_BYTES:
        raise BrokenMessage(f"a header of {length} bytes")
    try:
        header = json.loads(_filled(link, bytearray(length)))
        return _value(header, link, [most_bytes])
    except Exception as error:
        raise BrokenMessage(f"{type(error).__name__}") from error


def _plain(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return `value` as JSON: lists, mappings and arrays carry a tag with their kind."""
    if isinstance(value, np.ndarray):
        code: Any = value.dtype.str
        if value.dtype.names is not None:
            code = [[name, value.dtype[name].str] for name in value.dtype.names]
            value = value.astype([(name, kind) for name, kind in code])  # without padding
        if value.dtype.hasobject:
            raise TypeError("an array of objects")
        arrays.append(np.ascontiguousarray(value))
        return ["array", code, list(value.shape)]
    if isinstance(value, list):
        return ["list", [_plain(item, arrays) for item in value]]
    if isinstance(value, dict):
        return ["mapping", {key: _plain(item, arrays) for key, item in value.items()}]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _value(plain: Any, link: Link, left: list[int]) -> Any:
    if not isinstance(plain, list):
        return plain
    tag, *content = plain
    if tag == "list":
        return [_value(item, link, left) for item in content[0]]
    if tag == "mapping":
        return {key: _value(item, link, left) for key, item in content[0].items()}
    if tag != "array" or not all(type(n) is int and n >= 0 for n in content[1]):
        raise ValueError(tag)
    dtype, shape = _dtype(content[0]), content[1]
    left[0] -= math.prod(shape) * dtype.itemsize
    if left[0] < 0:
        raise ValueError("more bytes than were requested")
    array = np.empty(shape, dtype)
    if array.nbytes:
        _filled(link, array.reshape(-1).view(np.uint8).data)
    return array


def _dtype(code: Any) -> np.dtype[Any]:
    if isinstance(code, list):
        return np.dtype([(str(name), _dtype(part)) for name, part in code])
    if not isinstance(code, str) or not _CODE.match(code):
        raise ValueError(f"type {code!r:.40}")
    return np.dtype(code)


def _filled(link: Link, buffer: Any) -> Any:
    target = memoryview(buffer)
    while len(target):
        count = link.recv_into(target)
        if count == 0:
            raise BrokenMessage("the other end is closed")
        target = target[count:]
    return buffer
