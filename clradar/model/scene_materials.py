"""Materials of a scene's faces, and the texture that moves with a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clradar.model import checks
from clradar.model.known_materials import material
from clradar.model.material import Material

Materials = Material | str | Mapping[str, "Material | str"] | Sequence["Material | str"]
"""What `Scene.with_material` takes."""

Index = tuple[tuple[Material, ...], np.ndarray]
"""Different materials, and for each face, int32, the index of its own."""


def material_tuple(field: str, value: Any) -> tuple[Material, ...]:
    """Return a tuple of materials, of which there is at least one."""
    if not isinstance(value, list | tuple) or not value:
        checks.fail(field, "a tuple of materials", repr(value))
    for own in value:
        checks.instance(field, own, Material)
    return tuple(value)


def face_materials(
    given: Materials, now: Index, part: np.ndarray, part_names: tuple[str, ...]
) -> Index:
    """Return the materials of faces, of which some are replaced, each once, and that of each face.

    `given` is one material for all faces, one per face, or one for each named part, where others
    stay as they are `now`. The order is that of the faces that have a material first.
    """
    if isinstance(given, Material | str):
        return (_material(given),), np.zeros(len(part), np.int32)
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in part_names]
        if unknown:
            checks.fail("material", f"parts among {list(part_names)}", f"unknown {unknown}")
        materials, index = list(now[0]), np.array(now[1])
        for name, own in given.items():
            index[part == part_names.index(name)] = len(materials)
            materials.append(_material(own))
        return once(materials, index)
    if not isinstance(given, Sequence | np.ndarray):
        expected = "a material, its name, a mapping of parts, or one per face"
        checks.fail("material", expected, type(given).__name__)
    if len(given) != len(part):
        checks.fail("material", f"{len(part)} materials, one per face", f"{len(given)}")
    # By name or place in memory: hashing a material takes microseconds, and faces are many.
    keys = [own if isinstance(own, str) else id(own) for own in given]
    different = dict(zip(keys, given, strict=True))
    number = {key: i for i, key in enumerate(different)}
    index = np.array([number[key] for key in keys], np.int32)
    return once([_material(own) for own in different.values()], index)


def _material(given: Any) -> Material:
    return given if isinstance(given, Material) else material(given)


def joined(scenes: Sequence[Index]) -> Index:
    """Return the materials of the faces of several scenes behind one another."""
    materials = [own for one, _ in scenes for own in one]
    starts = np.cumsum([0, *(len(one) for one, _ in scenes)])
    shifted = [index + start for (_, index), start in zip(scenes, starts, strict=False)]
    return once(materials, np.concatenate(shifted))


def once(materials: Sequence[Material], index: np.ndarray) -> Index:
    """Leave out materials that no face has, and equal ones; in the order of the faces."""
    present, first = np.unique(index, return_index=True)
    numbers: dict[Material, int] = {}
    number = np.zeros(len(materials), np.int32)
    for old in present[np.argsort(first)]:
        number[old] = numbers.setdefault(materials[old], len(numbers))
    return tuple(numbers), number[index]


def stretched(body_m: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """Return the coordinates (n, 3) fixed to a body after an affine transform (4, 4) of the body.

    A motion or a mirror image leaves them as they are. Of another linear part A = Q S, where Q is
    orthogonal and S symmetric (polar decomposition), they get the stretch S.
    """
    _, stretch, axes = np.linalg.svd(transform[:3, :3])
    if np.abs(stretch - 1.0).max() < RIGID:
        return body_m
    with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is refused by the scene
        return body_m @ ((axes.T * stretch) @ axes)


RIGID = 1e-12
"""Of a motion's singular values from 1: rounding in float64, and far less than any bump."""
