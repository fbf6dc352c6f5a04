"""Pictures of many poses of one digit at a time, without meshing anew.

Skin is sampled in a few poses and moves with its bones. What the radar sees of
the digit that moves, and what it hides of the rest, is found by depth on pixels of the hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.hand_fit.digit_chain import bones_of_digit
from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_rendering import EDGE_M, SAMPLES_PER_MM2 as RENDERED_PER_MM2
from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT, pose_with
from calibration.hand_fit.skinned import Bones, SkinnedSamples
from calibration.registration.mesh_rendering import KNOTS_RAD, Canvas, Pixels
from clradar.hand import HandPose, HandShape
from clradar.model import Scene
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

SAMPLES_PER_MM2 = 0.5

HIDDEN_M = 8e-3  # what lies farther behind something else is hidden: half a finger's thickness
DEPTH_PIXEL_M = 4e-3  # of the depths that hide: eight samples each
_AT_ONCE = 48  # pictures


_SPREAD_DEG = (10.0, 0.0, 6.0, 15.0)
_FINGERS_DEG = ((10.0, 10.0, 10.0), (35.0, 55.0, 35.0), (65.0, 95.0, 50.0), (10.0, 95.0, 60.0))
_THUMBS_DEG = (
    (-20.0, 40.0, 25.0, 10.0, 10.0), (-55.0, 0.0, -20.0, 10.0, 10.0),
    (0.0, 55.0, 65.0, 40.0, 35.0), (-20.0, 25.0, 20.0, 40.0, 45.0),
)  # fmt: skip
"""Where skin is drawn: no digit touches another there, and no pose is far from all of them."""


class HandSkin:
    """Samples of the skin of every digit, drawn in a few poses, and of the whole hand in any.

    `pose` is that of the joints that are not fitted.
    """

    def __init__(
        self, model: HandModel, pose: HandPose, shape: HandShape, device: Device, seed: int = 0
    ) -> None:
        self.model, self.device, self.seed = model, device, seed
        self._drawn = []
        for thumb, bent in zip(_THUMBS_DEG, _FINGERS_DEG, strict=True):
            fingers = [(bent[0], spread, *bent[1:]) for spread in _SPREAD_DEG]
            angles = np.radians([*thumb, *(a for finger in fingers for a in finger), 0.0, 0.0])
            self._drawn.append((angles, self.drawn(pose_with(pose, angles), shape)))

    def drawn(self, pose: HandPose, shape: HandShape) -> SkinnedSamples:
        """Samples of the whole hand, drawn in a pose."""
        mesh = self.model.mesh(pose, shape, EDGE_M)
        with VisibleSurface(
            Scene.from_mesh(mesh), SAMPLES_PER_MM2, 1.0, self.device, self.seed
        ) as surface:
            points_m, normals = surface.points_m, surface.normals
        skin = self.model.skin(mesh, pose, shape, points_m, normals)
        return SkinnedSamples.of(points_m, normals, skin, self.model.bones(pose, shape))

    def of_digit(
        self, digit: str, angles_rad: np.ndarray
    ) -> Iterator[tuple[np.ndarray, SkinnedSamples]]:
        """Rows of `angles_rad`, (n, 23), and the samples that were drawn nearest to them."""
        own = ANGLES_OF_DIGIT[digit]
        away = [((angles_rad - there)[:, own] ** 2).sum(axis=1) for there, _ in self._drawn]
        nearest = np.argmin(away, axis=0)
        for k, (_, samples) in enumerate(self._drawn):
            rows = np.flatnonzero(nearest == k)
            if len(rows):
                yield rows, samples[on_digit(samples, digit)]


def on_digit(samples: SkinnedSamples, digit: str) -> np.ndarray:
    """Mask of the samples that a digit moves more than any other bone does."""
    bones = bones_of_digit(digit)
    first = samples.skin.bone[:, 0]
    return (first >= bones.start) & (first < bones.stop)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Samples in front of a canvas: one entry per sample that faces the radar.

    `picture`, of each entry; points, (n, 3), metres; range beyond the canvas' reference, metres;
    brightness; and the pixel of the depths, all (n,).
    """

    picture: np.ndarray
    points_m: np.ndarray
    range_m: np.ndarray
    brightness: np.ndarray
    pixel: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> Seen:
        return Seen(
            self.picture[rows], self.points_m[rows], self.range_m[rows], self.brightness[rows],
            self.pixel[rows],
        )  # fmt: skip


class LayeredRendering:
    """Renderings of a hand of which some bones take many places, in the antenna frame.

    `rest` are samples of what does not move; `log_brightness` has shape (7,).
    """

    def __init__(
        self, canvas: Canvas, rest: SkinnedSamples, bones: Bones, log_brightness: np.ndarray
    ) -> None:
        self.canvas = canvas
        self.log_brightness = log_brightness + np.log(RENDERED_PER_MM2 / SAMPLES_PER_MM2)
        x_m, y_m = canvas.measured.x_m, canvas.measured.y_m
        self._corner_m = np.array([x_m[0], y_m[0]])
        self._n_x, self._n_y = (
            int((axis_m[-1] - axis_m[0]) / DEPTH_PIXEL_M) + 1 for axis_m in (x_m, y_m)
        )
        seen = self._seen(*(a[None] for a in rest.posed(bones)))
        self._nearest_m = self._nearest(seen, 1)[0]
        self._rest = seen[seen.range_m < self._nearest_m[seen.pixel] + HIDDEN_M]
        self._still = self._splat(self._rest, 1)[0]

    def pictures(self, moving: SkinnedSamples, places: Bones) -> Iterator[Pixels]:
        """Power and range, (k, n_y, n_x) each, a few at a time, with the samples in `places`.

        Their arrays are (n, 25, 3, 3) and (n, 25, 3).
        """
        digit = _Movable.of(moving)
        for first in range(0, len(places.matrix), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            posed = digit.posed(places.matrix[part], places.origin_m[part])
            drawn = self._still + self._moved(posed)
            power, moment = np.moveaxis(self.canvas.convolved(drawn), 1, 0)
            yield self.canvas.mean_range(power, moment)

    def _moved(self, posed: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Pictures of the moving samples, minus what they hide of the rest, before convolution."""
        n, rest = len(posed[0]), self._rest
        digit = self._seen(*posed)
        own_m = self._nearest(digit, n)
        in_front = digit.range_m < HIDDEN_M + np.minimum(
            own_m[digit.picture, digit.pixel], self._nearest_m[digit.pixel]
        )
        digit = digit[in_front]
        behind = rest.range_m > own_m[:, rest.pixel] + HIDDEN_M
        picture, hidden = np.nonzero(behind)
        gone = rest[hidden]
        both = Seen(
            np.concatenate([digit.picture, picture]),
            np.concatenate([digit.points_m, gone.points_m]),
            np.concatenate([digit.range_m, gone.range_m]),
            np.concatenate([digit.brightness, -gone.brightness]),
            np.concatenate([digit.pixel, gone.pixel]),
        )
        return self._splat(both, n)

    def _seen(self, points_m: np.ndarray, normals: np.ndarray) -> Seen:
        """Samples, (k, n, 3), that face some viewpoint of the aperture, with their brightness."""
        aperture = self.canvas.aperture
        towards = normals @ aperture.viewpoints_m.T
        share = (towards > (normals * points_m).sum(axis=-1, keepdims=True)).mean(axis=-1)
        away_m = points_m - aperture.centre_m
        depth_m = np.maximum(away_m[..., 2], 1e-2)
        # As the centre of the aperture sees them, at the scale of the picture.
        scale = self.canvas.reference_m / depth_m
        column = ((away_m[..., 0] * scale + aperture.centre_m[0] - self._corner_m[0])
                  // DEPTH_PIXEL_M)  # fmt: skip
        row = ((away_m[..., 1] * scale + aperture.centre_m[1] - self._corner_m[1])
               // DEPTH_PIXEL_M)  # fmt: skip
        column = np.clip(column, 0, self._n_x - 1).astype(np.intp)
        row = np.clip(row, 0, self._n_y - 1).astype(np.intp)
        pixel = row * self._n_x + column
        picture, kept = np.nonzero(share > 0)
        facing = (picture, kept)
        range_m, angle = self.canvas.sight(points_m[facing], normals[facing])
        bright = share[facing] * np.exp(np.interp(angle, KNOTS_RAD, self.log_brightness))
        return Seen(picture, points_m[facing], range_m, bright, pixel[facing])

    def _nearest(self, seen: Seen, n: int) -> np.ndarray:
        """Range of the nearest sample on the pixels of the depths, (n, n_pixels)."""
        nearest_m = np.full((n, self._n_x * self._n_y), np.inf)
        np.minimum.at(nearest_m, (seen.picture, seen.pixel), seen.range_m)
        return nearest_m

    def _splat(self, seen: Seen, n: int) -> np.ndarray:
        """Power and power times range of `n` pictures, (n, 2, n_y, n_x)."""
        n_y, n_x = self.canvas.measured.power.shape
        inside, corners = self.canvas.corners(seen.points_m)
        first = seen.picture[inside] * (2 * n_y * n_x)
        power, far_m = seen.brightness[inside], seen.range_m[inside]
        drawn = np.zeros(n * 2 * n_y * n_x)
        for pixel, share in corners:
            shared = power * share
            drawn += np.bincount(first + pixel, shared, drawn.size)
            drawn += np.bincount(first + n_y * n_x + pixel, shared * far_m, drawn.size)
        return drawn.reshape(n, 2, n_y, n_x)


@dataclass(frozen=True, slots=True, eq=False)
class _Movable:
    """Samples as two matrices, so that one product poses them in many places.

    `points`, (n, 4 b), and `normals`, (n, 3 b): weighted coordinates in each of b `bones`.
    """

    bones: np.ndarray
    points: np.ndarray
    normals: np.ndarray

    @classmethod
    def of(cls, samples: SkinnedSamples) -> _Movable:
        bone, weight = samples.skin.bone, samples.skin.weight
        bones = np.unique(bone[weight > 0])
        points = np.zeros((len(samples), len(bones), 4))
        normals = np.zeros((len(samples), len(bones), 3))
        for k in range(bone.shape[1]):
            rows = np.flatnonzero(weight[:, k] > 0)
            at, share = np.searchsorted(bones, bone[rows, k]), weight[rows, k, None]
            points[rows, at, :3] += share * samples.own[rows, k]
            points[rows, at, 3:] += share
            normals[rows, at] += share * samples.own_normal[rows, k]
        n = len(samples)
        return cls(bones, points.reshape(n, -1), normals.reshape(n, -1))

    def posed(self, matrix: np.ndarray, origin_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and unit normals, (k, n, 3), for bones (k, 25, 3, 3) and (k, 25, 3)."""
        turn = matrix[:, self.bones]
        inverse = np.linalg.inv(turn)
        maps = np.concatenate([np.swapaxes(turn, 2, 3), origin_m[:, self.bones, None]], axis=2)
        k = len(matrix)
        points_m = self.points @ maps.reshape(k, -1, 3)
        normals = self.normals @ inverse.reshape(k, -1, 3)
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        return points_m, normals / np.maximum(length, 1e-12)
