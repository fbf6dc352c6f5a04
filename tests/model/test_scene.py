"""Scenes: mesh files of several formats, units, parts, alpha and transforms."""

import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from clradar import Scene
from clradar.errors import ClradarError, MeshError
from clradar.files.meshes.parts import ply_of_parts
from clradar.model.known_materials import material
from clradar.model.material import METAL, PERFECT_CONDUCTOR, Material

# Some formats store float32: 6e-8 of the largest coordinate, which is below 0.5 m here.
FLOAT32_M = 3e-8
# A transform is three products and sums of coordinates below 1 m in float64.
ROUNDING_M = 1e-15

SIZE_M = np.array([0.08, 0.05, 0.02])
CENTRE_M = np.array([0.01, 0.02, 0.3])


def box(offset_m: float = 0.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=SIZE_M)
    mesh.apply_translation(CENTRE_M + np.array([offset_m, 0, 0]))
    return mesh


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj", "glb", "off"])
def test_mesh_files_of_every_format_give_the_same_triangles(tmp_path, kind):
    path = tmp_path / f"box with blanks.{kind.removesuffix('_ascii')}"
    box().export(path, file_type=kind)
    scene = Scene.from_mesh(str(path), alpha=0.25)
    assert len(scene.part_names) == 1
    assert set(scene.alpha) == {0.25}
    np.testing.assert_allclose(scene.triangles_m, box().triangles, rtol=0, atol=FLOAT32_M)


class Posed:
    """A body that gives a mesh, and knows its normals."""

    def __init__(self, mesh: trimesh.Trimesh, normals: Any = None) -> None:
        self.mesh, self.normals = mesh, normals

    def to_trimesh(self) -> trimesh.Trimesh:
        return self.mesh


def test_meshes_in_memory():
    for mesh in (box(), trimesh.Scene(box()), (box().vertices, box().faces), Posed(box())):
        np.testing.assert_array_equal(Scene.from_mesh(mesh).triangles_m, box().triangles)


def test_parts_of_a_ply_file_keep_names_and_the_order_of_faces(tmp_path):
    """As `clradar register` writes them; another program may have left out the names."""
    mesh = trimesh.creation.icosphere(1, 0.05)
    part = np.arange(len(mesh.faces)) % 3
    content = ply_of_parts(
        mesh.vertices, mesh.faces, part, ("palm", "left thumb", "\u03b1", "unused")
    )
    (tmp_path / "named.ply").write_bytes(content)
    scene = Scene.from_mesh(tmp_path / "named.ply")
    assert scene.part_names == ("palm", "left thumb", "\u03b1")
    assert np.array_equal(scene.part, part)
    assert np.array_equal(scene.faces, mesh.faces)
    np.testing.assert_allclose(scene.vertices_m, mesh.vertices, atol=FLOAT32_M)
    # The same triangles for a reader that knows of no parts.
    assert np.array_equal(
        trimesh.load_mesh(tmp_path / "named.ply", process=False).faces, mesh.faces
    )

    mesh.face_attributes["part"] = 7 + part.astype(np.int32)
    for encoding in ("ascii", "binary"):
        mesh.export(tmp_path / "numbers.ply", encoding=encoding)
        scene = Scene.from_mesh(tmp_path / "numbers.ply")
        assert scene.part_names == ("7", "8", "9")
        assert np.array_equal(scene.part, part)


def test_texture_of_a_ply_file_is_read_where_all_of_it_is_there(tmp_path):
    mesh = trimesh.creation.icosphere(1, 50)
    texture = np.array(mesh.vertices)[:, ::-1].copy()
    content = ply_of_parts(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces)), ["ball"], texture)
    (tmp_path / "ball.ply").write_bytes(content)
    scene = Scene.from_mesh(tmp_path / "ball.ply", unit="mm", transform=rotated(0.3))
    np.testing.assert_allclose(scene.texture_m, 1e-3 * texture, atol=FLOAT32_M)
    np.testing.assert_array_equal(
        trimesh.load_mesh(tmp_path / "ball.ply", process=False).vertices.astype(np.float32),
        mesh.vertices.astype(np.float32),
    )
    texture[3, 1] = np.nan
    nan = ply_of_parts(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces)), ["ball"], texture)
    for other in (content.replace(b"texture_z", b"texture_w"), nan):
        (tmp_path / "other.ply").write_bytes(other)
        assert Scene.from_mesh(tmp_path / "other.ply", unit="mm").texture_m is None


@pytest.mark.parametrize(
    ("scale", "unit", "size", "others"),
    [
        (1000, "m", "80 m", ["mm (80 mm", "cm (800 mm", "inch (2.03 m"]),
        (260, "m", "20.8 m", ["cm (208 mm", "inch (528 mm", "mm (20.8 mm"]),
        (1, "mm", "8e-05 m", ["m (80 mm", "inch (2.03 mm"]),
        (0.0, "m", "0 m", []),
    ],
)
def test_an_implausible_size_suggests_the_other_units(tmp_path, scale, unit, size, others):
    path = tmp_path / "box.off"
    mesh = box()
    mesh.vertices *= scale
    mesh.export(path)
    said = f"between 0.001 m and 20 m in size for unit='{unit}', got {size}"
    with pytest.raises(MeshError, match=re.escape(said)) as caught:
        Scene.from_mesh(path, unit=unit)
    found = re.findall(r"unit='(\w+)' (\([\d.]+ \w+) at", str(caught.value))
    assert [" ".join(one) for one in found] == others


def test_files_that_are_no_mesh_are_named(tmp_path):
    text, points = tmp_path / "mesh.docx", tmp_path / "points.ply"
    text.write_text("no mesh")
    trimesh.PointCloud(np.eye(3)).export(points)
    for path, said in (
        (tmp_path / "absent.ply", "expected a mesh file .*, got"),
        (tmp_path, ""),
        (text, r".*mesh file \(.*\.stl.*'.docx'$"),
        (points, ".*at least one triangle"),
    ):
        with pytest.raises(MeshError, match=rf"^{re.escape(str(path))}: {said}"):
            Scene.from_mesh(path)


FAR = np.diag([1.7e308, 1.0, 1.0]) - np.diag([0.0, 0.0, 1.7e308])
FAR[2, 0] = -1.7e308


FLAT = np.eye(4)
FLAT[:3, :3] = np.outer([3, 1, 7], [2, 9, 4]) / 100 + np.outer([1, 5, 3], [7, 3, 1]) / 100

REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a tuple": (lambda: Scene.from_mesh((1, 2, 3)), "expected a mesh file.*got tuple"),
    "a vertex": (
        lambda: Scene.from_mesh((0.1 * np.eye(3), [[0, 1, 3]])),
        r"mesh: Scene.faces: expected indices in \[0, 3\)",
    ),
    "NaN": (
        lambda: Scene.from_mesh((np.diag([1, 1, np.nan]), [[0, 1, 2]])),
        r"^mesh: .*expected finite numbers, got .* NaN or",
    ),
    "far arrays": (lambda: Scene.from_mesh((FAR, [[0, 1, 2]])), "got inf m"),
    "a far mesh": (
        lambda: Scene.from_mesh(trimesh.Trimesh(FAR, [[0, 1, 2]], process=False)),
        "got inf m",
    ),
    "a unit": (lambda: Scene.from_mesh(box(), unit="ft"), "one of 'm', 'cm', 'mm', 'inch', got"),
    "normals": (lambda: Scene.from_mesh(Posed(box(), np.eye(2))), "^normals: expected"),
    "no scene": (lambda: Scene.combine([]), "expected at least one scene, got none"),
    "other scenes": (lambda: Scene.combine([box()]), "expected scenes, got Trimesh"),
    "an alpha's part": (
        lambda: Scene.from_mesh(box(), alpha={"mesh": 0.5, "glove": 1}),
        r"alpha: .*each of the parts \['mesh'\], got unknown \['glove'\]",
    ),
    "a flat transform": (
        # Of rank two: its determinant is rounding, not zero.
        lambda: Scene.from_mesh(box(), transform=FLAT),
        r"Scene\.from_mesh: transform: expected an invertible 4x4 matrix, got a singular one",
    ),
    "a transform": (
        lambda: Scene.from_mesh(box()).transformed(np.eye(3)),
        r"Scene\.transformed: transform: expected shape \(4, 4\), got shape \(3, 3\)",
    ),
    "a material": (lambda: two_parts().with_material("rubber"), "^material.*'metal', .*'rubber'"),
    "a part": (
        lambda: two_parts().with_material({"three": "palm"}),
        r"expected parts among \['one', 'two'\], got unknown \['three'\]",
    ),
    "materials": (
        lambda: two_parts().with_material(["palm"] * 11),
        "expected 12 materials, one per face, got 11",
    ),
    "no material": (
        lambda: two_parts().with_material(3),
        "^material.*: expected a material, its name, .*got int",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    make, message = REFUSED[name]
    with pytest.raises(ClradarError, match=message):
        make()


def test_several_meshes_with_their_own_alpha():
    one = Scene.from_mesh(box(), alpha=0.1)
    two = Scene.from_mesh(box(0.2), alpha=np.linspace(0, 1, 12))
    both = Scene.combine([one, two])
    assert both.part_names == ("mesh", "mesh-2")
    np.testing.assert_array_equal(
        both.triangles_m, np.concatenate([one.triangles_m, two.triangles_m])
    )
    np.testing.assert_array_equal(both.alpha, np.concatenate([one.alpha, two.alpha]))
    np.testing.assert_array_equal(both.part, np.repeat([0, 1], 12))
    again = Scene.combine([both, one])
    assert again.part_names == ("mesh", "mesh-2", "mesh-3")
    by_part = again.with_alpha({"mesh": 0, "mesh-2": 0.2, "mesh-3": 0.3})
    np.testing.assert_array_equal(by_part.alpha, np.repeat([0, 0.2, 0.3], 12))


def rotated(angle: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    matrix[:3, 3] = [0.05, -0.02, 0.1]
    return matrix


@pytest.mark.parametrize(
    "matrix",
    [np.eye(4), rotated(0.7), rotated(0.7) @ np.diag([-1.0, 1.0, 1.0, 1.0])],
    ids=["identity", "rotated", "mirrored"],
)
def test_transform_moves_every_corner(matrix):
    want = box().triangles @ matrix[:3, :3].T + matrix[:3, 3]
    moved = Scene.from_mesh(box(), transform=matrix.tolist(), alpha=0.3)
    np.testing.assert_allclose(moved.triangles_m, want, rtol=0, atol=ROUNDING_M)
    later = Scene.from_mesh(box(), alpha=0.3).transformed(matrix)
    np.testing.assert_allclose(later.triangles_m, want, rtol=0, atol=ROUNDING_M)
    assert set(later.alpha) == {0.3}


# Normals of the surface that the faces approximate


def ellipsoid() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices and faces of a unit sphere, the matrix that makes it one, and its normals."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])
    matrix = turn @ np.diag([-0.2, 0.1, 0.05, 1.0])  # mirrored
    matrix[:3, 3] = [0.1, 0.0, 0.3]
    inner = (ball.vertices @ matrix[:3, :3].T) @ np.linalg.inv(matrix[:3, :3] @ matrix[:3, :3].T)
    return (
        np.asarray(ball.vertices),
        np.asarray(ball.faces),
        matrix,
        inner / np.linalg.norm(inner, axis=1, keepdims=True),
    )


def test_normals_are_transformed_with_the_surface():
    vertices, faces, matrix, normals = ellipsoid()
    ball = Scene(vertices, faces, normals=vertices)
    np.testing.assert_allclose(ball.transformed(matrix).normals, normals, atol=1e-12)

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    made = Scene.from_mesh(Posed(mesh, vertices), transform=matrix)
    np.testing.assert_allclose(made.normals, normals, atol=1e-12)
    assert Scene.from_mesh(mesh).normals is None


def test_normals_that_are_not_known_stay_so():
    vertices, faces, matrix, normals = ellipsoid()
    known = normals.copy()
    known[::3] = 0.0
    some = Scene(vertices, faces, normals=known)
    assert (some.transformed(matrix).normals[::3] == 0).all()
    plain = Scene(vertices, faces)
    both = Scene.combine([plain, some])
    assert (both.normals[: len(vertices)] == 0).all()
    np.testing.assert_array_equal(both.normals[len(vertices) :], known)
    assert Scene.combine([plain, plain]).normals is None


# Materials of faces, and the texture that moves with the body


PALM, SKIN = material("palm"), material("skin")


def two_parts() -> Scene:
    return Scene(box().vertices, box().faces, part=np.arange(12) % 2, part_names=("one", "two"))


def materials_of(scene: Scene) -> list[str]:
    return [scene.materials[i].name for i in np.asarray(scene.material)]


def test_materials_are_given_for_all_faces_for_parts_and_for_faces():
    scene = two_parts()
    assert scene.materials == (PERFECT_CONDUCTOR,)
    assert not np.any(scene.material)
    for palm in ("palm", PALM):
        assert materials_of(scene.with_material(palm)) == ["palm"] * 12
    mixed = scene.with_material({"two": "skin"})
    assert materials_of(mixed) == ["perfect conductor", "skin"] * 6
    assert materials_of(mixed.with_material({"one": PALM})) == ["palm", "skin"] * 6
    assert mixed.with_material({"one": SKIN}).materials == (SKIN,)

    each = ["skin", "palm", PALM, "metal"] * 3
    assert materials_of(scene.with_material(each)) == ["skin", "palm", "palm", "metal"] * 3
    assert scene.with_material(each).materials == (SKIN, PALM, METAL)
    named = np.array(["skin", "palm"] * 6)
    assert materials_of(scene.with_material(named)) == named.tolist()
    from_mesh = Scene.from_mesh(box(), material={"mesh": "palm"}, alpha=0.3)
    assert materials_of(from_mesh) == ["palm"] * 12


def test_what_replaces_a_scene_keeps_materials_and_texture():
    known = replace(two_parts(), normals=np.tile([0, 0, 1.0], (8, 1)))
    scene = known.with_material({"two": "skin"}).transformed(rotated(0.4))
    for again in (
        pickle.loads(pickle.dumps(scene)),
        scene.with_alpha(0.1),
        scene.transformed(rotated(1.0)),
    ):
        assert materials_of(again) == materials_of(scene)
        assert again.normals is not None
        np.testing.assert_array_equal(again.texture_m, box().vertices)
    plain = Scene.from_mesh(box(0.2), material="plaster")
    both = Scene.combine([scene, plain, scene])
    assert materials_of(both) == [*materials_of(scene), *["plaster"] * 12, *materials_of(scene)]
    assert [m.name for m in both.materials] == ["perfect conductor", "skin", "plaster"]
    texture_m = [box().vertices, box(0.2).vertices, box().vertices]
    np.testing.assert_array_equal(both.texture_m, np.concatenate(texture_m))
    assert Scene.combine([plain, plain]).texture_m is None


def test_a_motion_keeps_the_texture_and_a_stretch_stretches_it():
    vertices, faces, matrix, _ = ellipsoid()
    ball = Scene(vertices, faces)
    motion = rotated(0.7) @ trimesh.transformations.translation_matrix([0.1, 0.2, 0.3])
    for move in (motion, motion @ np.diag([-1.0, 1.0, 1.0, 1.0])):  # and a mirror image
        np.testing.assert_array_equal(ball.transformed(move).texture_m, vertices)
        np.testing.assert_array_equal(ball.transformed(move).transformed(move).texture_m, vertices)
    # Distances on a stretched body are those of its texture; also where it was turned before.
    smaller = ball.transformed(motion).transformed(np.diag([0.125, 0.125, 0.125, 1.0]))
    for scene in (ball.transformed(matrix), smaller):
        on_skin, in_texture = (
            np.linalg.norm(np.diff(points[faces[:, :2]], axis=1), axis=-1)
            for points in (scene.vertices_m, scene.texture_m)
        )
        np.testing.assert_allclose(in_texture, on_skin)
    # Of a file, metres of the unmoved body.
    mesh = trimesh.Trimesh(vertices * 50, faces, process=False)
    moved = Scene.from_mesh(mesh, unit="mm", transform=motion)
    np.testing.assert_allclose(moved.texture_m, vertices * 0.05, atol=ROUNDING_M)
    assert Scene.from_mesh(mesh, unit="mm").texture_m is None


def test_materials_and_texture_count_in_the_digest_unless_all_is_metal():
    plain, palm = two_parts(), two_parts().with_material("palm")
    assert plain.digest() != plain.transformed(rotated(1e-9)).digest()
    assert plain.digest() != plain.with_alpha(0.4).digest()
    assert plain.digest() == two_parts().with_material("metal").digest()
    assert plain.digest() != replace(plain, normals=np.eye(3)[[0] * 8]).digest()
    textured = replace(plain, texture_m=2 * plain.vertices_m)
    assert textured.digest() == plain.digest()
    rougher = Material("palm", 3.0, roughness_rms_m=1e-4, correlation_length_m=1e-3)
    scenes = [
        plain,
        palm,
        textured.with_material("palm"),
        plain.with_material(rougher),
        plain.with_material({"one": "palm"}),
        plain.with_material({"two": "palm"}),
    ]
    assert len({scene.digest() for scene in scenes}) == len(scenes)
    assert replace(plain, normals=np.tile([0, 0, 1.0], (8, 1))).digest() != plain.digest()
    # The order of the materials does not count.
    swapped = Scene(plain.vertices_m, plain.faces, materials=(METAL, PALM), material=1)
    assert swapped.digest() == palm.digest()
