"""The mesh of a hand: turned about the vertical, and written to a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clradar.files.atomic import write_file

if TYPE_CHECKING:
    from clradar.hand import HandMesh

SUFFIXES = (".ply", ".stl", ".obj", ".off", ".glb")
"""Formats of mesh files; .ply and .glb keep the parts apart, .ply the texture, too."""


def turned(mesh: HandMesh, angle_deg: float, center_m: Sequence[float]) -> HandMesh:
    """A hand turned about the vertical through `center_m`.

    Parameters
    ----------
    mesh : HandMesh
    angle_deg : float, degrees
        Positive brings the side at +x nearer to the radar.
    center_m : sequence of 3 floats, metres
    """
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    centre_m = np.asarray(center_m, dtype=np.float64)
    return mesh.moved(np.eye(3), -centre_m).moved(matrix, centre_m)


def save_hand(path: Path, mesh: HandMesh, *, force: bool) -> None:
    """Write a hand's mesh whole or not at all, in metres."""
    import trimesh

    from clradar.files.meshes.ply_parts import ply_of_parts

    kind = path.suffix.lower()[1:]
    if kind == "ply":
        content = ply_of_parts(
            mesh.vertices_m, mesh.faces, mesh.part, mesh.part_names, mesh.texture_m
        )
    elif kind == "glb":
        scene = trimesh.Scene()
        for i, name in enumerate(mesh.part_names):
            piece = trimesh.Trimesh(mesh.vertices_m, mesh.faces[mesh.part == i], process=False)
            piece.remove_unreferenced_vertices()
            scene.add_geometry(piece, node_name=name, geom_name=name)
        content = scene.export(file_type=kind)
    else:
        content = mesh.to_trimesh().export(file_type=kind)
    write_file(path, content.encode() if isinstance(content, str) else content, force=force)
