"""A processor for PoCL to compile for, where PoCL does not know the one it runs on.

PoCL asks its LLVM for the processor's name. On one that is younger than LLVM the answer is
"generic", which PoCL passes on to clang, and clang refuses every program: "unknown target CPU
'generic'" (issues 512 and 1049 of PoCL). PoCL 5 chooses a name by the processor's features instead,
and has a variable for it; before, nothing can be set. The package index has PoCL 3.0 with LLVM 14,
which knows no AMD processor after family 25 and no Intel processor after family 6.

Before PoCL 5 the name is a string on the heap, to which the device's structure points, behind the
pointer to the target triple; PoCL reads it whenever it compiles. Where it is "generic", this module
writes the name over it that PoCL 5 would choose, which is also the one whose library of built-in
functions PoCL uses. Nothing is written unless exactly one such pointer is found, and no other
process sees it.
"""

from __future__ import annotations

import ctypes
import logging
import platform
import re
import sys
import threading
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

POCL = "portable computing language"
FIRST_WITH_NAMES = 5  # from this version on PoCL chooses by features itself
GENERIC = b"generic\0"
TRIPLE = b"x86_64-"
STRUCTURE_BYTES = 1024  # of a device in PoCL 3.0, whose name is at 640; later it is longer
MAPS, PROCESSORS = Path("/proc/self/maps"), Path("/proc/cpuinfo")

_AVX2 = {"avx", "avx2", "cx16", "popcnt", "abm", "f16c", "fma", "bmi1", "bmi2"}
_TARGETS = (
    (_AVX2 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}, b"skylake-avx512\0"),
    (_AVX2, b"haswell\0"),
    (set[str](), b"x86-64\0"),
)

_log = logging.getLogger("clradar")
_lock = threading.Lock()
_named: dict[int, str | None] = {}


def named_target(device: Any) -> str | None:
    """Name the processor for a device of PoCL that does not know it, before its first context.

    None if it knows its processor, or nothing could be done.
    """
    if sys.platform != "linux" or platform.machine() != "x86_64" or not _is_old_pocl(device):
        return None
    with _lock:
        if device.int_ptr not in _named:
            with suppress(OSError):  # where the system's files cannot be read
                _named[device.int_ptr] = _write_name(device)
        return _named.get(device.int_ptr)


def _write_name(device: Any) -> str | None:
    address = _name_address(device.int_ptr)
    target = None if address is None else _target(_room(address))
    if address is None or target is None:
        return None
    ctypes.memmove(address, target, len(target))
    version, name = device.platform.version.split("  ")[0], target[:-1].decode()
    unknown = f"{version} does not know this processor ({device.name.strip()})"
    _log.info("%s: it compiles for %s", unknown, name)
    return name


def _is_old_pocl(device: Any) -> bool:
    if device.platform.name.strip().lower() != POCL:
        return False
    version = re.search(r"PoCL (\d+)\.", device.platform.version, re.IGNORECASE)
    return version is not None and int(version[1]) < FIRST_WITH_NAMES


def _name_address(structure: int) -> int | None:
    """Where the name is, if it is "generic": exactly one pointer, behind that to the triple."""
    maps = _Maps(MAPS.read_text(encoding="ascii", errors="replace"))
    size = 8
    words = [
        int.from_bytes(maps.read(structure + at, size), sys.byteorder)
        for at in range(0, STRUCTURE_BYTES, size)
    ]
    found = [
        word
        for before, word in pairwise(words)
        if maps.read(word, len(GENERIC), writable=True) == GENERIC
        and maps.read(before, len(TRIPLE)) == TRIPLE
    ]
    return found[0] if len(found) == 1 else None


class _Maps:
    """This process' memory, read only where something is mapped."""

    def __init__(self, text: str) -> None:
        found = re.findall(r"^([0-9a-f]+)-([0-9a-f]+) (\S+)", text, re.MULTILINE)
        self._ranges = [(int(start, 16), int(end, 16), access) for start, end, access in found]

    def read(self, address: int, size: int, writable: bool = False) -> bytes:
        """The bytes at an address; none where they cannot be read, or written if they must be."""
        needed = "rw" if writable else "r"
        for start, end, access in self._ranges:
            if start <= address and address + size <= end and access.startswith(needed):
                return ctypes.string_at(address, size)
        return b""


def _room(address: int) -> int:
    """Bytes that the allocation at an address holds."""
    usable = ctypes.CDLL(None).malloc_usable_size
    usable.argtypes, usable.restype = [ctypes.c_void_p], ctypes.c_size_t
    return int(usable(address))


def _target(room: int) -> bytes | None:
    """The best name for this processor's features that fits, with its terminating zero."""
    text = PROCESSORS.read_text(encoding="utf-8", errors="replace")
    flags = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    features = set(flags[1].split()) if flags else set()
    fitting = (name for needed, name in _TARGETS if needed <= features and len(name) <= room)
    return next(fitting, None)
