"""Partition of a mesh into regions, each with its own alpha."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.model import Scene, checks
from clradar.model.record import Record

PALM, FINGERS = "palm", "fingers"
DIGITS = ("thumb", "index", "middle", "ring", "pinky")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Regions(Record):
    """The region of each face of a mesh.

    Parameters
    ----------
    face : array_like, shape (n_faces,), int32
        Index into `names`; every region has a face.
    names : tuple of str
        Two or more.

    Examples
    --------
    >>> regions = calibration.Regions.of_labels(["palm", "thumb", "palm"])
    >>> regions.names, regions.face.tolist()
    (('palm', 'thumb'), [0, 1, 0])
    """

    face: np.ndarray
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        face = self._set_array("face", np.int32, (None,))
        names = tuple(checks.text("regions: names", name) for name in self.names)
        if len(names) < 2 or len(set(names)) != len(names):
            checks.fail("regions", "at least two, with names of their own", f"{list(names)}")
        checks.indices("regions", face, len(names))
        empty = [name for i, name in enumerate(names) if not (face == i).any()]
        if empty:
            checks.fail("regions", "at least one face in each", f"none in {empty}")
        self._set(names=names)

    @classmethod
    def of_labels(cls, labels: Sequence[Any] | np.ndarray) -> Regions:
        """Make regions of one label per face, whole numbers or strings."""
        values, face = np.unique(np.asarray(labels), return_inverse=True)
        return cls(face.reshape(-1), tuple(str(value) for value in values))

    @classmethod
    def of_parts(cls, scene: Scene, groups: Mapping[str, Sequence[str]] | None = None) -> Regions:
        """Make regions of the named parts of a scene, or of groups of them.

        `groups` maps a region to the names of its parts, every part once.
        """
        parts = [scene.part_names[i] for i in np.unique(scene.part)]
        if groups is None:
            groups = {name: [name] for name in parts}
        listed = [name for names in groups.values() for name in names]
        if sorted(map(repr, listed)) != sorted(map(repr, parts)):
            checks.fail("regions", f"each of the parts {parts} in one region", f"{listed}")
        number = np.full(len(scene.part_names), -1)
        for i, names in enumerate(groups.values()):
            for name in names:
                number[scene.part_names.index(name)] = i
        return cls(number[scene.part], tuple(groups))

    @classmethod
    def of_fingers(cls, scene: Scene) -> Regions:
        """Make the regions palm and fingers of the parts of a hand."""
        names = set(scene.part_names)
        if PALM not in names or not names & set(DIGITS) or names - {PALM, *DIGITS}:
            expected = f"a hand with the parts {[PALM, *DIGITS]}"
            checks.fail("regions 'fingers'", expected, f"the parts {list(scene.part_names)}")
        present = [name for name in scene.part_names if name in DIGITS]
        return cls.of_parts(scene, {PALM: [PALM], FINGERS: present})
