"""Changes to an `.npy` file with a pickle: its header, and the pickle operation by operation."""

from __future__ import annotations

import pickletools
import random
import struct

from fuzz.mutate_bytes import INTERESTING

_NAMES = (
    ("posix", "system"), ("builtins", "eval"), ("os", "system"), ("subprocess", "Popen"),
    ("numpy", "ndarray"), ("numpy", "dtype"), ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"),
    ("_codecs", "encode"), ("builtins", "complex"), ("numpy", "load"), ("numpy.f2py", "compile"),
    ("chumpy.ch", "Ch"), ("chumpy.reordering", "Select"), ("scipy.sparse.csc", "csc_matrix"),
    ("copy_reg", "_reconstructor"), ("__builtin__", "object"),
)  # fmt: skip
_CODES = (
    "c8",
    "c16",
    "f8",
    "f2",
    "i8",
    "u1",
    "b1",
    "O",
    "O8",
    "S9",
    "U999999999",
    "V8",
    "M8",
    "i3",
    "",
    "<c8",
    "c8\n",
)


def _text(value: str) -> bytes:
    raw = value.encode()
    return b"\x8c" + bytes([len(raw)]) + raw


def _integer(value: int) -> bytes:
    raw = value.to_bytes(9, "little", signed=True)
    return b"\x8a\x09" + raw


_GLOBALS = tuple(b"c" + f"{m}\n{n}\n".encode() for m, n in _NAMES) + tuple(
    _text(m) + _text(n) + b"\x93" for m, n in _NAMES
)
_LEAVES = (
    b"N", b"\x88", b"\x89", b"K\x00", b"K\x01", b"M\xff\xff", b"J\xff\xff\xff\xff", b"]", b"}",
    b")",
    b"C\x00", b"C\x08abcdefgh", b"U\x01<", b"U\x01>", b"X\x00\0\0\0", b"G\x7f\xf0\0\0\0\0\0\0",
    b"G\x7f\xf8\0\0\0\0\0\0", b"\x8c\x06latin1", b"\x96\x04\0\0\0\0\0\0\0abcd",
    *(_integer(n) for n in INTERESTING), *(_text(code) for code in _CODES),
    *(_text(key) for key in ("xr", "fvec", "timestamp_us", "number_of_measurements", "new")),
)  # fmt: skip
_STACK = (
    b"(", b"t", b"\x85", b"\x86", b"\x87", b"a", b"e", b"s", b"u", b"R", b"b", b"\x94", b"q\x00",
    b"q\x07", b"h\x00", b"h\x01", b"h\x07", b"r\xff\xff\xff\x7f", b"j\x00\0\0\0", b".", b"0", b"2",
    b"\x81", b"\x92", b"\x95\x03\0\0\0\0\0\0\0", b"Ppid\n", b"Q", b"\x97", b"\x98", b"\x80\x04",
    b"\x80\xff", b"\x82\x01", b"i__main__\nf\n", b"o", b"\x90", b"\x91", b"I00\n", b"F1e999\n",
    b"L1L\n", b"S'a'\n", b"V\\ud800\n",
)  # fmt: skip
DICTIONARY = (
    *_GLOBALS, *_LEAVES, *_STACK, b"\x93NUMPY\x01\x00", b"\x93NUMPY\x02\x00", b"'descr': '|O'",
    b"'shape': (),", b"'fortran_order': True", b"(1,)", b"latin1", b"utf-8",
)  # fmt: skip

_HEADERS = (
    "{'descr': '|O', 'fortran_order': False, 'shape': (), }",
    "{'descr': '|O', 'fortran_order': True, 'shape': (), }",
    "{'descr': 'O', 'fortran_order': False, 'shape': (), 'x': 1}",
    "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
    "{'descr': '<c8', 'fortran_order': False, 'shape': (99999999, 99999999), }",
    "{'descr': [('a', '|O')], 'fortran_order': False, 'shape': (), }",
    "{'descr': ('|O', (2,)), 'fortran_order': False, 'shape': (), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (-1,), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (10L, ), }",
    "{'descr': '|O', 'fortran_order': 0, 'shape': [], }",
    "{'descr': 'V" + "9" * 30 + "', 'fortran_order': False, 'shape': (), }",
    "__import__('os').system('true')",
    "{'descr': __import__('os').system('true'), 'fortran_order': False, 'shape': ()}",
    "(" * 200, "-" * 5000 + "1", "[" * 3000 + "]" * 3000, "{1: 2}", "", "\0", "'a' 'b'", "1_000",
    "1if 2else 3",
    "{'descr': '|O', 'fortran_order': False, 'shape': (), }" + " " * 20_000,
    "{'descr': '" + "i4," * 3000 + "i4', 'fortran_order': False, 'shape': (), }",
    "{'descr': '\\ud800', 'fortran_order': False, 'shape': (), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': " + "9" * 5000 + ", }",
)  # fmt: skip


def mutate_npy(data: bytes, rng: random.Random) -> bytes:
    """Return the file with another .npy header, whose length may be a lie."""
    start = pickle_start(data)
    raw = rng.choice(_HEADERS).encode("latin1")
    if rng.random() < 0.7:
        raw += b" " * (-(len(raw) + 11) % 64) + b"\n"
    length = len(raw) if rng.random() < 0.8 else rng.choice(INTERESTING)
    if rng.random() < 0.7:
        head = b"\x93NUMPY\x01\x00" + struct.pack("<H", length % 2**16)
    else:
        version = rng.choice((2, 2, 2, 3, 0, 255))
        head = b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<I", length % 2**32)
    return head + raw + data[start:]


def mutate_operations(data: bytes, rng: random.Random) -> bytes:
    """Return the file with pickle operations deleted, doubled, swapped, replaced or put in."""
    start = pickle_start(data)
    operations = _operations(data[start:])
    if len(operations) < 2:
        return data[:start] + rng.choice(_LEAVES + _GLOBALS) + data[start:]
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(operations))
        kind = rng.randrange(8)
        if kind == 0:
            operations[at] = b""
        elif kind == 1:
            operations[at] *= rng.choice((2, 2, 3, 100, 3000)) if len(operations[at]) < 100 else 2
        elif kind == 2:
            other = rng.randrange(len(operations))
            operations[at], operations[other] = operations[other], operations[at]
        elif kind == 3:
            operations[at] = rng.choice(_LEAVES)
        elif kind == 4:
            operations[at] = rng.choice(_GLOBALS)
        elif kind == 5:
            operations[at] += rng.choice(_STACK)
        elif kind == 6:
            operations[at] += rng.choice(_GLOBALS) + rng.choice(_LEAVES) + b"\x85R"
        else:
            operations[at] = operations[at][:1] + _argument(operations[at], rng)
    return data[:start] + b"".join(operations)


def _argument(operation: bytes, rng: random.Random) -> bytes:
    argument = operation[1:]
    if not argument:
        return argument
    size = rng.choice((1, 2, 4, 8))
    raw = struct.pack("<Q", rng.choice(INTERESTING))[:size]
    return raw[: len(argument)] + argument[size:]


def _operations(raw: bytes) -> list[bytes]:
    starts = []
    try:
        for _, _, position in pickletools.genops(raw):
            starts.append(position)
            if len(starts) > 5000:
                break
    except Exception:  # a damaged pickle: what could be read is enough
        pass
    starts = starts or [0]
    ends = [*starts[1:], len(raw)]
    parts = [raw[a:b] for a, b in zip(starts, ends, strict=True)]
    return [part for part in parts if part[:1] != b"\x95" or len(parts) < 3]


def pickle_start(data: bytes) -> int:
    """Return where the header of an .npy file ends, as far as it can be found."""
    if not data.startswith(b"\x93NUMPY") or len(data) < 12:
        return 0
    size = (
        struct.unpack("<H", data[8:10])[0] if data[6] == 1 else struct.unpack("<I", data[8:12])[0]
    )
    return min(len(data), (10 if data[6] == 1 else 12) + size)
