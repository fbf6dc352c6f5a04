"""Changes to PNG files chunk by chunk, and their checksums made right again."""

from __future__ import annotations

import random
import struct
import zlib

_START = b"\x89PNG\r\n\x1a\n"
DICTIONARY = (b"IHDR", b"IDAT", b"IEND", b"PLTE", b"tRNS", b"iCCP", b"zTXt", b"acTL", b"pHYs")
_SIZES = (0, 1, 255, 65_536, 2**31 - 1, 2**31, 2**32 - 1)


def mutate_chunks(data: bytes, rng: random.Random) -> bytes:
    """Return the file with a chunk deleted, doubled, moved, renamed, or a size in it changed."""
    chunks = _chunks(data)
    if not chunks:
        return data
    at = rng.randrange(len(chunks))
    name, content = chunks[at]
    kind = rng.randrange(6)
    if kind == 0:
        del chunks[at]
    elif kind == 1:
        chunks[at:at] = [chunks[at]] * rng.choice((1, 1, 50))
    elif kind == 2:
        chunks.insert(rng.randrange(len(chunks)), chunks.pop(at))
    elif kind == 3:
        chunks[at] = (rng.choice(DICTIONARY), content)
    elif kind == 4 and len(content) >= 13:
        # Width, height, depth, colour, compression, filter, interlace.
        header = bytearray(content)
        if rng.random() < 0.5:
            header[rng.choice((0, 4)) :][:4] = b""
            place = rng.choice((0, 4))
            header[place : place + 4] = struct.pack(">I", rng.choice(_SIZES))
        else:
            header[rng.randrange(8, 13)] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
        chunks[at] = (name, bytes(header))
    elif name == b"IDAT":
        rows = rng.choice((b"", b"\0" * 2**22, rng.randbytes(200)))
        chunks[at] = (name, zlib.compress(rows))
    return _START + b"".join(_chunk(n, c) for n, c in chunks)


def with_right_checksums(data: bytes) -> bytes:
    """Return the file with the checksum of every chunk made right."""
    chunks = _chunks(data)
    return _START + b"".join(_chunk(n, c) for n, c in chunks) if chunks else data


def _chunk(name: bytes, content: bytes) -> bytes:
    checksum = zlib.crc32(name + content)
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", checksum)


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], len(_START)
    while at + 8 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    return found
