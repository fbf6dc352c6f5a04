"""Changes to files: to any bytes, and to what the formats that are read consist of."""

import json
import pickletools
import random
import re
import struct
import zlib
from collections.abc import Sequence
from itertools import islice
from typing import Any

INTERESTING = tuple(
    sorted(
        {0, 1, 2, 3, 7, 8, 16, 100, 127, 128, 255, 256, 1000, 4096, 32767, 32768, 65535, 65536}
        | {2**k + d for k in (24, 31, 32, 40, 48, 62, 63, 64) for d in (-1, 0)} - {2**64}
    )
)
"""Where sizes, counts and offsets go wrong: the ends of the integer types, and just beside."""

MAX_GROWTH = 2**16
"""No input gets longer than its seed by more than this: what is tried is damage, not size."""


def change_bytes(
    data: bytes, rng: random.Random, tokens: Sequence[bytes], others: Sequence[bytes]
) -> bytes:
    """Return `data` with one change that knows nothing of the format."""
    if not data:
        return rng.choice(others)
    at, size = _somewhere(data, rng), rng.choice((1, 2, 4, 8))
    kind = rng.randrange(11)
    if kind == 0:
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    if kind == 1:
        value = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
        return data[:at] + bytes([value]) + data[at + 1 :]
    if kind in (2, 3):
        at -= at % size if rng.random() < 0.5 else 0
        value = rng.choice((*INTERESTING, len(data), len(data) - at, rng.randrange(len(data))))
        raw = struct.pack("<Q", value)[:size]
        return data[:at] + (raw if rng.random() < 0.9 else raw[::-1]) + data[at + size :]
    if kind == 4:
        value = int.from_bytes(data[at : at + size], "little") + rng.choice((-1, 1, -8, 16, 255))
        return data[:at] + (value % 256**size).to_bytes(size, "little") + data[at + size :]
    if kind == 5:
        return data[:at]
    if kind == 6:
        return data[:at] + data[at + rng.choice((1, 2, 8, 64, rng.randrange(1, 4096))) :]
    if kind == 7:
        piece = data[at : at + rng.choice((1, 4, 16, 64, 512, 4096))]
        times = min(rng.choice((1, 2, 256)), MAX_GROWTH // len(piece))
        return data[:at] + piece * times + data[at:]
    if kind == 8:
        source, size = _somewhere(data, rng), rng.choice((1, 4, 16, 64, 512))
        return data[:at] + data[source : source + size] + data[at + size :]
    if kind == 9:
        other = rng.choice(others) or b"\0"
        start = at if rng.random() < 0.5 and at < len(other) else _somewhere(other, rng)
        return data[:at] + other[start:]
    token = rng.choice(tokens) if tokens else rng.randbytes(rng.randrange(1, 16))
    return data[:at] + token + data[at + (len(token) if rng.random() < 0.5 else 0) :]


def _somewhere(data: bytes, rng: random.Random) -> int:
    """Return a position; more often near the ends, and not in a run of zeros, which is padding."""
    kind = rng.random()
    at = rng.randrange(len(data))
    if kind < 0.35:
        at = min(len(data) - 1, int(rng.expovariate(1 / 300)))
    elif kind < 0.5:
        at = max(0, len(data) - 1 - int(rng.expovariate(1 / 150)))
    for _ in range(64):
        if data[at] or rng.random() < 0.1:
            break
        at = (at + 1) % len(data)
    return at


def _rearranged(items: list[Any], at: int, kind: int, rng: random.Random) -> list[Any]:
    """Return a list with an item deleted (0), doubled (1) or moved (2)."""
    if kind == 0:
        return items[:at] + items[at + 1 :]
    if kind == 1:
        times = rng.choice((1, 2, 50))
        large = isinstance(items[at], bytes) and times * len(items[at]) > MAX_GROWTH
        return items[:at] + [items[at]] * (1 if large else times) + items[at:]
    items.insert(rng.randrange(len(items)), items.pop(at))
    return items


# ---- text

TEXT = tuple(
    token if isinstance(token, bytes) else token.encode()
    for token in (
        "nan", "inf", "-inf", "1e999", "0x1p3", "1_0", "1,2", ",,,", "\n", "\r\n", "\x0b", "\x1c",
        "\u2028", "\u0663", "\ufeff", "x,y,z", "x,y,z,w", "0" * 5000, "9" * 400, "\0", "#", '"',
        "-", ".", "1e", "None", "True", " ", b"\xff", b"\xc0\x80", b"\xed\xa0\x80", b"\xff\xfe",
    )
)  # fmt: skip


def change_lines(data: bytes, rng: random.Random) -> bytes:
    """Return the text with a line deleted, doubled, moved, or one of its fields replaced."""
    lines = data.split(b"\n")
    at, kind = rng.randrange(len(lines)), rng.randrange(4)
    if kind < 3:
        return b"\n".join(_rearranged(lines, at, kind, rng))
    fields = lines[at].split(b",")
    fields[rng.randrange(len(fields))] = rng.choice(TEXT)
    lines[at] = b",".join(fields)
    return b"\n".join(lines)


JSON = (
    b"NaN", b"-Infinity", b"null", b"true", b"{", b"}", b"[", b"]", b'"', b"\\u0000", b"\\ud800",
    b"1e999", b"-0", b"0" * 50, b"9" * 5000, b",", b":", b'"000000":', b'"depth":', b"/*",
    b"[" * 100_000, b'{"a":' * 100_000, b"\xff", b"\xed\xa0\x80", b"\0",
)  # fmt: skip
_JSON_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 2**31, 2**64, -(2**70), 10**400, -0.0, 1e308, 5e-324, float("nan"),
    float("inf"), "", "0", "\0", "\ud800", "x" * 100_000, "../../etc/passwd", "/dev/zero", [], {},
    [[]], [None] * 1000, {"": {}}, {"000000": {}}, [1, 2, 3], [[1, 0], [0, 1]],
)  # fmt: skip


def change_json(data: bytes, rng: random.Random) -> bytes:
    """Return JSON with one node of its tree deleted, renamed, repeated or replaced."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return data
    nodes: list[tuple[Any, Any]] = []
    todo = [tree] if isinstance(tree, dict | list) else []
    while todo and len(nodes) < 10_000:
        node = todo.pop()
        inner = node.items() if isinstance(node, dict) else enumerate(node)
        for key, value in list(inner):
            nodes.append((node, key))
            todo += [value] if isinstance(value, dict | list) else []
    if not nodes:
        return json.dumps(rng.choice(_JSON_VALUES)).encode("utf-8", "surrogatepass")
    parent, key = rng.choice(nodes)
    kind = rng.randrange(4)
    if kind == 0:
        del parent[key]
    elif kind == 1 and isinstance(parent, dict):
        parent[rng.choice(("", "000001", "\u0660" * 6, str(key) * 2, "\ud800"))] = parent[key]
    elif kind == 2 and isinstance(parent[key], list | dict):
        parent[key] = [parent[key]] * rng.choice((1, 2, 50))
    else:
        parent[key] = rng.choice(_JSON_VALUES)
    return json.dumps(tree, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")


GLTF = (
    b'"bufferView"', b'"count":', b'"byteStride":', b'"sparse":{', b'"matrix":[', b'"children":[',
    b'"KHR_draco_mesh_compression"', b"5126", b'"VEC3"', b'"MAT4"', b'"mode":5', b'"JOINTS_15"',
    b"4294967295", b"1e999", b"NaN", b"data:application/octet-stream;base64,",
)  # fmt: skip


def change_glb(data: bytes, rng: random.Random) -> bytes:
    """Return a GLB file with its JSON changed, and lengths that are right again."""
    if len(data) < 20 or not data.startswith(b"glTF"):
        return data
    end = 20 + int.from_bytes(data[12:16], "little")
    text = change_json(data[20:end].rstrip(), rng)
    text += b" " * (-len(text) % 4)
    content = len(text).to_bytes(4, "little") + b"JSON" + text + data[end:]
    return b"glTF" + data[4:8] + (12 + len(content)).to_bytes(4, "little") + content


# ---- images, whose chunks have right checksums again


def png_checksums(data: bytes) -> bytes:
    """Return a PNG file with the checksum of every chunk made right."""
    whole, at = b"\x89PNG\r\n\x1a\n", 8
    while at + 8 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        chunk = data[at + 4 : at + 8 + size]
        whole += (len(chunk) - 4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        at += 12 + size
    return whole if at > 8 else data


# ---- pickles

_NAMES = (
    b"cposix\nsystem\n", b"cbuiltins\neval\n", b"cnumpy\nndarray\n", b"cnumpy\ndtype\n",
    b"cnumpy.core.multiarray\n_reconstruct\n", b"c_codecs\nencode\n", b"cnumpy\nload\n",
    b"cnumpy._core.numeric\n_frombuffer\n", b"cscipy.sparse.csc\ncsc_matrix\n",
    b"cchumpy.ch\nCh\n", b"\x8c\x02os\x8c\x06system\x93",
)  # fmt: skip
_PIECES = (
    *(bytes([code]) for code in b"N\x88]})(t\x85\x86aesuRb\x94.02\x81\x92Q\x97o\x90"),
    b"K\x00", b"J\xff\xff\xff\xff", b"C\x00", b"G\x7f\xf0\0\0\0\0\0\0", b"\x8c\x02xr",
    b"\x8c\x0aU999999999", b"h\x00", b"r\xff\xff\xff\x7f", b"\x95\x03\0\0\0\0\0\0\0",
    b"Ppid\n", b"\x82\x01", b"i__main__\nf\n", b"F1e999\n", b"V\\ud800\n",
    *(b"\x8a\x09" + n.to_bytes(9, "little") for n in INTERESTING),
)  # fmt: skip
PICKLE = (*_NAMES, *_PIECES, b"\x93NUMPY\x02\x00", b"'shape': (),", b"(1,)", b"latin1")


def change_pickle(data: bytes, rng: random.Random) -> bytes:
    """Return a pickle, or an .npy file of one, with operations deleted, doubled, moved, put in."""
    start = _pickle_start(data)
    starts = [0]
    try:
        for _, _, position in islice(pickletools.genops(data[start:]), 5000):
            starts.append(position)
    except Exception:  # a damaged pickle: what could be read is enough
        pass
    ends = [*starts[1:], len(data) - start]
    operations = [data[start + a : start + b] for a, b in zip(starts, ends, strict=True)]
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, kind = rng.randrange(len(operations)), rng.randrange(6)
        if kind < 3:
            operations = _rearranged(operations, at, kind, rng) or [b""]
        elif kind == 3:
            operations[at] = rng.choice(PICKLE)
        elif kind == 4:
            operations[at] += rng.choice(PICKLE)
        else:
            operations[at] += rng.choice(_NAMES) + rng.choice(_PIECES) + b"\x85R"
    return data[:start] + b"".join(operations)


def _pickle_start(data: bytes) -> int:
    """Return where the header of an .npy file ends, as far as it can be found."""
    if not data.startswith(b"\x93NUMPY") or len(data) < 12:
        return 0
    width = 2 if data[6] == 1 else 4
    return min(len(data), 8 + width + int.from_bytes(data[8 : 8 + width], "little"))


# ---- HDF5

_SIGNATURES = (b"TREE", b"SNOD", b"HEAP", b"GCOL", b"OHDR", b"FRHP", b"BTHD", b"FAHD", b"EAHD")
_STRUCTURE = re.compile(b"|".join(_SIGNATURES))
_MOST_STRUCTURES = 200  # a piece that is doubled many times holds any number
HDF5 = (
    *_SIGNATURES, b"entry", b"data", b"tx_m", b"frequency_hz", b"origin_m", b"clradar_format",
    b"clradar_version", b"provenance", b"text_crc32", b"frequency_weight", b"tx_pattern", b"axes",
    b"\x89HDF\r\n\x1a\n", b"\xff" * 8, bytes(8), b"capture", b"volume",
)  # fmt: skip


def change_hdf5(data: bytes, rng: random.Random) -> bytes:
    """Return an HDF5 file with a number in a structure, or an address of one, changed."""
    places = [m.start() for m in islice(_STRUCTURE.finditer(data), _MOST_STRUCTURES)]
    if not places:
        return data
    size, value = rng.choice((1, 2, 4, 8)), rng.choice((*INTERESTING, rng.randrange(256)))
    at = rng.choice(places) + rng.randrange(4, 120)
    if rng.random() < 0.5:  # an address: cycles, and structures of the wrong kind
        found = data.find(struct.pack("<Q", rng.choice(places)))
        at, size, value = (found, 8, rng.choice(places)) if found >= 0 else (at, size, value)
    return data[:at] + struct.pack("<Q", value)[:size] + data[at + size :]
