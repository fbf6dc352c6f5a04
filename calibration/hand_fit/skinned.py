"""Points of the skin that move with the bones: linear blend skinning.

Magnenat-Thalmann, Laperriere and Thalmann, "Joint-dependent local deformations for hand animation
and object grasping", Graphics Interface 1988.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BONES_PER_POINT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Bones:
    """Affine maps of 25 bones from their own coordinates: x = matrix u + origin_m.

    `matrix`, shape (25, 3, 3): axes of the bone as columns, scaled by its size; of a left hand with
    negative determinant. `origin_m`, shape (25, 3), metres.
    """

    matrix: np.ndarray
    origin_m: np.ndarray

    def moved(self, transform: np.ndarray) -> Bones:
        """After a rigid motion, shape (4, 4)."""
        rotation = transform[:3, :3]
        return Bones(rotation @ self.matrix, self.origin_m @ rotation.T + transform[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Bones of points and their weights, both of shape (n, `BONES_PER_POINT`)."""

    bone: np.ndarray
    weight: np.ndarray

    @classmethod
    def of_weights(cls, weights: np.ndarray, bones: np.ndarray) -> Skin:
        """The largest of `weights`, shape (n, m), whose columns belong to `bones`, (m,)."""
        most = np.argsort(-weights, axis=1, kind="stable")[:, :BONES_PER_POINT]
        kept = np.take_along_axis(weights, most, axis=1)
        return cls(bones[most], kept / kept.sum(axis=1, keepdims=True))

    def __getitem__(self, rows: np.ndarray) -> Skin:
        return Skin(self.bone[rows], self.weight[rows])


@dataclass(frozen=True, slots=True, eq=False)
class SkinnedSamples:
    """Samples of a surface in the coordinates of their bones.

    `own`, shape (n, 3, k), position in the coordinates of each of the k bones; `own_normal`, the
    same of the normals, which map by the inverse transpose.
    """

    skin: Skin
    own: np.ndarray
    own_normal: np.ndarray

    @classmethod
    def of(
        cls, points_m: np.ndarray, normals: np.ndarray, skin: Skin, bones: Bones
    ) -> SkinnedSamples:
        """Samples, (n, 3), of a surface whose bones are in this place."""
        inverse = np.linalg.inv(bones.matrix)[skin.bone]
        away_m = points_m[:, None] - bones.origin_m[skin.bone]
        return cls(
            skin=skin,
            own=np.einsum("nkij,nkj->nki", inverse, away_m),
            own_normal=np.einsum("nkji,nj->nki", bones.matrix[skin.bone], normals),
        )

    def __len__(self) -> int:
        return len(self.own)

    def __getitem__(self, rows: np.ndarray) -> SkinnedSamples:
        return SkinnedSamples(self.skin[rows], self.own[rows], self.own_normal[rows])

    def on_any(self, bones: np.ndarray) -> np.ndarray:
        """Mask (n,) of the samples that any of `bones`, a mask (25,), moves."""
        found: np.ndarray = (bones[self.skin.bone] & (self.skin.weight > 0)).any(axis=1)
        return found

    def posed(self, bones: Bones) -> tuple[np.ndarray, np.ndarray]:
        """Points, metres, and unit normals, both (n, 3), where these bones take them."""
        weight = self.skin.weight
        points_m = np.zeros((len(self), 3))
        normals = np.zeros((len(self), 3))
        inverse = np.linalg.inv(bones.matrix)
        for k in range(weight.shape[1]):
            bone, share = self.skin.bone[:, k], weight[:, k, None]
            own_m = np.einsum("nij,nj->ni", bones.matrix[bone], self.own[:, k])
            points_m += share * (own_m + bones.origin_m[bone])
            normals += share * np.einsum("nji,nj->ni", inverse[bone], self.own_normal[:, k])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points_m, normals / np.maximum(length, 1e-12)
