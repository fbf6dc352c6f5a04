"""Mesh files that lie or overwhelm: one error in the time and memory that their limits state."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
import trimesh
from mesh_files import OBJ_START, binary, glb, tetrahedron
from systems import posix_only

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


def turned(**node: Any) -> bytes:
    return glb(tetrahedron(nodes=[{"mesh": 0} | node]))


@pytest.mark.parametrize(
    ("node", "text"),
    [
        ({"matrix": [float("nan")] * 16}, "finite transforms"),
        ({"matrix": [1.0] * 9}, "array of size 9"),
        ({"translation": [0.0, float("inf"), 0.0]}, "finite transforms"),
        ({"translation": [0.0, 10**400, 0.0]}, ""),
        ({"rotation": [0.0, 0.0, 0.0, float("nan")]}, "finite transforms"),
        ({"rotation": "turned"}, ""),
        ({"scale": [1e308] * 3, "translation": [1e308] * 3}, ""),
        ({"children": [0]}, "a cycle"),
        ({"children": [1]}, "one parent each"),
        ({"children": 1}, ""),
        ({"mesh": 1}, "in [0, 1)"),
    ],
)
def test_transforms_that_are_none_are_refused(tmp_path: Path, node: Any, text: str) -> None:
    path = tmp_path / "mesh.glb"
    path.write_bytes(turned(**node))
    if node.get("scale"):
        path.write_bytes(glb(tetrahedron(nodes=[{"children": [1]} | node, {"mesh": 0} | node])))
    refused(path, text)


def test_a_chain_of_nodes_is_refused_before_trimesh_walks_it(tmp_path: Path) -> None:
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
def test_instances_are_counted_before_they_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, most: int, texts: tuple[str, ...]
) -> None:
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
def test_archives_and_other_formats_are_refused_unread(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"PK\x03\x04")
    refused(path, ".obj", path.suffix)


@posix_only
def test_pipes_do_not_block(tmp_path: Path) -> None:
    for name in ("pipe.mtl", "pipe.png", "pipe.bin", "pipe.obj"):
        os.mkfifo(tmp_path / name)
    obj = tmp_path / "mesh.obj"
    obj.write_text(f"mtllib pipe.mtl\n{OBJ_START}usemtl skin\nf 1 2 3\n")
    assert Scene.from_mesh(obj).n_faces == 1
    path = tmp_path / "mesh.gltf"
    document = tetrahedron(images=[{"uri": "pipe.png"}], textures=[{"source": 0}])
    document["buffers"][0]["uri"] = "data.bin"
    (tmp_path / "data.bin").write_bytes(binary())
    path.write_text(json.dumps(document))
    assert Scene.from_mesh(path).n_faces == 4
    document["buffers"][0]["uri"] = "pipe.bin"
    path.write_text(json.dumps(document))
    with pytest.raises(MeshError, match="no regular file"):
        Scene.from_mesh(path)
    refused(tmp_path / "pipe.obj", "no regular file")


@pytest.mark.parametrize(
    ("position", "primitive", "got"),
    [
        ({"sparse": {"count": 1}}, {}, "sparse"),
        ({"normalized": True}, {}, "normalized"),
        ({}, {"mode": 6}, "a fan"),
    ],
)
def test_triangles_that_trimesh_would_change_are_refused(
    tmp_path: Path, position: dict[str, Any], primitive: dict[str, Any], got: str
) -> None:
    path = tmp_path / "mesh.glb"
    document = tetrahedron()
    document["accessors"][1] |= position
    document["meshes"][0]["primitives"][0] |= primitive
    path.write_bytes(glb(document))
    refused(path, got)


# ---- work that grows with the square of the parts


def test_one_scene_is_made_of_all_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    check = Scene.__post_init__
    monkeypatch.setattr(Scene, "__post_init__", lambda scene: made.append(1) or check(scene))
    path = tmp_path / "mesh.obj"
    groups = "".join(f"g part{i}\nusemtl m{i}\nf 1 2 {3 + i % 2}\n" for i in range(2000))
    path.write_text(OBJ_START + groups)
    assert len(Scene.from_mesh(path).part_names) == 2000
    assert len(made) <= 2
