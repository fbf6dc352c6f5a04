"""OBJ and glTF as trimesh reads them by itself, and where the formats say more than that."""

from pathlib import Path

import mesh_files
import numpy as np
import pytest
import trimesh
from mesh_files import OBJ_START, glb, tetrahedron

from clradar import Scene

ROUNDING_M = 1e-15  # a transform of coordinates below 1 m


def triangles_by_trimesh(path: Path) -> tuple[np.ndarray, list[str]]:
    options = {"split_objects": True, "split_groups": True} if path.suffix == ".obj" else {}
    scene = trimesh.load_scene(path, process=False, **options)
    found, names = [], []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        if not isinstance(scene.geometry[name], trimesh.Trimesh):
            continue
        vertices = trimesh.transform_points(scene.geometry[name].vertices, matrix)
        found.append(vertices[scene.geometry[name].faces])
        names.append(name)
    if path.suffix == ".obj":
        return np.concatenate(found[::-1]), names[::-1]
    return np.concatenate(found), names


OBJ = {
    "triangles": "f 1 2 3\nf 1 2 4\n",
    "quadrilaterals": "f 1 2 3 4\nf 2 3 4 1\nf 3 1 2 4\n",
    "a pentagon": "f 1 2 3 4 1\nf 2 3 4 1 2\n",
    "mixed polygons": "f 1 2 3 4 2\nf 1 2 3\nf 1 2 3 4\nf 4 3 2\n",
    "textures": "vt 0 0\nf 1/1 2/1 3/1\nf 1/1 2/1 4/1\n",
    "normals": "vn 0 0 1\nf 1//1 2//1 3//1\nf 2//1 3//1 4//1\n",
    "both": "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 2/1/1 3/1/1 4/1/1\n",
    "in several ways": "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 2//1 3//1 4//1\nf 1 2 4\n",
    "from the end": "f -4 -3 -2\nf -1 -2 -3\n",
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


def obj(tmp_path: Path, text: str) -> Scene:
    path = tmp_path / "mesh.obj"
    path.write_text(text, encoding="utf-8")
    return Scene.from_mesh(path)


def test_what_obj_files_may_hold_besides(tmp_path):
    corners = mesh_files.CORNERS.astype(float).round(7)
    texts = [
        "# écrit\n\tv 0 0 0 1.0\nv\t0.1 0 0\nv 0 0.2 0 0.5 0.5 0.5\nv 0 0 0.3\nl 1 2\np 1\n"
        "vp 0.1\n  f 1 2 3 # the first\nf\t1/2/3 2//4 4\nmtllib none.mtl\nusemtl skin\n",
        # Counted back from the line, wherever more vertices follow.
        "v 0 0 0\nv 0.1 0 0\nv 0 0.2 0\nf -3 -2 -1\nv 0 0 0.3\nf -4 -3 -1\n",
    ]
    for text in texts:
        scene = obj(tmp_path, text)
        np.testing.assert_array_equal(scene.triangles_m, corners[[[0, 1, 2], [0, 1, 3]]])
        assert scene.part_names == ("mesh.obj",)


def test_gltf_scenes_are_read_as_by_trimesh(tmp_path):
    rng = np.random.default_rng(4)
    half = np.sqrt(0.5)
    primitive = {"attributes": {"POSITION": 1}, "indices": 0}
    document = tetrahedron(
        scene=1,
        scenes=[{"nodes": [6]}, {"nodes": [0, 4]}],
        nodes=[
            {"children": [1, 2], "translation": [0.1, 0.2, 0.3]},
            {"mesh": 0, "rotation": [half, 0, 0, half], "scale": [1, 2, 3]},
            {"mesh": 1, "children": [3], "matrix": rng.normal(size=16).round(2).tolist()},
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
    matrix = np.array(document["nodes"][2]["matrix"]).reshape(4, 4)
    matrix[:, 3] = 0, 0, 0, 1
    document["nodes"][2]["matrix"] = matrix.reshape(-1).tolist()
    path = tmp_path / "mesh.glb"
    path.write_bytes(glb(document))
    want, names = triangles_by_trimesh(path)
    have = Scene.from_mesh(path)
    np.testing.assert_allclose(have.triangles_m, want, rtol=0, atol=ROUNDING_M)
    assert [name.split("-")[0] for name in have.part_names] == names


def test_a_node_of_gltf_may_have_a_camera_and_a_mesh(tmp_path):
    nodes = [{"mesh": 0, "camera": 0, "children": [1]}, {"mesh": 0}]
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}
    path = tmp_path / "mesh.glb"
    path.write_bytes(glb(tetrahedron(nodes=nodes, cameras=[camera])))
    assert Scene.from_mesh(path).n_faces == 8
