"""Samples of the skin that move with the bones, as of `clradar.hand.skin`, and their rates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from clradar.hand.skin import by_bone

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
class BoneRates:
    """Derivatives of `Bones` by k parameters: arrays (k, 25, 3, 3) and (k, 25, 3)."""

    matrix: np.ndarray
    origin_m: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> BoneRates:
        return BoneRates(self.matrix[rows], self.origin_m[rows])

    @property
    def moving(self) -> np.ndarray:
        """Mask (25,) of the bones that any of the parameters moves."""
        turned = (self.matrix != 0.0).any(axis=(0, 2, 3))
        return turned | (self.origin_m != 0.0).any(axis=(0, 2))


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


@dataclass(frozen=True, eq=False)
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
        return (bones[self.skin.bone] & (self.skin.weight > 0)).any(axis=1)

    @cached_property
    def _weighted(self) -> tuple[csr_array, csr_array]:
        """The weighted coordinates as matrices: (n, 100) homogeneous of points, (n, 75) normals."""
        carried = self.skin.weight > 0
        share = self.skin.weight[..., None]
        points = share * np.concatenate([self.own, np.ones_like(share)], axis=2)
        rows = np.nonzero(carried)[0], self.skin.bone[carried]
        normals = share * self.own_normal
        n = len(self)
        return by_bone(*rows, points[carried], n), by_bone(*rows, normals[carried], n)

    def posed(self, bones: Bones) -> tuple[np.ndarray, np.ndarray]:
        """Points, metres, and unit normals, both (n, 3), where these bones take them."""
        points, normals = self._weighted
        maps = np.concatenate([np.swapaxes(bones.matrix, 1, 2), bones.origin_m[:, None]], axis=1)
        points_m = points @ maps.reshape(-1, 3)
        turned = normals @ np.linalg.inv(bones.matrix).reshape(-1, 3)
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        return points_m, turned / np.maximum(length, 1e-12)

    def velocities(
        self, bones: Bones, rates: BoneRates, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the points, metres, and unit normals of `rows` where `bones` take them.

        Both of shape (n_rows, 3, k), by the k parameters of the rates.
        """
        shape = len(rows), 3, len(rates.matrix)
        points, normals = (each[rows] for each in self._weighted)
        maps = np.concatenate([np.swapaxes(rates.matrix, 2, 3), rates.origin_m[:, :, None]], axis=2)
        d_points = points @ np.moveaxis(maps, 0, 3).reshape(-1, shape[1] * shape[2])
        inverse = np.linalg.inv(bones.matrix)
        tilts = -inverse @ rates.matrix @ inverse
        d_normals = normals @ np.moveaxis(tilts, 0, 3).reshape(-1, shape[1] * shape[2])
        d_normals = d_normals.reshape(shape)
        turned = normals @ inverse.reshape(-1, 3)
        length = np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
        unit = turned / length
        d_normals -= unit[..., None] * np.einsum("nik,ni->nk", d_normals, unit)[:, None]
        d_normals /= length[..., None]
        return d_points.reshape(shape), d_normals
