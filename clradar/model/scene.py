"""Scenes: triangle meshes whose faces have a roughness alpha, and a material."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clradar.errors import MeshError, ModelError
from clradar.files.hashing import sha256_of_blocks
from clradar.files.meshes.parts import Parts, parts_of
from clradar.files.meshes.reading import read_mesh_file
from clradar.model import checks
from clradar.model.material import METAL, PERFECT_CONDUCTOR, Material
from clradar.model.plausible import MESH_UNITS_M, place_words, unlikeliness
from clradar.model.record import Record
from clradar.model.scene_materials import (
    Materials,
    face_materials,
    joined,
    material_tuple,
    once,
    stretched,
)

PLAUSIBLE_SIZE_M = (1e-3, 20.0)
"""Plausible length of the longest side of a mesh's bounding box for a near-field radar, metres."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Scene(Record):
    """Triangles in the antenna frame, each with its roughness alpha and its material.

    Parameters
    ----------
    vertices_m : array_like, shape (n_vertices, 3), float64
    faces : array_like, shape (n_faces, 3), int32
        Indices into `vertices_m`, of either winding: faces are two-sided.
    alpha : float or array_like, shape (n_faces,), float64
        0 specular ... 1 diffuse.
    part : int or array_like, shape (n_faces,), int32
        Index into `part_names`.
    part_names : tuple of str
        All different.
    normals : array_like, shape (n_vertices, 3), float64, optional
        Unit normals, of either sign, of the smooth surface that the faces approximate; 0 where they
        are unknown, and estimated.
    materials : tuple of Material
        For the physical estimator; the others use `alpha`.
    material : int or array_like, shape (n_faces,), int32
        Index into `materials`.
    texture_m : array_like, shape (n_vertices, 3), float64, optional
        Coordinates fixed to the body, over which roughness is a height field (docs/conventions.md).
        None: `vertices_m`.

    Examples
    --------
    The texture stays with a body that moves.

    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(radius=40)
    >>> scene = clradar.Scene.from_mesh(ball, alpha=0.3, unit="mm").transformed(
    ...     trimesh.transformations.translation_matrix([0, 0, 0.3])
    ... )
    >>> print(scene.vertices_m.max(axis=0), scene.texture_m.max(axis=0).round(3))
    [0.04 0.04 0.34] [0.04 0.04 0.04]
    """

    vertices_m: np.ndarray
    faces: np.ndarray
    alpha: np.ndarray | float = 0.5
    part: np.ndarray | int = 0
    part_names: tuple[str, ...] = ("mesh",)
    normals: np.ndarray | None = None
    materials: tuple[Material, ...] = (PERFECT_CONDUCTOR,)
    material: np.ndarray | int = 0
    texture_m: np.ndarray | None = None

    def __post_init__(self) -> None:
        vertices = self._set_array("vertices_m", np.float64, (None, 3))
        faces = self._set_array("faces", np.int32, (None, 3))
        checks.indices("Scene.faces", faces, len(vertices))
        self._set(alpha=_alpha_of_faces(self.alpha, len(faces)))
        if isinstance(self.part_names, str) or not isinstance(self.part_names, Iterable):
            checks.fail("Scene.part_names", "a tuple of strings", repr(self.part_names))
        names = tuple(checks.text("Scene.part_names", name) for name in self.part_names)
        if len(set(names)) != len(names):
            checks.fail("Scene.part_names", "unique names", f"{names}")
        part = _index_of_faces("Scene.part", self.part, len(faces), len(names))
        self._set(part=part, part_names=names)
        if self.normals is not None:
            self._set(normals=_unit_normals(self.normals, len(vertices)))
        materials = material_tuple("Scene.materials", self.materials)
        material = _index_of_faces("Scene.material", self.material, len(faces), len(materials))
        self._set(materials=materials, material=material)
        if self.texture_m is not None:
            self._set_array("texture_m", np.float64, (len(vertices), 3))

    @classmethod
    def from_mesh(
        cls,
        mesh: str | PathLike[str] | Any,
        *,
        alpha: float | np.ndarray | Mapping[str, float] = 0.5,
        unit: str = "m",
        transform: Any = None,
        material: Materials | None = None,
    ) -> Scene:
        """Return the scene of a mesh file or mesh.

        Parameters
        ----------
        mesh : path, trimesh.Trimesh, trimesh.Scene, (vertices, faces), or with a `to_trimesh()`
            Every object, group, material and instance of a file becomes a part, of PLY every value
            of the faces' property "part". Normals in files are ignored, texture is read from PLY.
            An object may have `normals`, `texture_m`, `part` and `part_names`.
        alpha : float, array_like of shape (n_faces,), or mapping part name -> float
            An array goes part by part, of PLY face by face.
        unit : "m", "cm", "mm" or "inch"
            Of the mesh's coordinates.
        transform : array_like, shape (4, 4), optional
            Affine, into the antenna frame; applied after the unit.
        material : Material, str, mapping or sequence, optional
            See `with_material`.

        Raises
        ------
        MeshError
            The file is unreadable or beyond limits (docs/untrusted-files.md), or has no triangle, a
            NaN, or a size that is implausible for the unit.
        """
        checks.one_of("Scene.from_mesh: unit", unit, tuple(MESH_UNITS_M))
        matrix = np.eye(4)
        if transform is not None:
            matrix = checks.transform("Scene.from_mesh: transform", transform)
        label, parts = _parts(mesh)
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is refused below
                vertices_m = parts.vertices * MESH_UNITS_M[unit] @ matrix[:3, :3].T + matrix[:3, 3]
            scene = cls(vertices_m, parts.faces, part=parts.part, part_names=_unique(parts.names))
        except ModelError as error:
            raise MeshError(f"{label}: {error}") from error
        _check_plausible_size(label, vertices_m[np.unique(scene.faces)], unit)
        given = mesh if hasattr(mesh, "to_trimesh") else None
        normals = getattr(given, "normals", None)
        if normals is not None:
            normals = checks.read_only("normals", normals, np.float64, (len(vertices_m), 3))
            scene = replace(scene, normals=_transformed_normals(normals, matrix))
        texture = getattr(given, "texture_m", parts.texture)
        if texture is not None or transform is not None:
            body = parts.vertices if texture is None else texture
            body = checks.read_only("texture_m", body, np.float64, (len(vertices_m), 3))
            scene = replace(scene, texture_m=stretched(body * MESH_UNITS_M[unit], matrix))
        scene = scene.with_alpha(alpha)
        return scene if material is None else scene.with_material(material)

    @classmethod
    def combine(cls, scenes: Iterable[Scene]) -> Scene:
        """Return one scene of several, each with its alpha, materials and texture.

        Part names are made unique.
        """
        vertices, faces, alpha, part, normals, texture = [], [], [], [], [], []
        materials = []
        textured = False
        names: list[str] = []
        offset = 0
        for scene in scenes:
            if not isinstance(scene, Scene):
                checks.fail("Scene.combine: scenes", "scenes", type(scene).__name__)
            vertices.append(scene.vertices_m)
            faces.append(scene.faces.astype(np.int64) + offset)
            alpha.append(scene.alpha)
            part.append(scene.part + len(names))
            unknown = np.zeros_like(scene.vertices_m)
            normals.append(unknown if scene.normals is None else scene.normals)
            materials.append((scene.materials, np.asarray(scene.material)))
            texture.append(scene.body_m)
            textured = textured or scene.texture_m is not None
            names += scene.part_names
            offset += len(scene.vertices_m)
        if not faces:
            checks.fail("Scene.combine: scenes", "at least one scene", "none")
        return cls(
            np.concatenate(vertices),
            np.concatenate(faces),
            np.concatenate(alpha),
            np.concatenate(part),
            _unique(names),
            np.concatenate(normals) if any(n.any() for n in normals) else None,
            *joined(materials),
            np.concatenate(texture) if textured else None,
        )

    def with_alpha(self, alpha: float | np.ndarray | Mapping[str, float]) -> Scene:
        """Return the same triangles with another alpha: a number, one per face, or one per part."""
        if isinstance(alpha, Mapping):
            unknown = sorted(set(alpha) - set(self.part_names))
            missing = sorted(set(self.part_names) - set(alpha))
            if unknown or missing:
                checks.fail(
                    "alpha",
                    f"one value for each of the parts {list(self.part_names)}",
                    f"unknown {unknown}, missing {missing}",
                )
            return replace(self, alpha=np.array([alpha[n] for n in self.part_names])[self.part])
        return replace(self, alpha=alpha)

    def with_material(self, material: Materials) -> Scene:
        """Return the same triangles of another material.

        It is a material or a name of `clradar.material`; a sequence, one per face; or a mapping
        from part names (``{"thumb": "skin"}``), where other parts keep theirs.
        """
        now = (self.materials, np.asarray(self.material))
        part = (np.asarray(self.part), self.part_names)
        materials, index = face_materials(material, now, *part)
        return replace(self, materials=materials, material=index)

    def transformed(self, transform: Any) -> Scene:
        """Return the scene moved by an affine transform, shape (4, 4), with its texture.

        What the transform stretches, it stretches along the axes of the texture.
        """
        matrix = checks.transform("Scene.transformed: transform", transform)
        normals = None if self.normals is None else _transformed_normals(self.normals, matrix)
        vertices_m = self.vertices_m @ matrix[:3, :3].T + matrix[:3, 3]
        texture_m = stretched(self.body_m, matrix)
        return replace(self, vertices_m=vertices_m, normals=normals, texture_m=texture_m)

    @property
    def n_faces(self) -> int:
        return len(self.faces)

    @property
    def body_m(self) -> np.ndarray:
        """The texture's coordinates of every vertex, shape (n_vertices, 3)."""
        return self.vertices_m if self.texture_m is None else self.texture_m

    @property
    def triangles_m(self) -> np.ndarray:
        """Corners of every face, shape (n_faces, 3, 3)."""
        return self.vertices_m[self.faces]

    def digest(self) -> str:
        """Return a SHA-256 of triangles, alpha and given normals.

        Where a face is not of metal, of materials and texture, too.
        """
        return sha256_of_blocks(self._blocks())

    def _blocks(self) -> Iterator[bytes]:
        """The bytes of `digest`, one array in memory at a time."""
        yield self.triangles_m.tobytes()
        yield np.asarray(self.alpha).tobytes()
        if self.normals is not None:
            yield self.normals[self.faces].tobytes()
        materials, material = once(self.materials, np.asarray(self.material))
        if materials not in ((METAL,), (PERFECT_CONDUCTOR,)):
            yield material.tobytes()
            yield self.body_m[self.faces].tobytes()
            yield from (repr(own).encode() for own in materials)


def _index_of_faces(field: str, index: Any, n_faces: int, count: int) -> np.ndarray:
    if checks.is_single(index):
        index = np.full(n_faces, checks.whole(field, index, 0))
    index = checks.read_only(field, index, np.int32, (n_faces,))
    checks.indices(field, index, count)
    return index


def _alpha_of_faces(alpha: Any, n_faces: int) -> np.ndarray:
    if checks.is_single(alpha):
        alpha = np.full(n_faces, checks.real("alpha", alpha))
    values = checks.read_only("alpha", alpha, np.float64, (n_faces,))
    if values.min() < 0.0 or values.max() > 1.0:
        checks.fail("alpha", "values in [0, 1]", f"[{values.min():g}, {values.max():g}]")
    return values


def _unit_normals(normals: Any, n_vertices: int) -> np.ndarray:
    given = checks.read_only("Scene.normals", normals, np.float64, (n_vertices, 3))
    length = np.linalg.norm(given, axis=1)
    wrong = np.flatnonzero((length > 0) & (np.abs(length - 1.0) > 1e-3))
    if len(wrong):
        found = f"length {length[wrong[0]]:.4g} at vertex {wrong[0]}"
        checks.fail("Scene.normals", "unit length, or 0", found)
    return given


def _transformed_normals(normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Transform normals of a surface by the inverse transpose of an affine transform."""
    with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is refused by the scene
        moved = normals @ np.linalg.inv(matrix[:3, :3])
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        return moved / np.where(length > 0, length, 1.0)


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names with a number behind those that occurred before: skin, skin-2, ..."""
    taken: dict[str, int] = {}
    for name in names:
        found, number = name, taken.get(name, 1)
        while found in taken:
            number += 1
            found = f"{name}-{number}"
        taken[name] = number
        taken.setdefault(found, 1)
    return tuple(taken)


def _parts(mesh: Any) -> tuple[str, Parts]:
    """Return a label for messages, and the parts of a mesh."""
    if isinstance(mesh, str | PathLike):
        path = Path(mesh)
        return str(path), read_mesh_file(path)
    if isinstance(mesh, tuple) and len(mesh) == 2:
        vertices = checks.read_only("mesh vertices", mesh[0], np.float64, (None, 3), finite=False)
        faces = checks.read_only("mesh faces", mesh[1], np.int32, (None, 3))
        return "mesh", Parts(vertices, faces, np.zeros(len(faces), np.int32), ("mesh",))
    import trimesh

    given, names = mesh, getattr(mesh, "part_names", None)
    if hasattr(mesh, "to_trimesh"):
        mesh = mesh.to_trimesh()
    if not isinstance(mesh, trimesh.Trimesh | trimesh.Scene):
        raise MeshError(
            "mesh: expected a mesh file, a trimesh.Trimesh, a trimesh.Scene or "
            f"(vertices, faces), got {type(mesh).__name__}"
        )
    parts = parts_of("mesh", mesh)
    if given is mesh or names is None:
        return "mesh", parts
    return "mesh", replace(parts, part=np.asarray(given.part), names=tuple(names))


def _check_plausible_size(label: str, vertices_m: np.ndarray, unit: str) -> None:
    with np.errstate(over="ignore"):  # an infinite size is implausible
        size_m = float(np.ptp(vertices_m, axis=0).max())
        range_m = float(np.linalg.norm(vertices_m.min(axis=0) + vertices_m.max(axis=0))) / 2
    low, high = PLAUSIBLE_SIZE_M
    if low <= size_m <= high:
        return
    places = {
        other: np.array([size_m, range_m]) * unit_m / MESH_UNITS_M[unit]
        for other, unit_m in MESH_UNITS_M.items()
        if low <= size_m * unit_m / MESH_UNITS_M[unit] <= high
    }
    likely = sorted(places, key=lambda other: unlikeliness(*places[other]))
    meant = " or ".join(f"unit='{other}' ({place_words(*places[other])})" for other in likely)
    raise MeshError(
        f"{label}: expected a mesh between {low:g} m and {high:g} m in size for unit='{unit}', "
        f"got {size_m:g} m" + (f"; did you mean {meant}?" if meant else "")
    )
