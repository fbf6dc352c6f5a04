"""A rigged hand at rest, and its surface in a pose by linear blend skinning."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clradar.errors import RigError
from clradar.hand import JOINT_NAMES, HandMesh, HandPose
from clradar.hand.flesh import PART_NAMES
from clradar.hand.joints import CHAINS, WRIST
from clradar.hand.mesh import DEFAULT_CENTER_M
from clradar.hand.skeleton import posed_skeleton
from clradar.hand.skin import Skin
from clradar.model import checks
from clradar.model.plausible import place
from clradar.model.record import Record
from clradar.rigs.anatomy import parents_of

# The ball of the thumb belongs to the palm, as in the hand of this package.
_PART_OF_JOINT = np.zeros(len(JOINT_NAMES), dtype=np.int64)
for _part, _chain in enumerate(CHAINS, start=1):
    _PART_OF_JOINT[list(_chain[1:])] = _part

MANO_JOINTS: tuple[int, ...] = (
    WRIST,
    *(joint for digit in (1, 2, 4, 3) for joint in CHAINS[digit][1:4]),
    *CHAINS[0][:3],
)
"""The 16 joints of MANO, in its order, as indices into `JOINT_NAMES`."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseBlend(Record):
    """Pose-dependent offsets of the vertices before skinning: the pose blend shapes of MANO.

    `directions` (n_vertices, 3, 135), metres, per element of (rotation of the joint against its
    parent) - identity, row by row, of `MANO_JOINTS` without the wrist; `hands_mean` (45,), radians,
    and `hands_components` (n, 45).
    """

    directions: np.ndarray
    hands_mean: np.ndarray
    hands_components: np.ndarray

    def __post_init__(self) -> None:
        n = 3 * (len(MANO_JOINTS) - 1)
        self._set_array("directions", np.float64, (None, 3, 3 * n), allow_empty=True)
        self._set_array("hands_mean", np.float64, (n,), allow_empty=True)
        self._set_array("hands_components", np.float64, (None, n), allow_empty=True)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Rig(Record):
    """A rigged hand at rest, in metres, in the frame of `clradar.hand`'s right hand.

    `read_rig` makes one.

    Attributes
    ----------
    label : str
        The file it came from.
    handedness : "right" or "left"
        Left hands are stored as their mirror image and mirrored again when they are posed.
    unit_m : float
        The file's unit of length.
    axes : ndarray, shape (3, 3)
        Orthogonal: from the file's directions to this frame.
    joints_m, frames : ndarray, shape (25, 3) and (25, 3, 3)
        As of `clradar.hand.Skeleton`, at rest; joints that the rig has not are NaN.
    faces : ndarray, shape (F, 3), int32
    skin : Skin
        Of the vertices, in the coordinates of joints at rest.
    blend : PoseBlend or None
        Offsets of MANO.
    ignored : tuple of str
        Meshes of the file that do not belong to the hand.
    """

    label: str
    handedness: str
    unit_m: float
    axes: np.ndarray
    joints_m: np.ndarray
    frames: np.ndarray
    faces: np.ndarray
    skin: Skin
    blend: PoseBlend | None = None
    ignored: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        checks.one_of("Rig.handedness", self.handedness, ("right", "left"))
        self._set(ignored=tuple(self.ignored))
        n = len(JOINT_NAMES)
        self._set_array("axes", np.float64, (3, 3))
        self._set_array("joints_m", np.float64, (n, 3), finite=False)
        self._set_array("frames", np.float64, (n, 3, 3))
        self._set_array("faces", np.int32, (None, 3))

    def plain(self) -> dict[str, Any]:
        """The fields in plain types, of which `of_plain` makes the rig again."""
        return {**asdict(self), "ignored": list(self.ignored)}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Rig:
        """The rig of what `plain` returned."""
        blend = None if plain["blend"] is None else PoseBlend(**plain["blend"])
        return cls(**{**plain, "skin": Skin(**plain["skin"]), "blend": blend})

    @property
    def known(self) -> np.ndarray:
        """Mask (25,) of the joints that the rig has."""
        return np.isfinite(self.joints_m).all(axis=1)

    def posed(self, pose: str | HandPose = "F", center_m: Any = DEFAULT_CENTER_M) -> HandMesh:
        """Return the surface of this hand in a pose, palm towards the radar.

        As `clradar.hand.hand_mesh`: bones have the directions that they have there, and the rig's
        lengths.
        """
        return self.turned(self.rotations(pose), center_m)

    def rotations(self, pose: str | HandPose) -> np.ndarray:
        """Return the rotations (25, 3, 3) F G^T of bones with axes F in the pose and G at rest."""
        return posed_skeleton(pose).frames @ np.swapaxes(self.frames, 1, 2)

    def turned(self, rotations: np.ndarray, center_m: Any = DEFAULT_CENTER_M) -> HandMesh:
        """Return the surface with every bone rotated from rest by (25, 3, 3), as of `rotations`.

        docs/rigs.md has the equation.
        """
        centre_m = place("center_m", center_m)
        places_m = self.joint_places_m(rotations)
        vertices_m = self.skin.posed(rotations, places_m)
        if self.blend is not None:
            joints = list(MANO_JOINTS[1:])
            parents = parents_of(self.known)[joints]
            against = np.swapaxes(rotations[parents], 1, 2) @ rotations[joints]
            own = self.axes.T @ against @ self.axes - np.eye(3)
            offsets_m = (self.blend.directions @ own.reshape(-1)) @ self.axes.T
            turned = (self.skin.weights @ rotations.reshape(-1, 9)).reshape(-1, 3, 3)
            vertices_m += np.einsum("vij,vj->vi", turned, offsets_m)
        if not np.isfinite(vertices_m).all():
            raise RigError(f"{self.label}: expected finite vertices, got NaN")
        middle_m = 0.5 * (vertices_m.min(axis=0) + vertices_m.max(axis=0))
        mirror = np.diag([-1.0 if self.handedness == "left" else 1.0, 1.0, 1.0])
        rest_m = self.skin.posed(np.tile(np.eye(3), (len(JOINT_NAMES), 1, 1)), self.joints_m)
        right = HandMesh(vertices_m, self.faces, places_m, self._parts(), texture_m=rest_m)
        return right.moved(mirror, centre_m - mirror @ middle_m)

    def joint_places_m(self, rotations: np.ndarray) -> np.ndarray:
        """Return the joints (25, 3) after rotations as of `turned`; NaN for none."""
        places_m, parents = self.joints_m.copy(), parents_of(self.known)
        for joint in np.flatnonzero(self.known)[1:]:  # from the wrist on
            up = parents[joint]
            bone_m = self.joints_m[joint] - self.joints_m[up]
            places_m[joint] = places_m[up] + rotations[up] @ bone_m
        return places_m

    def _parts(self) -> np.ndarray:
        """Return for every face (F,) the part with the largest weight at its corners."""
        of_part = np.arange(len(PART_NAMES)) == _PART_OF_JOINT[:, None]
        share = self.skin.weights @ of_part.astype(np.float64)
        return np.argmax(share[self.faces].sum(axis=1), axis=1).astype(np.int32)
