"""Which reception radius, density and estimator suit the range of a scene."""

from __future__ import annotations

import numpy as np

from clradar.constants import PLAUSIBLE_RADIUS_M
from clradar.model import AntennaArray, Scene, Waveform
from clradar.tracing.placement import bounding_box_m

RECEPTION_RADIUS_M = 0.010  # at `RADIUS_RANGE_M` and `RADIUS_HZ`
RADIUS_RANGE_M, RADIUS_HZ = 0.3, 77e9
"""Where the phase error of the default radius was measured; it goes with f radius^2 / range
(E4 in ``docs/equations.md``)."""

EXPECTED_ALPHA = 0.12
"""From here on the default of the expected estimator has less noise than the stochastic one, which
has ten times the samples. Image error of the default hand at alpha = 0.05, 0.1, 0.15: -15.7, -21.5,
-24.8 dB, and stochastic -24.6, -23.9, -22.2 dB, against 6 samples per mm^2 and another seed."""

MOST_PATHS = 2e10
"""Samples times pairs of the expected estimator's default, some four minutes of two cores."""


def range_m(scene: Scene, array: AntennaArray) -> float:
    """Distance of the middle of a scene from the middle of the antennas."""
    antennas_m = np.concatenate([array.tx_m, array.rx_m]).mean(axis=0)
    return float(np.linalg.norm(bounding_box_m(scene).mean(axis=0) - antennas_m))


def same_phase_radius_m(distance_m: float, frequency_hz: float = RADIUS_HZ) -> float:
    """The radius with the phase error that the default has at `RADIUS_RANGE_M`."""
    longer = distance_m / RADIUS_RANGE_M * RADIUS_HZ / frequency_hz
    return float(RECEPTION_RADIUS_M * np.sqrt(longer))


def suited_radius_m(scene: Scene, array: AntennaArray, waveform: Waveform) -> float:
    """The default radius times the power of two that is nearest to `same_phase_radius_m`.

    In steps, so that it does not follow every movement of a scene: samples go with its square.
    """
    radius_m = same_phase_radius_m(max(range_m(scene, array), 1e-3), waveform.center_hz)
    steps = np.round(np.log2(radius_m / RECEPTION_RADIUS_M))
    return float(np.clip(RECEPTION_RADIUS_M * 2.0**steps, *PLAUSIBLE_RADIUS_M))


def least_expected_alpha(scene: Scene, array: AntennaArray, radius_m: float) -> float:
    """From which alpha on the expected estimator is chosen.

    A random ray enters a sphere with the probability (radius / alpha range)^2, which decides
    between the estimators: where it is that of `EXPECTED_ALPHA` at `RADIUS_RANGE_M`.
    """
    if radius_m == RECEPTION_RADIUS_M:
        return EXPECTED_ALPHA
    lobe = EXPECTED_ALPHA * RADIUS_RANGE_M / RECEPTION_RADIUS_M
    return lobe * radius_m / max(range_m(scene, array), 1e-3)


def affordable_rays(scene: Scene, array: AntennaArray, per_mm2: float, rays: int) -> int:
    """Rays per sample, more where samples have to be fewer: at most `MOST_PATHS` of them all."""
    corners_m = scene.vertices_m[scene.faces]
    areas_m2 = np.linalg.norm(
        np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]), axis=1
    )
    paths = per_mm2 * 5e5 * float(areas_m2.sum()) * array.n_tx * array.n_rx
    return int(min(np.ceil(rays * max(1.0, paths / MOST_PATHS)), 2**16))
