"""Rendering of a hand in any state, and its derivatives by angles, shape, place and brightness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.hand_fit.bone_rates import SAME_DIGIT, bone_rates
from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_shape_vector import N_SHAPE, shape_of, vector_of
from calibration.hand_fit.hand_state import N_ANGLES, HandState
from calibration.hand_fit.picture_rates import drawn_rates
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
from clradar.hand import HandMesh
from clradar.model import Scene
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface

EDGE_M = 3e-3
"""Of the triangles of a surface that is rendered: 13 000 faces, curved between their corners."""

SAMPLES_PER_MM2 = 0.7
"""Of the finest pictures, and what the brightness of a sample is for; others may have fewer."""

RIGID, ANGLES = slice(0, 6), slice(6, 6 + N_ANGLES)
SHAPE = slice(ANGLES.stop, ANGLES.stop + N_SHAPE)
"""Where the motion, the angles and the shape are among the parameters; brightness follows."""

N_GEOMETRY = SHAPE.stop
N_PARAMETERS = N_GEOMETRY + len(KNOTS_RAD)

_GROUPS = (
    np.r_[RIGID, SHAPE],
    *(ANGLES.start + angles for angles in SAME_DIGIT),
)
"""Parameters that move about the same samples."""


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
    """Renderings of a hand on the pixels of a measured image, blurred as those of `Canvas`.

    The samples are those of a surface that `draw_surface` meshes in some state; near it they move
    with their bones, and what is visible stays so.
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
        mesh, points_m, normals, self._share = self._visible(state, seed)
        skin = self.model.skin(mesh, state.pose, state.shape, points_m, normals)
        bones = self.model.bones(state.pose, state.shape)
        self._samples = SkinnedSamples.of(points_m, normals, skin, bones)

    def meshed_anew(self, state: HandState, log_brightness: np.ndarray, seed: int) -> Pixels:
        """As `render`, of a surface that is meshed in this very state, and not kept."""
        _, points_m, normals, share = self._visible(state, seed)
        turned = normals @ state.transform[:3, :3].T
        return self._rendered(moved(state.transform, points_m), turned, share, log_brightness)

    def _visible(
        self, state: HandState, seed: int
    ) -> tuple[HandMesh, np.ndarray, np.ndarray, np.ndarray]:
        """A mesh in a state, and those samples that are visible, in the frame of the hand: points,
        normals, and in what share of the viewpoints each is seen."""
        mesh = self.model.mesh(state.pose, state.shape, EDGE_M)
        scene = Scene.from_mesh(mesh)
        viewpoints_m = moved(np.linalg.inv(state.transform), self.aperture.viewpoints_m)
        reach_m = 2.0 * float(np.linalg.norm(viewpoints_m, axis=1).max())
        with VisibleSurface(scene, self.samples_per_mm2, reach_m, self.device, seed) as surface:
            share = surface.visible_from(viewpoints_m).mean(axis=1)
            seen = np.flatnonzero(share > 0)
            points_m, normals = surface.points_m[seen], surface.normals[seen]
        return mesh, points_m, normals, share[seen] * (SAMPLES_PER_MM2 / self.samples_per_mm2)

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
        return self._rendered(points_m, normals, self._share, log_brightness)

    def _rendered(
        self,
        points_m: np.ndarray,
        normals: np.ndarray,
        share: np.ndarray,
        log_brightness: np.ndarray,
    ) -> Pixels:
        range_m, angle = self.sight(points_m, normals)
        bright = share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
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
        rates = bone_rates(self.model, state, bones, centre_m)
        seen = np.zeros((N_PARAMETERS, 2, *self.measured.power.shape))
        for group in _GROUPS:
            own = group[wanted[group]]
            if not own.size:
                continue
            rows = np.flatnonzero(self.samples.on_any(rates[own].moving))
            moving = self.samples.velocities(bones, rates[own], rows)
            seen[own] = self.convolved(
                drawn_rates(
                    self, points_m[rows], normals[rows], moving, self._share[rows], log_brightness
                )
            )
        knots = wanted[N_GEOMETRY:]
        if knots.any():
            range_m, angle = self.sight(points_m, normals)
            bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
            drawn = self.splat(points_m, range_m, bright * knot_weights(angle)[knots])
            seen[N_GEOMETRY:][knots] = self.convolved(drawn)
        d_power, d_moment = np.moveaxis(seen[wanted], 1, 0)
        power, mean_range_m = rendered
        d_range = (d_moment - (mean_range_m - self.reference_m) * d_power) / power
        return d_power.reshape(len(d_power), -1), d_range.reshape(len(d_power), -1)
