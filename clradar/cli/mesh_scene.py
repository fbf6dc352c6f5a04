"""Meshes of a command line as one scene, in this process or on a worker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.options.alphas import with_part_alphas
from clradar.cli.options.materials import MaterialOptions

if TYPE_CHECKING:
    import numpy as np

    from clradar import Scene


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeshScene:
    """Files that make up a scene, and how: plain values that a worker process gets.

    Attributes
    ----------
    meshes : sequence of (Path, float or None)
        Files with their alpha, if they have one of their own.
    alpha : float
        Of the others.
    alpha_of_parts : dict
    unit : str
    transform : ndarray, shape (4, 4), or None
    materials : MaterialOptions
    """

    meshes: Sequence[tuple[Path, float | None]]
    alpha: float
    alpha_of_parts: dict[str, float]
    unit: str
    transform: np.ndarray | None
    materials: MaterialOptions

    def load(self) -> Scene:
        """Read the files."""
        scene = load_scene(self.meshes, self.alpha, self.alpha_of_parts, self.unit, self.transform)
        return self.materials.on(scene)


def load_scene(
    meshes: Sequence[tuple[Path, float | None]],
    default: float,
    by_part: dict[str, float],
    unit: str,
    transform: Any,
) -> Scene:
    """All meshes as one scene."""
    from clradar import Scene

    scene = Scene.combine(
        Scene.from_mesh(path, alpha=default if a is None else a, unit=unit, transform=transform)
        for path, a in meshes
    )
    return with_part_alphas(scene, by_part)
