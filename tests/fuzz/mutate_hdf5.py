"""Changes to an HDF5 file that know its structures, and checksums that are right afterwards.

Since version 2 of its object headers HDF5 keeps checksums of its own structures, so a flipped bit
ends at the first check. A hostile file has right checksums; so have most mutants here.
"""

from __future__ import annotations

import random
import re
import struct
from itertools import islice

from fuzz.mutate_bytes import INTERESTING

_SIGNATURES = (
    b"OHDR", b"OCHK", b"TREE", b"SNOD", b"HEAP", b"GCOL", b"FRHP", b"FHDB", b"FHIB", b"FSHD",
    b"FSSE", b"BTHD", b"BTIN", b"BTLF", b"FAHD", b"FADB", b"EAHD", b"EAIB", b"EASB", b"EADB",
    b"SMTB", b"SMLI", b"MDCI",
)  # fmt: skip
_MOST_STRUCTURES = 200  # a piece that is doubled many times holds any number
_ANY = re.compile(b"|".join(_SIGNATURES))
_NAMES = (
    b"entry", b"data", b"tx_m", b"rx_m", b"frequency_hz", b"x_m", b"origin_m", b"clradar_format",
    b"clradar_version", b"created", b"provenance", b"text_crc32", b"array_name", b"NX_class",
    b"frequency_weight", b"tx_pattern", b"tx_pattern_field",
    b"axes",
)  # fmt: skip
DICTIONARY = (
    *_SIGNATURES,
    *_NAMES,
    b"\x89HDF\r\n\x1a\n",
    b"\xff" * 8,
    b"\0" * 8,
    b"capture",
    b"volume",
)
_SUPERBLOCK = b"\x89HDF\r\n\x1a\n"


def _move_pointer(data: bytes, rng: random.Random) -> bytes:
    """Let an address point to another structure: cycles, and structures of the wrong kind."""
    places = structures(data)
    words = addresses(data, places)
    if not words:
        return data
    at = rng.choice(words)
    value = rng.choice(places) if rng.random() < 0.9 else rng.choice(INTERESTING)
    return data[:at] + struct.pack("<Q", value % 2**64) + data[at + 8 :]


def _edit_structure(data: bytes, rng: random.Random) -> bytes:
    """Put an interesting integer into the first bytes of a structure: its counts and sizes."""
    places = structures(data)
    if not places:
        return data
    at = rng.choice(places) + rng.randrange(4, 120)
    size = rng.choice((1, 1, 2, 4, 8))
    if rng.random() < 0.5:
        at -= at % size
    value = rng.choice((*INTERESTING, rng.randrange(256), len(data)))
    return data[:at] + struct.pack("<Q", value)[:size] + data[at + size :]


def _edit_name(data: bytes, rng: random.Random) -> bytes:
    """Change what stands right before or behind a name: message headers, types, shapes, links."""
    name = rng.choice(_NAMES)
    found = [match.start() for match in re.finditer(re.escape(name), data)]
    if not found:
        return data
    at = rng.choice(found) + rng.choice((-rng.randrange(1, 24), len(name) + rng.randrange(64)))
    at = max(0, at)
    size = rng.choice((1, 1, 2, 4, 8))
    value = rng.choice((*INTERESTING, rng.randrange(256)))
    return data[:at] + struct.pack("<Q", value)[:size] + data[at + size :]


def _swap_structures(data: bytes, rng: random.Random) -> bytes:
    """Put the first bytes of one structure where another one is."""
    places = structures(data)
    if len(places) < 2:
        return data
    source, target = rng.sample(places, 2)
    size = rng.choice((16, 64, 256))
    piece = data[source : source + size]
    return data[:target] + piece + data[target + len(piece) :]


MUTATORS = (
    _move_pointer, _move_pointer, _edit_structure, _edit_structure, _edit_name, _swap_structures,
)  # fmt: skip


def structures(data: bytes) -> list[int]:
    """Return where the file's structures begin, as far as they carry a signature."""
    return [match.start() for match in islice(_ANY.finditer(data), _MOST_STRUCTURES)]


def addresses(data: bytes, places: list[int]) -> list[int]:
    """Return where the address of one of these places is written, and those in v1 headers."""
    found = []
    for place in places:
        raw = struct.pack("<Q", place)
        at = data.find(raw)
        while at >= 0 and len(found) < 2000:
            found.append(at)
            at = data.find(raw, at + 1)
    # Version 1 object headers have no signature; hard links to them stand in symbol tables.
    for match in re.finditer(b"SNOD", data):
        found += [match.start() + 8 + 40 * i + 8 for i in range(4)]
    return [at for at in found if at + 8 <= len(data)]


def with_right_checksums(data: bytes) -> bytes:
    """Return the file with the checksums of its structures set to what they have to be."""
    out = bytearray(data)
    for start, end in _checksummed(data):
        if 0 <= start < end and end + 4 <= len(out):
            out[end : end + 4] = struct.pack("<I", lookup3(bytes(out[start:end])))
    return bytes(out)


def _checksummed(data: bytes) -> list[tuple[int, int]]:
    """Return (start, end) of every structure whose checksum stands at its end."""
    spans = []
    if data.startswith(_SUPERBLOCK) and len(data) > 48 and data[8] >= 2:
        spans.append((0, 44))
    for match in islice(_ANY.finditer(data), _MOST_STRUCTURES):
        at = match.start()
        kind = match.group()
        if kind == b"OHDR":
            spans += _header_spans(data, at)
        elif kind == b"BTHD":
            spans.append((at, at + 34))
        elif kind == b"FRHP":
            spans.append((at, at + 142))
        elif kind == b"FAHD":
            size = (
                int.from_bytes(data[at + 8 : at + 16], "little") * data[min(at + 6, len(data) - 1)]
            )
            block = int.from_bytes(data[at + 16 : at + 24], "little")
            spans.append((at, at + 24))
            if data[block : block + 4] == b"FADB" and size < 65536:
                spans.append((block, block + 14 + size))
        elif kind == b"EAHD":
            spans.append((at, at + 68))
    return spans


def _header_spans(data: bytes, at: int) -> list[tuple[int, int]]:
    """Spans of a version 2 object header and of the chunks that continue it."""
    if at + 16 > len(data):
        return []
    flags = data[at + 5]
    start = at + 6 + (16 if flags & 32 else 0) + (4 if flags & 16 else 0)
    width = 1 << (flags & 3)
    first = start + width
    end = first + int.from_bytes(data[start:first], "little")
    if end + 4 > len(data):
        return []
    spans = [(at, end)]
    message_header = 6 if flags & 4 else 4
    todo = [(first, end)]
    while todo and len(spans) < 32:
        place, stop = todo.pop()
        while place + message_header <= stop:
            size = int.from_bytes(data[place + 1 : place + 3], "little")
            if data[place] == 0x10:
                body = place + message_header
                chunk, length = struct.unpack("<QQ", data[body : body + 16].ljust(16, b"\0"))
                if data[chunk : chunk + 4] == b"OCHK" and 8 <= length <= len(data) - chunk:
                    spans.append((chunk, chunk + length - 4))
                    todo.append((chunk + 4, chunk + length - 4))
            place += message_header + size
    return spans


def lookup3(data: bytes) -> int:
    """Return Bob Jenkins' lookup3 hash (2006, public domain), HDF5's checksum of its structures."""
    mask = 0xFFFFFFFF
    a = b = c = (0xDEADBEEF + len(data)) & mask
    if not data:
        return c
    rest = (len(data) - 1) // 12 * 12  # at least one byte is left for the end
    words = struct.unpack(f"<{rest // 4}I", data[:rest])
    for i in range(0, len(words), 3):
        a, b, c = (a + words[i]) & mask, (b + words[i + 1]) & mask, (c + words[i + 2]) & mask
        a = (a - c) & mask ^ _rotated(c, 4)
        c = (c + b) & mask
        b = (b - a) & mask ^ _rotated(a, 6)
        a = (a + c) & mask
        c = (c - b) & mask ^ _rotated(b, 8)
        b = (b + a) & mask
        a = (a - c) & mask ^ _rotated(c, 16)
        c = (c + b) & mask
        b = (b - a) & mask ^ _rotated(a, 19)
        a = (a + c) & mask
        c = (c - b) & mask ^ _rotated(b, 4)
        b = (b + a) & mask
    x, y, z = struct.unpack("<3I", data[rest:].ljust(12, b"\0"))
    a, b, c = (a + x) & mask, (b + y) & mask, (c + z) & mask
    c = ((c ^ b) - _rotated(b, 14)) & mask
    a = ((a ^ c) - _rotated(c, 11)) & mask
    b = ((b ^ a) - _rotated(a, 25)) & mask
    c = ((c ^ b) - _rotated(b, 16)) & mask
    a = ((a ^ c) - _rotated(c, 4)) & mask
    b = ((b ^ a) - _rotated(a, 14)) & mask
    return ((c ^ b) - _rotated(b, 24)) & mask


def _rotated(value: int, bits: int) -> int:
    return (value << bits | value >> (32 - bits)) & 0xFFFFFFFF
