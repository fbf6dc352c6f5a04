"""Changes that know nothing of the format: bits, lengths, pieces cut, doubled and moved."""

from __future__ import annotations

import random
import struct
from collections.abc import Sequence

INTERESTING = tuple(
    sorted(
        {0, 1, 2, 3, 7, 8, 16, 100, 127, 128, 255, 256, 1000, 4096, 32767, 32768, 65535, 65536}
        | {2**k + d for k in (24, 31, 32, 40, 48, 62, 63, 64) for d in (-1, 0)} - {2**64}
    )
)
"""Where sizes, counts and offsets go wrong: the ends of the integer types, and just beside."""

MAX_GROWTH = 2**16
"""No input gets longer than its seed by more than this: what is tried is damage, not size."""


def mutate(
    data: bytes, rng: random.Random, dictionary: Sequence[bytes], others: Sequence[bytes]
) -> bytes:
    """Return `data` with one change."""
    if not data:
        return rng.choice(others)
    return rng.choice(_CHANGES)(data, rng, dictionary, others)


def somewhere(data: bytes, rng: random.Random) -> int:
    """Return a position; more often near the ends, and not in a run of zeros, which is padding."""
    kind = rng.random()
    if kind < 0.35:
        at = min(len(data) - 1, int(rng.expovariate(1 / 300)))
    elif kind < 0.5:
        at = max(0, len(data) - 1 - int(rng.expovariate(1 / 150)))
    else:
        at = rng.randrange(len(data))
    for _ in range(64):
        if data[at] or rng.random() < 0.1:
            break
        at = (at + 1) % len(data)
    return at


def _flip_bit(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    at = somewhere(data, rng)
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]


def _set_byte(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    at = somewhere(data, rng)
    return (
        data[:at]
        + bytes([rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))])
        + data[at + 1 :]
    )


def _set_integer(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    size = rng.choice((1, 2, 4, 4, 8, 8))
    at = somewhere(data, rng)
    if rng.random() < 0.5:
        at -= at % size
    value = rng.choice((*INTERESTING, len(data), len(data) - at, rng.randrange(len(data))))
    raw = struct.pack("<Q" if rng.random() < 0.9 else ">Q", value)
    raw = raw[:size] if raw[0] or rng.random() < 0.9 else raw[-size:]
    return data[:at] + raw + data[at + size :]


def _add_to_integer(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    size = rng.choice((1, 2, 4, 8))
    at = somewhere(data, rng)
    value = int.from_bytes(data[at : at + size], "little") + rng.choice((-1, 1, -8, 8, 16, 255))
    return data[:at] + (value % 256**size).to_bytes(size, "little") + data[at + size :]


def _truncate(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    return data[: somewhere(data, rng)]


def _delete(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    at = somewhere(data, rng)
    return data[:at] + data[at + rng.choice((1, 1, 2, 4, 8, 64, rng.randrange(1, 4096))) :]


def _double(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    at = somewhere(data, rng)
    piece = data[at : at + rng.choice((1, 4, 8, 16, 64, 512, 4096))]
    times = rng.choice((1, 1, 1, 2, 16, 256))
    return data[:at] + piece * min(times, MAX_GROWTH // max(1, len(piece))) + data[at:]


def _move(data: bytes, rng: random.Random, _d: object, _o: object) -> bytes:
    size = rng.choice((1, 2, 4, 8, 16, 64, 512))
    source, target = somewhere(data, rng), somewhere(data, rng)
    return data[:target] + data[source : source + size] + data[target + size :]


def _splice(data: bytes, rng: random.Random, _d: object, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others) or b"\0"
    at = somewhere(data, rng)
    start = at if rng.random() < 0.5 and at < len(other) else somewhere(other, rng)
    return data[:at] + other[start:]


def _token(data: bytes, rng: random.Random, dictionary: Sequence[bytes], _o: object) -> bytes:
    token = rng.choice(dictionary) if dictionary else rng.randbytes(rng.randrange(1, 16))
    at = somewhere(data, rng)
    return data[:at] + token + data[at + (len(token) if rng.random() < 0.5 else 0) :]


_CHANGES = (
    _flip_bit, _flip_bit, _set_byte, _set_byte, _set_integer, _set_integer, _set_integer,
    _add_to_integer, _truncate, _delete, _double, _move, _splice, _token, _token,
)  # fmt: skip
