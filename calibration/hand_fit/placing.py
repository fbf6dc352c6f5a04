"""Rigid search for the place of a posed hand."""

from __future__ import annotations

import numpy as np

from calibration.hand_fit.hand_model import HandModel
from calibration.hand_fit.hand_rendering import EDGE_M
from calibration.hand_fit.hand_state import HandState
from calibration.registration.mesh_fit import MeshFit
from calibration.registration.mesh_rendering import Aperture, MeasuredImage
from calibration.registration.mesh_search import (
    COARSE_SAMPLES_PER_MM2,
    COARSE_STEP_M,
    TRIED,
    search,
)
from clradar.hand import HandPose, HandShape
from clradar.model import DepthMap, Scene
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.tracing.visible_surface import VisibleSurface


def placed(
    model: HandModel,
    pose: HandPose,
    shape: HandShape,
    depth: DepthMap,
    aperture: Aperture,
    search_deg: float,
    device: Device,
    progress: Progress | None = None,
    tried: int = TRIED,
) -> list[tuple[HandState, MeshFit]]:
    """Places of a hand in a pose on a measured image, the best first, and their coarse fits."""
    scene = Scene.from_mesh(model.mesh(pose, shape, EDGE_M))
    coarse = MeasuredImage.of(depth, COARSE_STEP_M, aperture.centre_m)
    reach_m = 2.0 + 2.0 * float(np.linalg.norm(scene.vertices_m, axis=1).max())
    with VisibleSurface(scene, COARSE_SAMPLES_PER_MM2, reach_m, device) as surface:
        fits = search(surface, coarse, aperture, search_deg, progress, tried)
    return [(HandState(pose, shape, fit.transform), fit) for fit in fits]
