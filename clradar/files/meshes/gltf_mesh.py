"""All triangles of a glTF 2.0 scene, each instance of a primitive a part."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clradar.errors import MeshError
from clradar.files.meshes.gltf_file import EXPECTED, GltfFile
from clradar.files.meshes.gltf_nodes import NodeTree, node_tree
from clradar.files.meshes.gltf_triangles import triangles
from clradar.files.meshes.parts import Parts, Piece, UniqueNames, check_counts, placed


def read_gltf(path: Path, content: bytes) -> Parts:
    """Return the parts of a glTF file's content: its default scene, without skinning and morphs.

    Raises
    ------
    MeshError
        Damaged, or more than the limits of `clradar.files.limits`.
    """
    file = GltfFile(path, content, MeshError)
    # Overflows give infinite vertices, which are refused.
    with file.reading(EXPECTED), np.errstate(over="ignore", invalid="ignore"):
        tree, nodes = node_tree(file), file.listed("nodes")
        shown = [node for node in _shown(file, tree) if nodes[node].get("mesh") is not None]
        count = len(file.listed("meshes"))
        of = {n: file.index(f"mesh of node {n}", nodes[n]["mesh"], count) for n in shown}
        pieces = _pieces(file, set(of.values()))
        instances = [(node, piece) for node in shown for piece in pieces[of[node]]]
        check_counts(
            str(path),
            parts=len(instances),
            vertices=sum(len(piece.vertices) for _, piece in instances),
            faces=sum(len(piece.faces) for _, piece in instances),
        )
        return Parts.joined(
            str(path),
            (
                Piece(piece.name, placed(str(path), piece.vertices, tree.world[node]), piece.faces)
                for node, piece in instances
            ),
        )


def _pieces(file: GltfFile, wanted: set[int]) -> dict[int, list[Piece]]:
    """Return the primitives of the wanted meshes, called like the mesh, numbered if need be."""
    names = UniqueNames()
    found: dict[int, list[Piece]] = {}
    for number, mesh in enumerate(file.listed("meshes")):
        primitives = file.objects(f"primitives of mesh {number}", mesh.get("primitives"))
        called = [names.of(str(mesh.get("name") or "GLTF")) for _ in primitives]
        if number not in wanted:
            continue
        found[number] = []
        for at, (name, primitive) in enumerate(zip(called, primitives, strict=True)):
            read = triangles(file, f"mesh {number}, primitive {at}", primitive)
            if read is not None:
                found[number].append(Piece(name, *read))
    return found


def _shown(file: GltfFile, tree: NodeTree) -> list[int]:
    """Return the nodes of the default scene, in the order in which trimesh lists their parts."""
    scenes = file.listed("scenes")
    if scenes:
        scene = file.document.get("scene")
        at = file.index("scene", 0 if scene is None else scene, len(scenes))
        stack = [
            file.index(f"nodes of scene {at}", node, len(tree.names))
            for node in file.numbers_of(f"nodes of scene {at}", scenes[at].get("nodes"))
        ]
    else:
        stack = [node for node, parent in enumerate(tree.parents) if parent < 0]
    nodes = file.listed("nodes")
    found: dict[int, None] = {}
    while stack:
        node = stack.pop()
        if node not in found:
            found[node] = None
            stack += nodes[node].get("children") or []
    return list(found)
