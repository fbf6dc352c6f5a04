"""A rigged hand: its surface in a pose by linear blend skinning, and how it is made of a file's.

Weights are checked and normalised, vertices welded, axes of the bones estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clradar.errors import RigError
from clradar.files.failures import clean
from clradar.hand import JOINT_NAMES, HandMesh, HandPose
from clradar.hand.flesh import PART_NAMES
from clradar.hand.joints import CHAINS, WRIST
from clradar.hand.mesh import DEFAULT_CENTER_M
from clradar.hand.skeleton import posed_skeleton
from clradar.hand.skin import Skin, by_bone
from clradar.model import checks
from clradar.model.plausible import place
from clradar.model.record import Record
from clradar.rigs import anatomy

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

WEIGHT_SUM = (0.9, 1.1)
"""Sums of a vertex's weights that are normalised to 1: bytes round by up to 1/510 per weight, and
tools drop the fifth and further weights."""

MAX_VERTICES = 1_000_000  # of a hand as in the file, which splits vertices at seams

# A hand with the whole forearm has about 2.5 times the reach; a whole body has ten times.
_MAX_EXTENT = 6.0

# Lengths from wrist to finger. Vertices are up to 0.4 from their metacarpal and 0.2 from their
# phalanx; without inverse bind matrices they are farther off.
_MAX_DISTANCE = 0.5


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
    blend : ndarray, shape (V, 3, 135), or None
        MANO's offsets of vertices before skinning, metres, per element of (rotation of a joint
        against its parent) - identity, row by row, of its joints without the wrist.
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
    blend: np.ndarray | None = None
    ignored: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        checks.one_of("Rig.handedness", self.handedness, ("right", "left"))
        self._set(ignored=tuple(self.ignored))
        n = len(JOINT_NAMES)
        self._set_array("axes", np.float64, (3, 3))
        self._set_array("joints_m", np.float64, (n, 3), finite=False)
        self._set_array("frames", np.float64, (n, 3, 3))
        self._set_array("faces", np.int32, (None, 3))
        if self.blend is not None:
            n = 9 * (len(MANO_JOINTS) - 1)
            self._set_array("blend", np.float64, (len(self.skin), 3, n))

    def plain(self) -> dict[str, Any]:
        """The fields in plain types, of which `of_plain` makes the rig again."""
        return {**asdict(self), "ignored": list(self.ignored)}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Rig:
        """The rig of what `plain` returned."""
        return cls(**{**plain, "skin": Skin(**plain["skin"])})

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
            parents = anatomy.parents_of(self.known)[joints]
            against = np.swapaxes(rotations[parents], 1, 2) @ rotations[joints]
            own = self.axes.T @ against @ self.axes - np.eye(3)
            offsets_m = (self.blend @ own.reshape(-1)) @ self.axes.T
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
        places_m, parents = self.joints_m.copy(), anatomy.parents_of(self.known)
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


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Triangles and their skin at rest, in the file's coordinates.

    One row per pair of vertex and joint, ascending; weights sum to 1 over a vertex, and `points`
    (N, 3) is the weight times the position of the vertex as that joint alone has it.
    """

    faces: np.ndarray
    vertex: np.ndarray
    joint: np.ndarray
    weight: np.ndarray
    points: np.ndarray

    @classmethod
    def grouped(
        cls, what: str, faces: np.ndarray, vertex: np.ndarray, joint: np.ndarray,
        weight: np.ndarray, points: np.ndarray,
    ) -> Surface:  # fmt: skip
        """Check and normalise weights, and sum the rows of bones of one joint.

        `points` (N, 3) are the positions of the vertex as the row's bone has it, not weighted.
        """
        if (weight < 0).any():
            bad = vertex[weight < 0][0]
            checks.fail(f"{what}: weights", "numbers from 0", f"less at vertex {bad}")
        if not np.isfinite(points).all():
            checks.fail(what, "a finite place for every vertex", "an overflow")
        used = np.unique(faces)
        sums = np.bincount(vertex, weight, int(used[-1]) + 1)
        low, high = WEIGHT_SUM
        odd = used[~((sums[used] >= low) & (sums[used] <= high))]
        if len(odd):
            expected = f"a sum of 1 (at least {low:g}, at most {high:g})"
            got = f"{sums[odd[0]]:.4g} at vertex {odd[0]}, the first of {len(odd)}"
            checks.fail(f"{what}: weights", expected, got)
        keep = np.isin(vertex, used)
        number = np.searchsorted(used, vertex[keep])
        share = weight[keep] / sums[vertex[keep]]
        pair, row = np.unique(number * len(JOINT_NAMES) + joint[keep], return_inverse=True)
        columns = [share, *(share * points[keep].T)]
        summed = np.stack([np.bincount(row, column, len(pair)) for column in columns], axis=1)
        vertex, joint = np.divmod(pair, len(JOINT_NAMES))
        return cls(np.searchsorted(used, faces), vertex, joint, summed[:, 0], summed[:, 1:])

    @classmethod
    def joined(cls, pieces: Sequence[Surface]) -> Surface:
        """Return several surfaces as one, with vertices of the same position and weights merged."""
        offsets = np.cumsum([0, *(piece.n_vertices for piece in pieces)]).tolist()
        if offsets[-1] > MAX_VERTICES:
            checks.fail("mesh", f"at most {MAX_VERTICES} vertices", offsets[-1])
        columns = [
            (p.faces + offset, p.vertex + offset, p.joint, p.weight, p.points)
            for p, offset in zip(pieces, offsets, strict=False)
        ]
        whole = cls(*map(np.concatenate, zip(*columns, strict=True)))
        # Files split vertices at seams of texture and colour.
        dense = by_bone(whole.vertex, whole.joint, whole.weight[:, None]).toarray()
        _, first, number = np.unique(
            np.concatenate([whole.rest(), dense], axis=1),
            axis=0, return_index=True, return_inverse=True,
        )  # fmt: skip
        # In the order of the file.
        number = np.argsort(np.argsort(first))[number.reshape(-1)]
        faces, rows = number[whole.faces], np.isin(whole.vertex, first)
        return cls(
            faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)],
            number[whole.vertex[rows]], whole.joint[rows], whole.weight[rows], whole.points[rows],
        )  # fmt: skip

    @property
    def n_vertices(self) -> int:
        return int(self.vertex[-1]) + 1

    def rest(self) -> np.ndarray:
        """Return the vertices (n_vertices, 3) at rest."""
        columns = [np.bincount(self.vertex, column, self.n_vertices) for column in self.points.T]
        return np.stack(columns, axis=1)


def rig_of(
    label: str,
    joints: np.ndarray,
    local_axes: np.ndarray,
    surface: Surface,
    side: str | None,
    unit_m: float,
    *,
    blend: np.ndarray | None = None,
    ignored: tuple[str, ...] = (),
) -> Rig:
    """Return the rig of a hand of the file `label`, of a side that is given or named, or None.

    Joints (25, 3), NaN where the rig has none, directions (25, 3, 3) of its own coordinates at
    each, as columns, and the surface are in the file's coordinates and unit.
    """
    if not len(surface.faces):
        checks.fail("mesh", "faces with three corners", "none")
    anatomy.check_joints(joints)
    side = anatomy.check_side(joints, side)
    anatomy.check_unit(joints, unit_m)
    rest = surface.rest()
    extent, size = float(np.ptp(rest, axis=0).max()), anatomy.reach(joints)
    if extent > _MAX_EXTENT * size:
        most = f"at most {_MAX_EXTENT:g} times the length from wrist to finger"
        got = f"{extent / size:.3g} times: remove everything but hand and forearm"
        checks.fail("extent of the mesh", most, got)
    skinned = (surface.joint != WRIST) & (surface.weight > 0.5)
    if skinned.any():
        at = surface.points[skinned] / surface.weight[skinned, None]
        apart = np.linalg.norm(at - joints[surface.joint[skinned]], axis=1)
        distance = float(np.median(apart)) / size
        if distance > _MAX_DISTANCE:
            near = f"most within {_MAX_DISTANCE:g} hand lengths of their joint"
            got = f"{distance:.2g}: are the inverse bind matrices missing, or another skin's?"
            checks.fail("vertices of fingers", near, got)
    axes = anatomy.canonical_axes(joints, side)
    wrist = joints[WRIST]
    joints_m = (joints - wrist) @ axes.T * unit_m
    points_m = (surface.points - surface.weight[:, None] * wrist) @ axes.T * unit_m
    flesh_m = {}
    for chain in CHAINS:
        rows = surface.joint == chain[-2]
        if rows.any():
            flesh_m[chain[-2]] = points_m[rows].sum(axis=0) / surface.weight[rows].sum()
    frames = anatomy.rest_frames(joints_m, axes @ local_axes, flesh_m)
    faces = surface.faces
    # Cones from the centroid, which makes the missing cap of an open wrist count little.
    corners = ((rest - rest.mean(axis=0)) @ axes.T)[faces]
    if np.linalg.det(corners).sum() < 0:  # a mirror in the file, or the one to a right hand
        faces = faces[:, [0, 2, 1]]
    own_m = points_m / surface.weight[:, None] - joints_m[surface.joint]
    skin = Skin(surface.vertex, surface.joint, surface.weight, own_m)
    own = clean(label), side, unit_m, axes, joints_m, frames, faces.astype(np.int32), skin
    return Rig(*own, blend, ignored)
