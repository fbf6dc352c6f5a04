"""The text of a Wavefront OBJ file as trimesh reads it right.

Wavefront Technologies, Object Files (.obj), Advanced Visualizer manual, appendix B1.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NoReturn

from clradar.errors import MeshError
from clradar.files.failures import clean, fail

_UNUSUAL = re.compile(r"^[ \t]+\S|^[fv][tn]?\t|^[ \t]*[fv].*#", re.MULTILINE)
_LINE = re.compile(r"^[ \t]*(v|vt|vn|f)[ \t]+([^#\n]*).*$", re.MULTILINE)
_INDENTED = re.compile(r"^[ \t]+(?=\S)", re.MULTILINE)
_LONG_VERTEX = re.compile(r"^(v(?:[ \t]+[^\s]+){3})[ \t]+\S.*$", re.MULTILINE)
_COUNTED_BACK = re.compile(r"^f .*-", re.MULTILINE)
_FEW_CORNERS = r"f(?:[ \t]+[^\s]+){0,2}[ \t]*$"
_NO_VERTEX = r"f (?:.*[ \t])?(?:/|[+-]?0+(?=[/ \t]|$)).*$"
_DAMAGED = re.compile(f"^(?:{_FEW_CORNERS}|{_NO_VERTEX})", re.MULTILINE)
_MATERIAL = re.compile(r"^usemtl (.*)", re.MULTILINE)


def for_trimesh(path: Path, content: bytes) -> tuple[bytes, bytes]:
    """Return an OBJ file's content for trimesh, and a material file that stands for its own.

    Lines are neither indented nor continued, vertices are three numbers, corners of faces are
    counted from the first vertex. With a material file of several materials, trimesh calls parts
    by theirs; that file is not opened, so those that are used count.
    """
    # Other encodings occur in comments and names only.
    text = content.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\\\n", " ")
    if _UNUSUAL.search(text):
        text = _INDENTED.sub("", _LINE.sub(r"\1 \2", text))
    text = _LONG_VERTEX.sub(r"\1", text)  # by a weight or colour, which not all need to have
    damaged = _DAMAGED.search(text)
    if damaged:
        _fail_face(path, damaged[0])
    if _COUNTED_BACK.search(text):
        text = _counted_from_the_first(path, text)
    several = len({name.strip() for name in _MATERIAL.findall(text)}) > 1
    return text.encode(), b"newmtl 1\nnewmtl 2\n" if several else b""


def _fail_face(path: Path, line: str) -> NoReturn:
    wanted = "a mesh with faces of three corners or more, counted from 1 or back from -1"
    fail(path, wanted, f"'{clean(line)}'", error=MeshError)


def _counted_from_the_first(path: Path, text: str) -> str:
    """Replace corners that are counted back from their line: trimesh does from the file's end."""
    lines = text.split("\n")
    counts = {"v": 0, "vt": 0, "vn": 0}
    for at, line in enumerate(lines):
        word = line.partition(" ")[0]
        if word in counts:
            counts[word] += 1
        elif word == "f" and "-" in line:
            try:
                corners = [_corner(corner, list(counts.values())) for corner in line[2:].split()]
            except ValueError:
                _fail_face(path, line)
            lines[at] = "f " + " ".join(corners)
    return "\n".join(lines)


def _corner(corner: str, counts: list[int]) -> str:
    """Return the numbers of a corner from 1; ValueError if it is before the first one."""
    numbers = corner.split("/")
    for at, (number, count) in enumerate(zip(numbers, counts, strict=False)):
        if number.startswith("-"):
            numbers[at] = str(count + 1 + int(number))
            if count + 1 + int(number) < 1:
                raise ValueError(corner)
    return "/".join(numbers)
