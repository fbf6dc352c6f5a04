"""Coarse faces of curved surfaces: how far the flat face is from the surface that it stands for."""

from __future__ import annotations

import math

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.geometry.normals import corner_normals
from clradar.model import Scene
from clradar.tracing.settings import SimulationSettings

PHASE_LIMIT = 0.25
"""Two-way phase error of a face in wavelengths from which it is coarse: 2 sagitta / wavelength.

Balls of 20 to 80 mm against finer ones, at alpha = 0: an error of 0.14 changes the maximum of the
image by 0.3 dB and leaves an overlap of 0.99, one of 0.28 changes it by 1.5 dB (0.96), one of 0.55
by 2 to 4 dB (0.86 to 0.91), and one of 1.0 leaves 0.78. A quarter of a wavelength is Rayleigh's
limit.
"""

LEAST_SHARE = 0.05
"""Part of the area that has to be coarse: fingertips alone are not warned of."""


def warn_of_coarse_facets(
    function: str, scene: Scene, settings: SimulationSettings, frequency_hz: float
) -> None:
    """Warn if a surface that is shaded as curved has faces too coarse for its wavelength.

    Parameters
    ----------
    function : str
        Named in the warning.
    scene : Scene
    settings : SimulationSettings
    frequency_hz : float, hertz
        The highest.

    Warns
    -----
    ClradarWarning
        More than 5 % of the area belongs to faces whose sagitta is above an eighth of the
        wavelength, so that the two-way phase is off by more than a quarter of it.

    Notes
    -----
    Rays are reflected about the interpolated normal n, but start at the flat face. An edge vector e
    between two corners is the chord of an arc of radius R = e^2 / |(n_1 - n_0) . e|, and the arc's
    sagitta is e^2 / (8 R) = |(n_1 - n_0) . e| / 8: 0 where the normals are those of a flat side.
    """
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / frequency_hz
    limit_m = PHASE_LIMIT * wavelength_m / 2.0
    edges = _edges(scene.triangles_m)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    least = LEAST_SHARE * area.sum()
    # Normals differ by 2 at most, so short edges are no chord of that: fine meshes cost nothing.
    long = np.linalg.norm(edges, axis=2).max(axis=1) > 4.0 * limit_m
    if settings.normals == "face" or area[long].sum() <= least:
        return
    corners, _ = corner_normals(scene, settings.normals, settings.crease_deg)
    sagitta_m = facet_sagitta_m(scene.triangles_m, corners)
    coarse = sagitta_m > limit_m
    if area[coarse].sum() <= least:
        return
    worst_m = float(sagitta_m.max())
    share = area[coarse].sum() / area.sum()
    # A sagitta falls with the square of the edge. The tenth above that is left for tips and folds.
    finer = math.sqrt(float(np.quantile(sagitta_m[coarse], 0.9)) / limit_m)
    warn(
        f"{function}: {100 * share:.0f} % of the surface are faces too coarse for the curve that "
        f"they stand for: up to {1e3 * worst_m:.2f} mm off it, a two-way phase of "
        f"{2 * worst_m / wavelength_m:.2f} wavelengths at {frequency_hz / 1e9:g} GHz, where "
        f"{PHASE_LIMIT:g} blur glints; take a mesh of the same smooth surface with edges about "
        f"{max(finer, 1.1):.1f} times shorter, or normals='face' if the faces are meant to be flat"
    )


def facet_sagitta_m(triangles_m: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return how far each face is from the curve that its normals describe, metres.

    Parameters
    ----------
    triangles_m : ndarray, shape (n_faces, 3, 3), metres
    corners : ndarray, shape (n_faces, 3, 3)
        Unit normals at the corners.

    Returns
    -------
    ndarray, shape (n_faces,)
        The largest sagitta of the three edges.
    """
    edges = _edges(triangles_m)
    turn = np.roll(corners, -1, axis=1) - corners
    return np.asarray(np.abs(np.einsum("fka,fka->fk", turn, edges)).max(axis=1) / 8.0)


def _edges(triangles_m: np.ndarray) -> np.ndarray:
    return np.roll(triangles_m, -1, axis=1) - triangles_m
