"""Coarse faces of curved surfaces: how far paths end from the surface that the faces stand for."""

from __future__ import annotations

import math

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.geometry.curved import corner_heights
from clradar.geometry.normals import corner_normals
from clradar.model import Scene
from clradar.tracing.settings import SimulationSettings

PHASE_LIMIT = 0.25
"""Two-way phase error of a face in wavelengths from which it is coarse.

Balls of 20 to 320 mm against finer ones, at alpha = 0. Flat facets, whose error is 2 sagitta /
wavelength: an error of 0.14 changes the maximum of the image by 0.3 dB and leaves an overlap of
0.99, one of 0.28 changes it by 1.5 dB (0.96), one of 0.55 by 2 to 4 dB (0.86 to 0.91), and one of
1.0 leaves 0.78. What curved ones leave: 0.03 changes it by 0.3 dB (0.998), 0.06 by 0.4 dB (0.994),
0.12 by 1.4 dB (0.98), 0.24 leaves 0.974 and 0.47 0.95. A quarter of a wavelength is Rayleigh's
limit.
"""

LEAST_SHARE = 0.05  # part of the area that has to be coarse: fingertips alone are not warned of
ROUND_DEG = 70.0
"""Faces of a coarse mesh of a round body, a finger of six sides, meet at less; a box's at 90."""

SHORT_EDGES = {"flat": 4.0, "curved": 12.0}
"""Faces whose edges are shorter than this many times the error that is allowed are not looked at.
Normals differ by 2 at most, so the sagitta is less than a quarter of the edge; and curved faces are
off by a twelfth of it if normals are tilted by 30 degrees against the edge."""


def warn_of_coarse_facets(
    function: str, scene: Scene, settings: SimulationSettings, frequency_hz: float
) -> None:
    """Warn if a surface that is shaded as curved has faces too coarse for its highest frequency.

    That is: more than 5 % of the area belongs to faces where paths end more than an eighth of the
    wavelength off the surface, so that the two-way phase is off by more than a quarter of it; or
    they would be, flat, had their edges of less than 70 degrees not stayed sharp. With
    ``facets="flat"`` that is the sagitta of the arc that the normals describe, and with
    ``facets="curved"`` what is left of it: see `facet_sagitta_m` and `curved_error_m`.
    """
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / frequency_hz
    limit_m = PHASE_LIMIT * wavelength_m / 2.0
    edges = _edges(scene.triangles_m)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    least = LEAST_SHARE * area.sum()
    if settings.normals == "smooth" and scene.normals is None:
        facets = _faceted(scene, settings.crease_deg, limit_m, area)
        if facets > LEAST_SHARE:
            warn(
                f"{function}: {100 * facets:.0f} % of the surface are large faces with edges of "
                f"less than {ROUND_DEG:g} degrees that stay sharp, beyond crease_deg="
                f"{settings.crease_deg:g}, and are imaged as facets; of a smooth surface take "
                "crease_deg=180 or a finer mesh, of a body with such edges normals='face'"
            )
            return
    long = np.linalg.norm(edges, axis=2).max(axis=1) > SHORT_EDGES[settings.facets] * limit_m
    if settings.normals == "face" or area[long].sum() <= least:
        return
    corners, _ = corner_normals(scene, settings.normals, settings.crease_deg)
    flat = settings.facets == "flat"
    off_m = (facet_sagitta_m if flat else curved_error_m)(scene.triangles_m, corners)
    coarse = off_m > limit_m
    if area[coarse].sum() <= least:
        return
    worst_m = float(off_m.max())
    share = area[coarse].sum() / area.sum()
    # A sagitta falls with the square of the edge, the rest of it with the third power at least. The
    # tenth above that is left for tips and folds.
    excess = float(np.quantile(off_m[coarse], 0.9)) / limit_m
    finer = excess ** (1 / 2 if flat else 1 / 3)
    warn(
        f"{function}: {100 * share:.0f} % of the surface are faces too coarse for the curve that "
        f"they stand for: up to {1e3 * worst_m:.2f} mm off it, a two-way phase of "
        f"{2 * worst_m / wavelength_m:.2f} wavelengths at {frequency_hz / 1e9:g} GHz, where "
        f"{PHASE_LIMIT:g} blur glints; take a mesh of the same smooth surface with edges about "
        f"{max(finer, 1.1):.1f} times shorter, or normals='face' if the faces are meant to be flat"
    )


def _faceted(scene: Scene, crease_deg: float, limit_m: float, area: np.ndarray) -> float:
    """Share of the area of which edges between coarse faces are taken for those of the body."""
    longest_m = np.linalg.norm(_edges(scene.triangles_m), axis=2).max(axis=1)
    long = longest_m > SHORT_EDGES["flat"] * limit_m
    if crease_deg >= ROUND_DEG or area[long].sum() <= LEAST_SHARE * area.sum():
        return 0.0
    corners, rounded = (corner_normals(scene, "smooth", d)[0] for d in (crease_deg, ROUND_DEG))
    kept = np.abs(corners - rounded).max(axis=(1, 2)) > 1e-6
    coarse = facet_sagitta_m(scene.triangles_m, rounded) > limit_m
    return float(area[kept & coarse].sum() / area.sum())


def facet_sagitta_m(triangles_m: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return how far each face is from the curve that its normals describe, metres, (n_faces,).

    The largest sagitta of the three edges, of faces and unit normals at the corners, (n_faces, 3,
    3). An edge vector e between two corners is the chord of an arc of radius R = e^2 / |(n_1 - n_0)
    . e|, and the arc's sagitta is e^2 / (8 R) = |(n_1 - n_0) . e| / 8: 0 where the normals are
    those of a flat side.
    """
    edges = _edges(triangles_m)
    turn = np.roll(corners, -1, axis=1) - corners
    return np.asarray(np.abs(np.einsum("fka,fka->fk", turn, edges)).max(axis=1) / 8.0)


def curved_error_m(triangles_m: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return how far curved points of each face are off the smooth surface, metres, (n_faces,).

    The largest estimate for the three edges, of faces and unit normals at the corners, (n_faces, 3,
    3). The curved points are of second order. An arc whose tangents have the angle t to its chord e
    keeps 3 e sin(t)^3 / 16 of its sagitta, to lowest order. An edge whose ends are bent to either
    side, with heights h_0 and h_1 of each end above the tangent at the other, is nearly straight
    for them, where the cubic that has these tangents is up to |h_0 - h_1| sqrt(3) / 36 off. Normals
    that were estimated on irregular meshes leave more: a sixth of the sagitta on balls of random
    vertices.
    """
    heights = corner_heights(triangles_m, corners)
    ahead, back = heights[:, :, 0], np.roll(heights[:, :, 1], -1, axis=1)
    square = np.maximum((_edges(triangles_m) ** 2).sum(axis=2), np.finfo(float).tiny)
    arc = 3.0 / 16.0 * np.maximum(np.abs(ahead), np.abs(back)) ** 3 / square
    bent = math.sqrt(3.0) / 36.0 * np.abs(ahead - back)
    return np.asarray((arc + bent).max(axis=1))


def _edges(triangles_m: np.ndarray) -> np.ndarray:
    return np.roll(triangles_m, -1, axis=1) - triangles_m
