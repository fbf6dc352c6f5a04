"""Simulation of S-parameters by physical optics: lit points of a quadrature, and their sum.

E12 in ``docs/equations.md``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.model import AntennaArray, Scene, TraceStatistics, Waveform
from clradar.model.kirchhoff import check_kirchhoff
from clradar.model.material import Material
from clradar.model.material_file import material_record
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.phasors.kirchhoff_sum import TOLERANCE_DB, KirchhoffSum
from clradar.tracing.corners import warn_of_corners
from clradar.tracing.quadrature import LitPoints, LitQuadrature
from clradar.tracing.settings import SimulationSettings, simulated_meta

WIDEST_WAVELENGTHS, WIDEST_CORRELATION = 0.25, 0.5
"""Widest spacing of points, in wavelengths and correlation lengths. At a quarter of a wavelength
the image of a smooth hand is off by -22 dB, at an eighth by -40 dB."""


def physical_samples(
    scene: Scene,
    array: AntennaArray,
    waveform: Waveform,
    settings: SimulationSettings,
    device: Device,
    progress: Progress | None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the samples of a capture, shape (n_tx, n_rx, n_freq), complex64, and its `meta`.

    Arguments, errors and warnings are those of `clradar.simulate`; `settings` are resolved.
    """
    used = [scene.materials[i] for i in np.unique(scene.material)]
    for material in used:
        check_kirchhoff(material, waveform)
    _warn_of_sparse_points(used, waveform, settings)
    warn_of_corners(scene, array, settings, device)
    data = np.zeros((array.n_tx, array.n_rx, waveform.n_freq), np.complex64)
    n_lit, n_seen, n_paths, counts = 0, 0, 0, dict[str, int]()
    with LitQuadrature(scene, array, settings, device) as quadrature:
        args = (array, waveform, scene.materials, quadrature.middle_m, settings.seed, device)
        for lit in quadrature.lit_parts(progress):
            if len(lit.sample) == 0:
                continue
            with KirchhoffSum(*args) as total:
                data += total.result(lit)
            counts = _joined(counts, total.counts)
            seen, paths = _sightings(lit)
            n_lit, n_seen, n_paths = n_lit + len(lit.sample), n_seen + seen, n_paths + paths
        n_points = quadrature.n_points
    if n_paths == 0:
        warn(
            "no Tx and Rx see a common point of the scene: the capture is zero everywhere; is the "
            "scene in front of the antennas?"
        )
    statistics = TraceStatistics(n_points, n_seen, 0, 0)
    meta = simulated_meta(scene, settings, statistics, n_paths, device)
    meta["scene"]["materials"] = [material_record(material) for material in used]
    meta["kirchhoff"] = {"lit": n_lit, **counts, "tolerance_db": TOLERANCE_DB}
    return data, meta


def _joined(counts: dict[str, int], more: dict[str, int]) -> dict[str, int]:
    """Counts of two parts: of cubes and points their sums, of skeletons the larger."""
    return {
        name: (max if name.startswith("skeleton") else sum)(
            (counts.get(name, 0), more.get(name, 0))
        )
        for name in {**counts, **more}
    }


def _sightings(lit: LitPoints) -> tuple[int, int]:
    """Pairs of a Tx and a point that it sees, and of these with every Rx that sees the point."""
    tx, rx = (np.unpackbits(bits, axis=1).sum(axis=1, dtype=np.int64) for bits in (lit.tx, lit.rx))
    return int(tx.sum()), int((tx * rx).sum())


def _warn_of_sparse_points(
    materials: list[Material], waveform: Waveform, settings: SimulationSettings
) -> None:
    """Warn of a spacing that is too wide for the wavelength or a correlation length."""
    assert settings.samples_per_mm2 is not None, "settings are resolved"
    spacing_m = 1e-3 / np.sqrt(settings.samples_per_mm2)
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / float(waveform.frequencies_hz[-1])
    limits = {f"a wavelength of {1e3 * wavelength_m:.2f} mm": WIDEST_WAVELENGTHS * wavelength_m}
    for material in materials:
        length_m = material.correlation_length_m
        if material.roughness_rms_m > 0 and length_m is not None:
            text = f"{material.name!r} with a correlation length of {1e3 * length_m:g} mm"
            limits[text] = WIDEST_CORRELATION * length_m
    text, limit_m = min(limits.items(), key=lambda item: item[1])
    if spacing_m > limit_m * (1 + 1e-9):
        warn(
            f"simulate: {settings.samples_per_mm2:g} samples per square millimetre are "
            f"{1e3 * spacing_m:.2g} mm apart, too far for {text}: the result depends on where they "
            f"lie; take at least {1e-6 / limit_m**2:.2g}"
        )
