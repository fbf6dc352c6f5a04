"""Hands whose pose changes over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.hand import HandMesh, HandPose, HandShape, hand_mesh, interpolate_poses, posed_skeleton
from clradar.hand.joints import WRIST
from clradar.hand.mesh import (
    DEFAULT_CENTER_M,
    DEFAULT_EDGE_LENGTH_M,
    checked_edge_m,
    kept_from_skin,
)
from clradar.hand.pose_file import pose_of
from clradar.hand.shape import AVERAGE
from clradar.hand.skin import Skin, skin_weights
from clradar.model import Scene, checks
from clradar.model.plausible import place
from clradar.model.record import Record
from clradar.motion.rigid import PROFILES, STILL, BodyInSweep, RigidMotion, between, moved, pieces
from clradar.opencl import Device

if TYPE_CHECKING:
    from clradar.rigs import Rig


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MovingHand(Record):
    """A hand that goes from pose to pose, and may move as a whole meanwhile.

    Parameters
    ----------
    times_s : array_like, shape (n,), float64
        Of the poses, increasing. Before the first and after the last one the pose stays.
    poses : sequence of str, path-like or HandPose
        Names in `POSES`, pose files or poses.
    profile : {"smooth", "linear"}
        Of the joint angles: from rest to rest with the least jerk, or evenly.
    motion : RigidMotion, optional
        Of the whole hand.
    center_m : array_like, shape (3,)
        Centre of the box around the joints of all poses; the wrist stays while the pose changes.
    shape, edge_length_m, handedness
        As of `clradar.hand.hand_mesh`; a rig takes only the shape.
    rig : Rig, optional
        In place of this package's hand.
    alpha : float
    device : Device, str or None
        Where the surface is sampled, see `clradar.open_device`.
    """

    times_s: Any
    poses: Sequence[Any]
    profile: str = "smooth"
    motion: RigidMotion = STILL
    center_m: Any = DEFAULT_CENTER_M
    shape: HandShape = AVERAGE
    edge_length_m: float = DEFAULT_EDGE_LENGTH_M
    handedness: str = "right"
    rig: Rig | None = None
    alpha: float = 0.5
    device: Device | str | None = None
    _wrist_m: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times_s = checks.one_axis("MovingHand.times_s", self.times_s)
        poses = tuple(map(pose_of, checks.several("MovingHand.poses", self.poses)))
        if len(poses) != len(times_s):
            checks.fail("MovingHand.poses", f"one for each of {len(times_s)} times", len(poses))
        checks.one_of("MovingHand.profile", self.profile, PROFILES)
        checks.instance("MovingHand.motion", self.motion, RigidMotion)
        checks.instance("MovingHand.shape", self.shape, HandShape)
        if self.rig is None:
            self._set(edge_length_m=checked_edge_m(self.edge_length_m))
        checks.one_of("MovingHand.handedness", self.handedness, ("right", "left"))
        center_m = place("center_m", self.center_m)
        side = self.handedness if self.rig is None else self.rig.handedness
        self._set(times_s=times_s, poses=poses, center_m=center_m, handedness=side)
        keys_m = [posed_skeleton(pose, self.shape).joints_m * self._mirror for pose in poses]
        box_m = np.min(keys_m, axis=(0, 1)), np.max(keys_m, axis=(0, 1))
        self._set(_wrist_m=center_m - 0.5 * (box_m[0] + box_m[1]))

    def pose(self, time_s: float) -> HandPose:
        """Return the pose at a time."""
        begin, share = between(self.times_s, time_s, self.profile)
        first, last = self.poses[begin], self.poses[min(begin + 1, len(self.poses) - 1)]
        if share in (0.0, 1.0) or first == last:
            return last if share == 1.0 else first
        return interpolate_poses(first, last, share)

    @property
    def _mirror(self) -> np.ndarray:
        """Factors of the coordinates, (3,), from the right hand's frame to that of the hand."""
        return np.array([-1.0 if self.handedness == "left" else 1.0, 1.0, 1.0])

    def transform(self, time_s: float) -> np.ndarray:
        """Return the transform (4, 4) from the frame of the hand, whose wrist is the origin."""
        made = np.eye(4)
        made[:3, 3] = self._wrist_m
        return np.asarray(self.motion.at(time_s) @ made)

    def joints_m(self, time_s: float) -> np.ndarray:
        """Return the joints at a time, shape (25, 3), antenna frame; NaN where a rig has none."""
        if self.rig is not None:
            return self.mesh(time_s).joints_m
        own_m = posed_skeleton(self.pose(time_s), self.shape).joints_m * self._mirror
        return moved(self.transform(time_s), own_m)

    def mesh(self, time_s: float) -> HandMesh:
        """Return the surface at a time, in the antenna frame."""
        return self._placed(self._posed(self.pose(time_s)), time_s)

    def during(self, begin_s: float, end_s: float) -> BodyInSweep:
        """Return the hand during a sweep, meshed in its middle: from there the skin moves with the
        bones, on the surface of each pose. A rig has the same faces in all poses.

        :meta private:
        """
        poses = self.poses
        ways = pieces(self.times_s, begin_s, end_s)
        turned_s = [times_s for first, *times_s in ways if poses[first] != poses[first + 1]]
        marks_s = np.union1d(self.motion.marks_s(begin_s, end_s), turned_s)
        own = _HandInSweep(self, self.pose(0.5 * (begin_s + end_s)))
        carried = own.mesh.faces if self.rig is None and len(marks_s) else None
        return BodyInSweep(marks_s, own.scene, own.vertices_m, carried)

    def _posed(self, pose: HandPose) -> HandMesh:
        if self.rig is not None:
            return self.rig.posed(pose)
        return hand_mesh(
            pose, self.edge_length_m, self.handedness, shape=self.shape, device=self.device
        )

    def _placed(self, mesh: HandMesh, time_s: float) -> HandMesh:
        """Bring a mesh in its own upright place to that of a time; its wrist is the origin."""
        transform = self.transform(time_s)
        at_origin = mesh.moved(np.eye(3), -mesh.joints_m[WRIST])
        return at_origin.moved(transform[:3, :3], transform[:3, 3])


@dataclass(frozen=True)
class _HandInSweep:
    """A hand on the faces that it has in the middle of a sweep."""

    hand: MovingHand
    middle: HandPose

    @cached_property
    def mesh(self) -> HandMesh:
        return self.hand._posed(self.middle)

    @cached_property
    def _skin(self) -> tuple[Skin, np.ndarray]:
        """The skin in the frame of the skeleton, and its distances from the surface, metres."""
        hand, mesh, bones = self.hand, self.mesh, posed_skeleton(self.middle, self.hand.shape)
        assert mesh.normals is not None
        at_m = (mesh.vertices_m - mesh.joints_m[WRIST]) * hand._mirror + bones.joints_m[WRIST]
        _, _, away_m = kept_from_skin(at_m, None, self.middle, hand.shape, hand.device)
        weights = skin_weights(at_m, mesh.normals * hand._mirror, bones)
        return Skin.on(at_m, weights, bones), away_m

    def _carried(self, pose: HandPose, rows: Any = None) -> tuple[np.ndarray, ...]:
        """Vertices (n, 3), their normals (n, 3) and the joints (25, 3) in a pose.

        In the frame of the hand, whose wrist is the origin, metres.
        """
        hand, bones = self.hand, posed_skeleton(pose, self.hand.shape)
        skin, away_m = self._skin
        if rows is not None:
            skin, away_m = skin.of_points(rows), away_m[rows]
        carried_m = skin.posed(bones.frames, bones.joints_m)
        # The mean over bones leaves the surface where joints bend, by up to a millimetre.
        moved_m, normals, _ = kept_from_skin(carried_m, away_m, pose, hand.shape, hand.device)
        wrist_m = bones.joints_m[WRIST]
        own = (moved_m - wrist_m, normals, bones.joints_m - wrist_m)
        return tuple(vectors * hand._mirror for vectors in own)

    def vertices_m(self, time_s: float, rows: Any) -> np.ndarray:
        pose = self.hand.pose(time_s)
        if isinstance(rows, slice) or pose == self.middle or self.hand.rig is not None:
            return self._mesh_at(time_s).vertices_m[rows]
        return moved(self.hand.transform(time_s), self._carried(pose, rows)[0])

    def scene(self, time_s: float) -> Scene:
        return Scene.from_mesh(self._mesh_at(time_s), alpha=self.hand.alpha)

    def _mesh_at(self, time_s: float) -> HandMesh:
        pose, mesh = self.hand.pose(time_s), self.mesh
        if pose != self.middle and self.hand.rig is not None:
            mesh = self.hand._posed(pose)
        elif pose != self.middle:
            at_m, normals, joints_m = self._carried(pose)
            mesh = replace(mesh, vertices_m=at_m, normals=normals, joints_m=joints_m)
        return self.hand._placed(mesh, time_s)
