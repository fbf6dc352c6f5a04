"""Build a rig: weights checked and normalised, vertices welded, axes of the bones estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clradar.files.failures import clean
from clradar.hand import JOINT_NAMES
from clradar.hand.joints import CHAINS, WRIST
from clradar.hand.skin import Skin, by_bone
from clradar.model import checks
from clradar.rigs.anatomy import canonical_axes, check_unit, reach, rest_frames
from clradar.rigs.rig import PoseBlend, Rig

WEIGHT_SUM = (0.9, 1.1)
"""Sums of a vertex's weights that are normalised to 1: bytes round by up to 1/510 per weight, and
tools drop the fifth and further weights."""

MAX_VERTICES = 1_000_000
"""Of a hand as in the file, which splits vertices at seams."""

# A hand with the whole forearm has about 2.5 times the reach; a whole body has ten times.
_MAX_EXTENT = 6.0

# Lengths from wrist to finger. Vertices are up to 0.4 from their metacarpal and 0.2 from their
# phalanx; without inverse bind matrices they are farther off.
_MAX_DISTANCE = 0.5


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
            checks.fail(
                f"{what}: weights", "numbers from 0", f"less at vertex {vertex[weight < 0][0]}"
            )
        if not np.isfinite(points).all():
            checks.fail(what, "a finite place for every vertex", "an overflow")
        used = np.unique(faces)
        sums = np.bincount(vertex, weight, int(used[-1]) + 1 if len(used) else 0)
        low, high = WEIGHT_SUM
        odd = used[~((sums[used] >= low) & (sums[used] <= high))]
        if len(odd):
            more = f" and others at {len(odd) - 1} more" if len(odd) > 1 else ""
            expected = f"a sum of 1 (at least {low:g}, at most {high:g})"
            got = f"{sums[odd[0]]:.4g} at vertex {odd[0]}{more}"
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
        return int(self.vertex[-1]) + 1 if len(self.vertex) else 0

    def rest(self) -> np.ndarray:
        """Return the vertices (n_vertices, 3) at rest."""
        columns = [np.bincount(self.vertex, column, self.n_vertices) for column in self.points.T]
        return np.stack(columns, axis=1)


def rig_of(
    label: str,
    joints: np.ndarray,
    local_axes: np.ndarray,
    surface: Surface,
    side: str,
    unit_m: float,
    *,
    blend: PoseBlend | None = None,
    ignored: tuple[str, ...] = (),
) -> Rig:
    """Return the rig of a hand of the file `label`.

    Joints (25, 3), NaN where the rig has none, directions (25, 3, 3) of its own coordinates at
    each, as columns, and the surface are in the file's coordinates and unit.
    """
    if not len(surface.faces):
        checks.fail("mesh", "faces with three corners", "none")
    check_unit(joints, unit_m)
    rest = surface.rest()
    extent, size = float(np.ptp(rest, axis=0).max()), reach(joints)
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
    axes = canonical_axes(joints, side)
    wrist = joints[WRIST]
    joints_m = (joints - wrist) @ axes.T * unit_m
    points_m = (surface.points - surface.weight[:, None] * wrist) @ axes.T * unit_m
    flesh_m = {}
    for chain in CHAINS:
        rows = surface.joint == chain[-2]
        if rows.any():
            flesh_m[chain[-2]] = points_m[rows].sum(axis=0) / surface.weight[rows].sum()
    frames = rest_frames(joints_m, axes @ local_axes, flesh_m)
    faces = surface.faces
    # Cones from the centroid, which makes the missing cap of an open wrist count little.
    corners = ((rest - rest.mean(axis=0)) @ axes.T)[faces]
    if np.linalg.det(corners).sum() < 0:  # a mirror in the file, or the one to a right hand
        faces = faces[:, [0, 2, 1]]
    own_m = points_m / surface.weight[:, None] - joints_m[surface.joint]
    skin = Skin(surface.vertex, surface.joint, surface.weight, own_m)
    own = clean(label), side, unit_m, axes, joints_m, frames, faces.astype(np.int32), skin
    return Rig(*own, blend, ignored)
