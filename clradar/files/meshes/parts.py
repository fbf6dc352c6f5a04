"""Triangles of a mesh in named parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from clradar.errors import MeshError
from clradar.files.failures import clean, fail
from clradar.files.limits import MAX_MESH_FACES, MAX_MESH_PARTS, MAX_MESH_VERTICES


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a mesh: (n, 3) vertices, and (m, 3) faces that index them."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True, slots=True)
class Parts:
    """A mesh of parts: `part` has the index into `names`, which are not unique, of each face.

    `texture` (n_vertices, 3) are coordinates fixed to the body; like `vertices` in the mesh's unit.
    """

    vertices: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    names: tuple[str, ...]
    texture: np.ndarray | None = None

    @classmethod
    def joined(cls, label: str, pieces: Iterable[Piece]) -> Parts:
        """Return the parts of a mesh; those without faces are left out."""
        kept = [piece for piece in pieces if len(piece.faces)]
        if not kept:
            fail(label, "a mesh with at least one triangle", "none", error=MeshError)
        offset, faces = 0, list[np.ndarray]()
        for piece in kept:
            _check(label, piece)
            faces.append(piece.faces.astype(np.int64) + offset)
            offset += len(piece.vertices)
        return cls(
            np.concatenate([piece.vertices for piece in kept]).astype(np.float64, copy=False),
            np.concatenate(faces).astype(np.int32),
            np.repeat(np.arange(len(kept), dtype=np.int32), list(map(len, faces))),
            tuple(piece.name for piece in kept),
        )


def _check(label: str, piece: Piece) -> None:
    what = f"part '{clean(piece.name)}'"
    for name, array in (("vertices", piece.vertices), ("faces", piece.faces)):
        if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iuf":
            got = f"shape {array.shape} of {array.dtype}"
            fail(label, f"a mesh with {name} of three numbers in {what}", got, error=MeshError)
    low, high = int(piece.faces.min()), int(piece.faces.max())
    if low < 0 or high >= len(piece.vertices):
        wanted = f"a mesh with vertex indices in [0, {len(piece.vertices)}) in {what}"
        fail(label, wanted, f"[{low}, {high}]", error=MeshError)


def check_counts(label: str, *, parts: int = 0, vertices: int = 0, faces: int = 0) -> None:
    """Raise `MeshError` if a file has more of them than its limits allow."""
    for name, count, most in (
        ("parts", parts, MAX_MESH_PARTS),
        ("vertices", vertices, MAX_MESH_VERTICES),
        ("triangles", faces, MAX_MESH_FACES),
    ):
        if count > most:
            wanted = f"a mesh of at most {most} {name}: simplify or join them"
            fail(label, wanted, f"{count}", error=MeshError)
