"""Changes to text of lines and comma-separated numbers."""

from __future__ import annotations

import random

_TOKENS = (
    "nan", "inf", "-inf", "1e999", "-1e-999", "0x1p3", "1_0", "1,2", ",", ",,,", "\n", "\r",
    "\r\n", "\x0b", "\x1c", "\u2028", "\u0663", "\ufeff", "x,y,z", "X, Y ,Z", "x,y,z,w",
    "0" * 5000, "9" * 400, "\0", "#", '"', "-", "+", ".", "1e", "None", "True", " ", "\t",
)  # fmt: skip
_NO_TEXT = (b"\xff", b"\xc0\x80", b"\xed\xa0\x80", b"\xef\xbb\xbf", b"\xff\xfe")
DICTIONARY = (*(token.encode() for token in _TOKENS), *_NO_TEXT)


def mutate_lines(data: bytes, rng: random.Random) -> bytes:
    """Return the text with a line deleted, doubled, moved, or one of its fields replaced."""
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    kind = rng.randrange(5)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines[at:at] = [lines[at]] * rng.choice((1, 1, 2, 100))
    elif kind == 2:
        lines.insert(rng.randrange(len(lines)), lines.pop(at))
    else:
        fields = lines[at].split(b",")
        field = rng.randrange(len(fields))
        if kind == 3:
            fields[field] = rng.choice(DICTIONARY)
        else:
            fields.insert(field, fields[field])
        lines[at] = b",".join(fields)
    return b"\n".join(lines)
