"""OBJ and glTF: as trimesh reads them by itself, and files that lie or overwhelm."""

import json
from typing import Any

import numpy as np
import pytest
import trimesh
from mesh_files import CORNERS, OBJ_START, glb, tetrahedron

from clradar import Scene
from clradar.errors import MeshError
from clradar.files.meshes.parts import parts_of


def triangles_by_trimesh(path):
    options = {"split_objects": True, "split_groups": True} if path.suffix == ".obj" else {}
    scene = trimesh.load_scene(path, process=False, **options)
    found, names = [], []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        if isinstance(scene.geometry[name], trimesh.Trimesh):
            vertices = trimesh.transform_points(scene.geometry[name].vertices, matrix)
            found.append(vertices[scene.geometry[name].faces])
            names.append(name)
    turn = -1 if path.suffix == ".obj" else 1
    return np.concatenate(found[::turn]), names[::turn]


OBJ = {
    "mixed polygons": "f 1 2 3 4 2\nf 1 2 3\nf 1 2 3 4\nf 4 3 2\n",
    "textures": "vt 0 0\nf 1/1 2/1 3/1\nf 1/1 2/1 4/1\n",
    "in several ways": "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 2//1 3//1 4//1\nf 1 2 4\n",
    "objects and groups": "o a\nf 1 2 3\ng x\nf 2 3 4\no b\nf 1 3 4\no a\nf 1 2 4\n",
    "names with blanks": "o a hand\nf 1 2 3\ng left thumb\nf 2 3 4\n",
    "smoothing": "s 1\nf 1 2 3\ns off\nf 2 3 4\n",
    "carriage returns": "o a\r\nf 1 2 3\r\no b\r\nf 2 3 4\r\n",
    "continued lines": "f 1 2 \\\n3\nf 2 3 4\n",
}


@pytest.mark.parametrize("faces", OBJ.values(), ids=OBJ)
def test_obj_files_are_read_as_by_trimesh(tmp_path, faces):
    path = tmp_path / "mesh.obj"
    path.write_bytes((OBJ_START + faces).encode())
    want, names = triangles_by_trimesh(path)
    have = Scene.from_mesh(path)
    np.testing.assert_array_equal(have.triangles_m, want)
    assert list(have.part_names) == names


def test_what_obj_files_may_hold_besides(tmp_path):
    text = (
        "# écrit\n\tv 0 0 0 1.0\nv\t0.1 0 0\nv 0 0.2 0 0.5 0.5 0.5\nv 0 0 0.3\nl 1 2\np 1\n"
        "vp 0.1\n  f 1 2 3 # the first\nf\t1/2/3 2//4 4\nmtllib none.mtl\nusemtl skin\n"
    )
    (tmp_path / "mesh.obj").write_text(text, encoding="utf-8")
    scene = Scene.from_mesh(tmp_path / "mesh.obj")
    corners = CORNERS.astype(float).round(7)
    np.testing.assert_array_equal(scene.triangles_m, corners[[[0, 1, 2], [0, 1, 3]]])
    assert scene.part_names == ("mesh.obj",)


def written(folder, **changes):
    path = folder / "mesh.glb"
    path.write_bytes(glb(tetrahedron(**changes)))
    return path


def test_gltf_scenes_are_read_as_by_trimesh(tmp_path):
    half = np.sqrt(0.5)
    matrix = np.eye(4)
    matrix[:, :3] = np.random.default_rng(4).normal(size=(4, 3)).round(2)
    primitive = {"attributes": {"POSITION": 1}, "indices": 0}
    path = written(
        tmp_path,
        scene=1,
        scenes=[{"nodes": [6]}, {"nodes": [0, 4]}],
        nodes=[
            {"children": [1, 2], "translation": [0.1, 0.2, 0.3]},
            {"mesh": 0, "rotation": [half, 0, 0, half], "scale": [1, 2, 3]},
            {"mesh": 1, "children": [3], "matrix": matrix.reshape(-1).tolist()},
            {"mesh": 0, "name": "rock"},
            {"mesh": 2, "children": [5]},
            {"name": "empty"},
            {"mesh": 0},
        ],
        meshes=[
            {"name": "rock", "primitives": [primitive]},
            {"name": "rock", "primitives": [primitive, primitive]},
            {"primitives": [primitive, primitive | {"mode": 1}]},
        ],
    )
    want, names = triangles_by_trimesh(path)
    have = Scene.from_mesh(path)
    # A transform of coordinates below 1 m.
    np.testing.assert_allclose(have.triangles_m, want, rtol=0, atol=1e-15)
    assert [name.split("-")[0] for name in have.part_names] == names


def test_a_node_of_gltf_may_have_a_camera_and_a_mesh(tmp_path):
    nodes = [{"mesh": 0, "camera": 0, "children": [1]}, {"mesh": 0}]
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}
    assert Scene.from_mesh(written(tmp_path, nodes=nodes, cameras=[camera])).n_faces == 8


# ---- what is refused


def refused(path, *texts):
    with pytest.raises(MeshError) as caught:
        Scene.from_mesh(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for text in texts:
        assert text in message


def test_a_buffer_without_data_is_named(tmp_path):
    path = tmp_path / "mesh.gltf"
    path.write_text(json.dumps(tetrahedron(buffers=[{"byteLength": 72}])))
    refused(path, "buffer 0: expected a uri")
    path.write_text(json.dumps(tetrahedron(buffers=[{"byteLength": 72, "uri": "x" * 1000}])))
    with pytest.raises(MeshError, match=r"expected buffer 0 of mesh\.gltf, got "):
        Scene.from_mesh(path)


def test_a_chain_of_nodes_is_refused_before_trimesh_walks_it(tmp_path):
    def chain(count):
        nodes = [{"children": [i + 1]} for i in range(count - 1)]
        return written(tmp_path, nodes=[*nodes, {"mesh": 0}])

    assert Scene.from_mesh(chain(1000)).n_faces == 4
    refused(chain(50_000), "nodes: expected at most 1000 levels")


@pytest.mark.parametrize(
    ("name", "most", "text"),
    [
        ("MAX_MESH_FACES", 39, "at most 39 triangles.*simplify or join.*got 40"),
        ("MAX_MESH_PARTS", 9, "at most 9 parts.*got 10"),
    ],
)
def test_instances_are_counted_before_they_are_made(tmp_path, monkeypatch, name, most, text):
    nodes: list[dict[str, Any]] = [{"children": list(range(1, 11))}]
    path = written(tmp_path, nodes=nodes + [{"mesh": 0}] * 10)
    scene = trimesh.load_scene(path, process=False)
    monkeypatch.setattr(trimesh, "transform_points", lambda *_: pytest.fail("made"))
    monkeypatch.setattr(f"clradar.files.meshes.parts.{name}", most)
    with pytest.raises(MeshError, match=text):
        parts_of(str(path), scene, limited=True)


@pytest.mark.parametrize("name", ["mesh.zip", "mesh.dxf", "mesh"])
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
    document = tetrahedron()
    document["accessors"][1] |= position
    document["meshes"][0]["primitives"][0] |= primitive
    refused(written(tmp_path, **document), got)
