"""Rendering of a hand in any state, and its derivatives by angles, shape, place and brightness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_shape_vector import N_SHAPE, shape_of, vector_of
from calibration.hand_fit.hand_state import N_ANGLES, HandState
from calibration.hand_fit.range_scatter import range_scatter_m
from calibration.hand_fit.skinned import Bones, SkinnedSamples
from calibration.registration.mesh_rendering import (
    KNOTS_RAD,
    Aperture,
    Canvas,
    MeasuredImage,
    Pixels,
    knot_weights,
)
from calibration.registration.rigid_motion import exp_twist, moved, orthonormal
from clradar.model import Scene
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

EDGE_M = 3e-3
"""Of the triangles of a surface that is rendered: 13 000 faces, curved between their corners."""

SAMPLES_PER_MM2 = 0.7
"""Of the finest pictures, and what the brightness of a sample is for; others may have fewer."""

_ROTATION_STEP_RAD, _SHIFT_STEP_M = 2e-3, 1e-4
_ANGLE_STEP_RAD, _SHAPE_STEP = 3e-3, 2e-3
_STEPS = np.concatenate(
    [[_ROTATION_STEP_RAD] * 3, [_SHIFT_STEP_M] * 3, [_ANGLE_STEP_RAD] * N_ANGLES,
     [_SHAPE_STEP] * N_SHAPE]
)  # fmt: skip
"""Of the numerical derivatives: they move a fingertip by some tenths of a millimetre."""

RIGID, ANGLES, SHAPE = slice(0, 6), slice(6, 6 + N_ANGLES), slice(6 + N_ANGLES, len(_STEPS))
"""Where the motion, the angles and the shape are among the parameters; brightness follows."""

N_GEOMETRY = len(_STEPS)
N_PARAMETERS = N_GEOMETRY + len(KNOTS_RAD)


def stepped(state: HandState, step: np.ndarray, centre_m: np.ndarray) -> HandState:
    """A hand after a step of the geometry's parameters, (37,), about a centre (3,)."""
    changed = state
    if step[ANGLES].any():
        changed = changed.with_angles(changed.angles_rad + step[ANGLES])
    if step[SHAPE].any():
        changed = replace(changed, shape=shape_of(vector_of(changed.shape) + step[SHAPE]))
    if step[RIGID].any():
        motion = exp_twist(step[RIGID], centre_m) @ changed.transform
        changed = replace(changed, transform=orthonormal(motion))
    return changed


class HandRendering(Canvas):
    """Renderings of a hand on the pixels of a measured image.

    The samples are those of a surface that `draw_surface` meshes in some state; near it they move
    with their bones, and what is visible stays so.

    Parameters
    ----------
    model : HandModel
    measured : MeasuredImage
    aperture : Aperture
    device : Device
    blur_m : float, metres
        As of `Canvas`.
    samples_per_mm2 : float, 1/mm^2
    """

    def __init__(
        self,
        model: HandModel,
        measured: MeasuredImage,
        aperture: Aperture,
        device: Device,
        blur_m: float = 0.0,
        samples_per_mm2: float = SAMPLES_PER_MM2,
    ) -> None:
        super().__init__(measured, aperture, blur_m)
        self.model, self.device = model, device
        self.samples_per_mm2 = samples_per_mm2
        self.range_std_m = range_scatter_m(measured)
        self._samples: SkinnedSamples | None = None
        self._share = np.zeros(0)

    def draw_surface(self, state: HandState, seed: int = 0) -> None:
        """Mesh the hand in a state, draw samples and find those that the aperture sees."""
        mesh = self.model.mesh(state.pose, state.shape, EDGE_M)
        scene = Scene.from_mesh(mesh)
        back = np.linalg.inv(state.transform)
        viewpoints_m = self.aperture.viewpoints_m @ back[:3, :3].T + back[:3, 3]
        reach_m = 2.0 * float(np.linalg.norm(viewpoints_m, axis=1).max())
        with VisibleSurface(scene, self.samples_per_mm2, reach_m, self.device, seed) as surface:
            share = surface.visible_from(viewpoints_m).mean(axis=1)
            seen = np.flatnonzero(share > 0)
            points_m, normals = surface.points_m[seen], surface.normals[seen]
        skin = self.model.skin(mesh, state.pose, state.shape, points_m, normals)
        bones = self.model.bones(state.pose, state.shape)
        self._samples = SkinnedSamples.of(points_m, normals, skin, bones)
        self._share = share[seen] * (SAMPLES_PER_MM2 / self.samples_per_mm2)

    @property
    def samples(self) -> SkinnedSamples:
        """Those that are visible, of the last `draw_surface`."""
        assert self._samples is not None, "draw_surface comes first"
        return self._samples

    def bones_at(self, state: HandState) -> Bones:
        """The bones in the antenna frame."""
        return self.model.bones(state.pose, state.shape).moved(state.transform)

    def render(self, state: HandState, log_brightness: np.ndarray) -> Pixels:
        """Power and mean range of every pixel, both (n_y, n_x); range is in metres."""
        points_m, normals = self.samples.posed(self.bones_at(state))
        range_m, angle = self.sight(points_m, normals)
        bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
        return self.mean_range(*self.convolved(self.splat(points_m, range_m, bright[None])[0]))

    def derivatives(
        self,
        state: HandState,
        log_brightness: np.ndarray,
        centre_m: np.ndarray,
        wanted: np.ndarray,
        rendered: Pixels,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of power and range by the `wanted` parameters, a mask (44,): (n, n_pixels).

        `rendered` is the rendering of the state, and twists are about `centre_m`.
        """
        bones = self.bones_at(state)
        points_m, normals = self.samples.posed(bones)
        range_m, angle = self.sight(points_m, normals)
        bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
        n = int(wanted.sum())
        drawn = np.zeros((n, 2, *self.measured.power.shape))
        for row, k in enumerate(np.flatnonzero(wanted[:N_GEOMETRY])):
            step = np.where(np.arange(N_GEOMETRY) == k, _STEPS, 0.0)
            if k < RIGID.stop:
                moving = np.arange(len(points_m))
                motion = exp_twist(step[RIGID], centre_m)
                there_m, turned = moved(motion, points_m), normals @ motion[:3, :3].T
            else:
                ahead = self.bones_at(stepped(state, step, centre_m))
                if not _elsewhere(bones, ahead).any():  # at its limit
                    step = -step
                    ahead = self.bones_at(stepped(state, step, centre_m))
                moving = np.flatnonzero(self.samples.on_any(_elsewhere(bones, ahead)))
                there_m, turned = self.samples[moving].posed(ahead)
            far_m, tilted = self.sight(there_m, turned)
            brightened = self._share[moving] * np.exp(np.interp(tilted, KNOTS_RAD, log_brightness))
            drawn[row] = self.splat(
                np.concatenate([there_m, points_m[moving]]),
                np.concatenate([far_m, range_m[moving]]),
                np.concatenate([brightened, -bright[moving]])[None] / step[k],
            )[0]
        knots = wanted[N_GEOMETRY:]
        if knots.any():
            drawn[n - int(knots.sum()) :] = self.splat(
                points_m, range_m, bright * knot_weights(angle)[knots]
            )
        d_power, d_moment = np.moveaxis(self.convolved(drawn), 1, 0)
        power, mean_range_m = rendered
        d_range = (d_moment - (mean_range_m - self.reference_m) * d_power) / power
        return d_power.reshape(n, -1), d_range.reshape(n, -1)


def _elsewhere(bones: Bones, ahead: Bones) -> np.ndarray:
    """Mask (25,) of the bones that are not where they were."""
    turned = (bones.matrix != ahead.matrix).any(axis=(1, 2))
    found: np.ndarray = turned | (bones.origin_m != ahead.origin_m).any(axis=1)
    return found
