"""Mesh files that lie or overwhelm: one error in the time and memory that their limits state."""

from pathlib import Path
from typing import Any

import pytest
import trimesh
from mesh_files import glb, tetrahedron

from clradar import Scene
from clradar.errors import MeshError
from clradar.files.meshes import trimesh_parts


def refused(path: Path, *texts: str) -> None:
    with pytest.raises(MeshError) as caught:
        Scene.from_mesh(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: expected ")
    assert "\n" not in message
    for text in texts:
        assert text in message


def test_a_chain_of_nodes_is_refused_before_trimesh_walks_it(tmp_path):
    path = tmp_path / "mesh.glb"
    for count in (1000, 50_000):
        nodes = [{"children": [i + 1]} for i in range(count - 1)]
        path.write_bytes(glb(tetrahedron(nodes=[*nodes, {"mesh": 0}])))
        if count == 1000:
            assert Scene.from_mesh(path).n_faces == 4
    refused(path, "nodes of at most 1000 levels")


@pytest.mark.parametrize(
    ("name", "most", "texts"),
    [
        ("MAX_MESH_FACES", 39, ("at most 39 triangles", "simplify or join", "got 40")),
        ("MAX_MESH_VERTICES", 39, ("at most 39 vertices", "got 40")),
        ("MAX_MESH_PARTS", 9, ("at most 9 parts", "got 10")),
    ],
)
def test_instances_are_counted_before_they_are_made(tmp_path, monkeypatch, name, most, texts):
    path = tmp_path / "mesh.glb"
    nodes: list[dict[str, Any]] = [{"children": list(range(1, 11))}]
    path.write_bytes(glb(tetrahedron(nodes=nodes + [{"mesh": 0}] * 10)))
    scene = trimesh.load_scene(path, process=False)
    made = []
    monkeypatch.setattr(trimesh_parts, "placed", lambda *a: made.append(a))
    monkeypatch.setattr(f"clradar.files.meshes.parts.{name}", most)
    with pytest.raises(MeshError) as caught:
        trimesh_parts.parts_of(str(path), scene, limited=True)
    for text in texts:
        assert text in str(caught.value)
    assert not made


@pytest.mark.parametrize("name", ["mesh.zip", "mesh.tar.gz", "mesh.bz2", "mesh.dxf", "mesh"])
def test_archives_and_other_formats_are_refused_unread(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"PK\x03\x04")
    refused(path, ".obj", path.suffix)


@pytest.mark.parametrize(
    ("position", "primitive", "got"),
    [
        ({"sparse": {"count": 1}}, {}, "sparse"),
        ({"normalized": True}, {}, "normalized"),
        ({}, {"mode": 6}, "a fan"),
    ],
)
def test_triangles_that_trimesh_would_change_are_refused(tmp_path, position, primitive, got):
    path = tmp_path / "mesh.glb"
    document = tetrahedron()
    document["accessors"][1] |= position
    document["meshes"][0]["primitives"][0] |= primitive
    path.write_bytes(glb(document))
    refused(path, got)


# ---- work that grows with the square of the parts
