"""The hands that can be fitted, the parametric one and rigs, behind one interface."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.spatial import KDTree

from calibration.hand_fit.result import TIPS, end_joints
from calibration.hand_fit.skinned import Bones, Skin
from clradar.hand import HandMesh, HandPose, HandShape, hand_mesh, posed_skeleton
from clradar.hand.skeleton import Skeleton
from clradar.hand.skin import skin_weights
from clradar.opencl import Device
from clradar.rigs import Rig

_NEXT_OF_WRIST = 10  # the base of the middle finger's metacarpal


class HandModel(Protocol):
    """A hand that takes poses: the parametric hand, or a rig.

    Everything is in the frame of the hand: `clradar.hand.posed_skeleton`, mirrored in x for a left
    hand, the wrist at the origin.
    """

    @property
    def handedness(self) -> str: ...

    @property
    def has_shape(self) -> bool:
        """Whether `HandShape` changes it."""

    def joints_m(self, pose: HandPose, shape: HandShape) -> np.ndarray:
        """Joint centres, shape (25, 3), metres; NaN where the hand has none."""

    def bones(self, pose: HandPose, shape: HandShape) -> Bones:
        """Where the bones take their skin."""

    def mesh(self, pose: HandPose, shape: HandShape, edge_m: float) -> HandMesh:
        """The surface, meshed anew."""

    def skin(
        self, mesh: HandMesh, pose: HandPose, shape: HandShape, points_m: np.ndarray,
        normals: np.ndarray,
    ) -> Skin:  # fmt: skip
        """Bones and weights of points on a mesh of this hand in a pose, (n, 3), and normals."""


@dataclass(frozen=True, slots=True)
class ParametricHand:
    """The hand of `clradar.hand`."""

    handedness: str = "right"
    device: Device | str | None = None
    has_shape: bool = field(default=True, init=False)

    def joints_m(self, pose: HandPose, shape: HandShape) -> np.ndarray:
        return posed_skeleton(pose, shape).joints_m * _mirror(self.handedness)

    def bones(self, pose: HandPose, shape: HandShape) -> Bones:
        """Along a bone the skin scales with its length, across it with the girth."""
        skeleton = posed_skeleton(pose, shape)
        ends = np.arange(1, 26)
        ends[0], ends[-1] = _NEXT_OF_WRIST, 24
        length_m = np.linalg.norm(skeleton.joints_m[ends] - skeleton.joints_m, axis=1)
        across = np.full(25, skeleton.thickness)
        # A tip carries no skin, and its bone has no length.
        scale = np.stack([across, np.maximum(length_m, 1e-3), across], axis=1)
        matrix = _mirror(self.handedness)[:, None] * skeleton.frames * scale[:, None, :]
        return Bones(matrix, skeleton.joints_m * _mirror(self.handedness))

    def mesh(self, pose: HandPose, shape: HandShape, edge_m: float) -> HandMesh:
        made = hand_mesh(
            pose, edge_m, self.handedness, (0.0, 0.0, 0.0), shape=shape, device=self.device
        )
        return made.moved(np.eye(3), -made.joints_m[0])

    def skin(
        self, mesh: HandMesh, pose: HandPose, shape: HandShape, points_m: np.ndarray,
        normals: np.ndarray,
    ) -> Skin:  # fmt: skip
        posed: Skeleton = posed_skeleton(pose, shape)
        weights = skin_weights(
            points_m * _mirror(self.handedness), normals * _mirror(self.handedness), posed
        )
        return Skin.of_weights(weights, np.arange(25))


@dataclass(frozen=True, slots=True, eq=False)
class RiggedHand:
    """A rigged hand; it keeps its size and its side."""

    rig: Rig
    has_shape: bool = field(default=False, init=False)

    @property
    def handedness(self) -> str:
        return self.rig.handedness

    def joints_m(self, pose: HandPose, shape: HandShape) -> np.ndarray:
        places_m = self.rig.joint_places_m(self.rig.rotations(pose))
        return (places_m - places_m[0]) * _mirror(self.handedness)

    def bones(self, pose: HandPose, shape: HandShape) -> Bones:
        matrix = _mirror(self.handedness)[:, None] * posed_skeleton(pose).frames
        origin_m = self.joints_m(pose, shape)
        origin_m[list(TIPS)] = origin_m[end_joints(origin_m)]
        return Bones(matrix, np.nan_to_num(origin_m))

    def mesh(self, pose: HandPose, shape: HandShape, edge_m: float) -> HandMesh:
        """The rig's own triangles, whatever the edge length."""
        made = self.rig.posed(pose, (0.0, 0.0, 0.0))
        return made.moved(np.eye(3), -made.joints_m[0])

    def skin(
        self, mesh: HandMesh, pose: HandPose, shape: HandShape, points_m: np.ndarray,
        normals: np.ndarray,
    ) -> Skin:  # fmt: skip
        """Those of the nearest vertex."""
        weights = self.rig.skin.weights.toarray()
        _, nearest = KDTree(mesh.vertices_m).query(points_m)
        return Skin.of_weights(weights[nearest], np.arange(25))


def _mirror(handedness: str) -> np.ndarray:
    """Factors of the coordinates, (3,), from the right hand's frame to that of the hand."""
    return np.array([-1.0 if handedness == "left" else 1.0, 1.0, 1.0])
