"""Triangles of a Wavefront OBJ file: positions, faces and the names of objects, groups, materials.

Wavefront Technologies, Object Files (.obj), Advanced Visualizer manual, appendix B1. Material files
and textures are not opened: nothing here needs them.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from clradar.errors import MeshError
from clradar.files.failures import clean, fail
from clradar.files.meshes.parts import Parts, check_counts, reversed_names

_FAR = 2**62  # beyond every vertex
_Names = tuple[str | None, str | None, str | None]  # object, group, material


@dataclass(slots=True)
class _Lines:
    """What a file's lines say, before numbers are parsed.

    `runs` has for faces behind one another: number of the first, vertices before it, part.
    """

    vertices: list[str] = field(default_factory=list)
    faces: list[str] = field(default_factory=list)
    runs: list[tuple[int, int, int]] = field(default_factory=list)
    names: list[_Names] = field(default_factory=list)
    materials: set[str] = field(default_factory=set)


def read_obj(path: Path, content: bytes) -> Parts:
    """Return the parts of an OBJ file: its faces by object, group and material.

    Parts are in the order of their first faces, faces of a part in the order of the file; polygons
    are cut into fans. A part is called by those of object, group and, if there are several,
    material that it has, joined by "_"; otherwise like the file.

    Raises
    ------
    MeshError
        Lines that are damaged, or more than the limits of `clradar.files.limits`.
    """
    # Other encodings occur in comments and names only.
    lines = _sorted_lines(path, content.decode("utf-8-sig", "replace"))
    if not lines.faces:
        fail(path, "a mesh with at least one triangle", "none", error=MeshError)
    vertices = _vertices(path, lines.vertices)
    triangles, part = _triangles(path, lines, len(vertices))
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    triangles = (np.cumsum(used) - 1)[triangles]
    names = [_name(path, of, len(lines.materials) > 1) for of in lines.names]
    return Parts(
        vertices[used], triangles.astype(np.int32), part.astype(np.int32), reversed_names(names)
    )


def _sorted_lines(path: Path, text: str) -> _Lines:
    found = _Lines()
    names: _Names = (None, None, None)
    at: dict[_Names, int] = {}
    vertices, faces, running = found.vertices, found.faces, False
    for line in text.replace("\r\n", "\n").replace("\\\n", " ").split("\n"):
        start = line[:2]
        if start == "f " and running:
            faces.append(line[2:])
            continue
        if start == "v ":
            vertices.append(line[2:])
            running = False
            continue
        if start in ("vn", "vt", "# ", ""):
            continue
        word, rest = (*line.split(None, 1), "", "")[:2]
        if word == "f":
            found.runs.append((len(faces), len(vertices), at.setdefault(names, len(at))))
            faces.append(rest)
            running = True
        elif word == "v":  # indented, or followed by a tab
            vertices.append(rest)
            running = False
        elif word in ("o", "g", "usemtl") and rest:
            place, running = ("o", "g", "usemtl").index(word), False
            names = (*names[:place], rest.strip(), *names[place + 1 :])  # type: ignore[assignment]
            if word == "usemtl":
                found.materials.add(rest.strip())
    found.names = list(at)
    check_counts(str(path), parts=len(at), vertices=len(vertices), faces=len(faces))
    return found


def _name(path: Path, names: _Names, several_materials: bool) -> str:
    given = names if several_materials else names[:2]
    return "_".join(name for name in given if name is not None) or path.name


def _vertices(path: Path, texts: list[str]) -> np.ndarray:
    """Return positions (n, 3); a line may hold a weight or a colour behind them."""
    columns = set(map(len, map(str.split, texts)))
    values = _parsed(texts, np.float64) if len(columns) == 1 and min(columns) >= 3 else None
    if values is not None and values.size == len(texts) * min(columns):
        return values.reshape(len(texts), -1)[:, :3]
    rows = []
    for text in texts:
        try:
            x, y, z = map(float, text.split()[:3])
        except ValueError:
            fail(
                path, "a mesh with vertices of three numbers", f"'v {clean(text)}'", error=MeshError
            )
        rows.append((x, y, z))
    return np.array(rows, np.float64).reshape(-1, 3)


def _parsed(texts: list[str], dtype: type) -> np.ndarray | None:
    """Return all numbers of the texts, also between slashes; None if anything else is there."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # how numpy says so
        try:
            return np.fromstring(" ".join(texts).replace("/", " "), dtype, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def _triangles(path: Path, lines: _Lines, n_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles (n, 3) as indices from 0, and the part of each (n,).

    In the order of parts, then lines. The second halves of the faces of a part of nothing but
    quadrilaterals follow behind all first halves, as trimesh has them.
    """
    corners, polygons = _polygons(path, lines.faces)
    if corners.min() < 3:
        _fail_face(path, lines, int(np.argmin(corners)), "with three corners or more")
    check_counts(str(path), faces=int((corners - 2).sum()))
    first, before_run, part_of_run = np.array(lines.runs).T
    length = np.diff(first, append=len(lines.faces))
    before, part = np.repeat(before_run, length), np.repeat(part_of_run, length)
    quads = np.ones(len(lines.names), dtype=bool)
    quads[part[corners != 4]] = False
    triangles, line, half = [], [], []
    for rows, given in polygons:
        index = np.where(given > 0, given - 1, given + before[rows][:, None])
        wrong = (given == 0) | (index < 0) | (index >= n_vertices)
        if wrong.any():
            at = int(rows[np.flatnonzero(wrong.any(axis=1))[0]])
            _fail_face(path, lines, at, f"of vertices among {n_vertices}")
        count = given.shape[1]
        corner = np.arange(1, count - 1)
        fan = np.stack([np.zeros_like(corner), corner, corner + 1], axis=1)
        if count == 4:
            fan[1] = 2, 3, 0  # as trimesh begins it
        triangles.append(index[:, fan].reshape(-1, 3))
        line.append(np.repeat(rows, count - 2))
        half.append(np.tile(np.arange(count - 2), len(rows)))
    lines_of, halves = np.concatenate(line), np.concatenate(half)
    of = part[lines_of]
    order = np.lexsort((halves, lines_of, np.where(quads[of], halves, 0), of))
    return np.concatenate(triangles)[order], of[order]


def _polygons(
    path: Path, texts: list[str]
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Return the number of corners of each face, and the faces by that number.

    Of each number: which faces these are (n,), and their vertices (n, corners) as in the file.
    """
    corners = np.array([len(text.split()) for text in texts])
    slashes = np.array([text.count("/") for text in texts])
    found = []
    for count in np.unique(corners):
        for slash in np.unique(slashes[corners == count]):
            rows = np.flatnonzero((corners == count) & (slashes == slash))
            alike = texts if len(rows) == len(texts) else [texts[i] for i in rows]
            vertices = _alike(alike, int(count), int(slash))
            if vertices is None:  # comments, corners of different kinds, or damage
                return _polygons(path, [_vertices_only(path, text) for text in texts])
            found.append((rows, vertices))
    return corners, found


def _alike(texts: list[str], count: int, slashes: int) -> np.ndarray | None:
    """Return the vertices (n, count) of faces written alike; None if they are not.

    As 1 2 3, 1/1 2/2 3/3 (with texture), 1//1 2//2 3//3 (with normals), or 1/1/1 2/2/2 3/3/3.
    """
    if slashes not in (0, count, 2 * count):
        return None
    numbers = 1 + slashes // max(count, 1) - ("//" in texts[0])
    values = _parsed(texts, np.int64)
    if values is None or values.size != len(texts) * count * numbers:
        return None
    return values.reshape(len(texts), count, numbers)[:, :, 0]


def _vertices_only(path: Path, text: str) -> str:
    """Return a face without textures, normals and comment."""
    try:
        numbers = [int(corner.split("/")[0]) for corner in text.split("#")[0].split()]
        return " ".join(str(min(max(number, -_FAR), _FAR)) for number in numbers)
    except ValueError:
        fail(path, "a mesh with faces of vertex numbers", f"'f {clean(text)}'", error=MeshError)


def _fail_face(path: Path, lines: _Lines, at: int, wanted: str) -> NoReturn:
    fail(path, f"a mesh with faces {wanted}", f"'f {clean(lines.faces[at])}'", error=MeshError)
