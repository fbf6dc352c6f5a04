"""The text of a Wavefront OBJ file as trimesh reads it right.

Wavefront Technologies, Object Files (.obj), Advanced Visualizer manual, appendix B1.
"""

from __future__ import annotations

import re
from pathlib import Path

from clradar.errors import MeshError
from clradar.files.failures import clean, fail

_UNUSUAL = re.compile(r"^[ \t]+\S|^[fv][tn]?\t|^[ \t]*[fv].*#", re.MULTILINE)
_LINE = re.compile(r"^[ \t]*(v|vt|vn|f)[ \t]+([^#\n]*).*$", re.MULTILINE)
_INDENTED = re.compile(r"^[ \t]+(?=\S)", re.MULTILINE)
_LONG_VERTEX = re.compile(r"^(v(?:[ \t]+[^\s]+){3})[ \t]+\S.*$", re.MULTILINE)
_FEW_CORNERS = r"f(?:[ \t]+[^\s]+){0,2}[ \t]*$"
_NO_VERTEX = r"f (?:.*[ \t])?(?:/|[+]?0+(?=[/ \t]|$)).*$"
_COUNTED_BACK = r"f .*-.*$"  # from their line, which trimesh does from the file's end
_REFUSED = re.compile(f"^(?:{_FEW_CORNERS}|{_NO_VERTEX}|{_COUNTED_BACK})", re.MULTILINE)
_MATERIALS = re.compile(r"^mtllib\b.*", re.MULTILINE)
_MATERIAL = re.compile(r"^usemtl (.*)", re.MULTILINE)


def for_trimesh(path: Path, content: bytes) -> tuple[bytes, dict[str, bytes]]:
    """Return an OBJ file's content for trimesh, and by its name a file of materials for its own.

    Lines are neither indented nor continued, and vertices are three numbers. With a material file
    of several materials, trimesh calls parts by theirs; that file is not opened, so those that are
    used count.
    """
    # Other encodings occur in comments and names only.
    text = content.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\\\n", " ")
    if _UNUSUAL.search(text):
        text = _INDENTED.sub("", _LINE.sub(r"\1 \2", text))
    text = _LONG_VERTEX.sub(r"\1", text)  # by a weight or colour, which not all need to have
    if refused := _REFUSED.search(text):
        wanted = "a mesh with faces of three corners or more, counted from 1: export it so"
        fail(path, wanted, f"'{clean(refused[0])}'", error=MeshError)
    several = len({name.strip() for name in _MATERIAL.findall(text)}) > 1
    text = _MATERIALS.sub("mtllib materials", text)
    return text.encode(), {"materials": b"newmtl 1\nnewmtl 2\n" if several else b""}
