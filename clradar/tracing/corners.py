"""Warning of parts of a scene that face each other, for the estimator of one reflection."""

from __future__ import annotations

import numpy as np

from clradar.constants import PLAUSIBLE_RADIUS_M
from clradar.errors import warn
from clradar.model import AntennaArray, Scene
from clradar.opencl import Device
from clradar.tracing.placement import bounding_box_m
from clradar.tracing.settings import SimulationSettings
from clradar.tracing.stochastic import Tracer

SAMPLES, RADIUS_M = 4000, 0.05
"""Of the whole surface; and the least radius about the middle of the antennas that is "back"."""

BACK_SHARE = 0.1
"""Paths back by several mirror reflections over samples in sight: 1.4 to 5 of corner reflectors,
with the bounces of each counted; up to 0.05 of hands, less of balls and of a ball on a table."""


def warn_of_corners(
    scene: Scene, array: AntennaArray, settings: SimulationSettings, device: Device
) -> None:
    """Warn where mirror reflections off two or three parts lead back to the antennas."""
    edges = np.diff(scene.triangles_m, axis=1)
    area_mm2 = 5e5 * float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())
    antennas_m = np.concatenate([array.tx_m, array.rx_m])
    if not area_mm2 > 0 or bounding_box_m(scene)[0, 2] <= antennas_m[:, 2].max():
        return  # antennas around a scene have no side that is "back"
    middle_m = (antennas_m.min(axis=0) + antennas_m.max(axis=0))[None] / 2
    radius_m = max(RADIUS_M, float(np.ptp(antennas_m, axis=0).max()) / 2)
    mirrored = SimulationSettings(
        samples_per_mm2=SAMPLES / area_mm2, rays_per_sample=1, max_bounces=3,
        reception_radius_m=min(radius_m, PLAUSIBLE_RADIUS_M[1]), normals=settings.normals,
        crease_deg=settings.crease_deg, facets=settings.facets, estimator="stochastic",
    ).resolved()  # fmt: skip
    several = visible = 0
    one = AntennaArray(middle_m, middle_m)
    with Tracer(scene.with_alpha(0.0), one, mirrored, device) as tracer:
        for tile in tracer.tiles():
            several += int((tracer.read(tile).bounces > 1).sum())
            visible += tile.statistics.visible
    if several > BACK_SHARE * visible:
        warn(
            "simulate: lit parts of the scene face each other and send echoes back after two or "
            "three reflections, of which estimator='physical' has the first only: a corner "
            "reflector reads some 30 dB too low"
        )
