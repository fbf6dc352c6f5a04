"""Options of a simulation: rays, and the position of meshes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clradar.cli.options.common import Amplitude, UnitOptions
from clradar.cli.options.groups import option, recorded
from clradar.cli.options.values import check_unit
from clradar.constants import PLAUSIBLE_RADIUS_M
from clradar.geometry.normals import CREASE_DEG
from clradar.tracing.settings import (
    EXPECTED_SAMPLES_PER_MM2,
    RAYS_PER_SAMPLE,
    SAMPLES_PER_MM2,
    SimulationSettings,
)
from clradar.tracing.suited import RECEPTION_RADIUS_M

Estimator = Literal["stochastic", "expected", "physical"]

ESTIMATORS = (
    "stochastic: random outgoing rays, as in the paper; expected: their mean, without shot noise, "
    f"from {EXPECTED_SAMPLES_PER_MM2:g} sample per square millimetre; physical: S-parameters of "
    "the materials by the Kirchhoff sum, without alpha."
)


@dataclass(frozen=True, kw_only=True)
class SamplingOptions:
    """How densely rays are launched."""

    samples_per_mm2: float | None = option(
        None,
        f"Surface samples per square millimetre. [default: {SAMPLES_PER_MM2:g} if stochastic]",
        metavar="N",
    )
    rays_per_sample: int | None = option(
        None,
        f"Rays per sample and Tx. [default: {RAYS_PER_SAMPLE}; 1 if samples are given per face]",
        metavar="N",
    )


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(SamplingOptions):
    """How rays are launched, reflected and received."""

    rays_per_face: int | None = option(
        None, "Samples on every face, instead of a density.", metavar="N"
    )
    reception_radius_mm: float | None = option(
        None,
        f"A ray this near to an Rx is received. [default: {1e3 * RECEPTION_RADIUS_M:g}; of random "
        "rays what suits range and frequency]",
        metavar="MM",
    )
    max_bounces: int = option(1, "Reflections per path at most.", metavar="N")
    normals: Literal["smooth", "face"] = option(
        "smooth", "Interpolated from the vertices, or the faces'."
    )
    crease_deg: float = option(CREASE_DEG, "Edges sharper than this stay sharp.", metavar="DEG")
    facets: Literal["curved", "flat"] = option(
        "curved", "Paths end on the surface that the normals describe, or on the flat faces."
    )
    amplitude: Amplitude = option("unit", "1 per path, or 1/(R1 R2).")
    pattern_exponent: float = option(
        0.0, "With --amplitude spreading: antennas have the pattern cos(angle)^P.", metavar="P"
    )

    def settings(self, **more: Any) -> SimulationSettings:
        """The settings of the simulation; `more` are seed and estimator."""
        fields = recorded(self)
        radius_mm = fields.pop("reception_radius_mm")
        radius_m = None if radius_mm is None else radius_mm / 1e3
        if radius_mm is not None:
            check_unit("--reception-radius-mm", "a radius", radius_mm, PLAUSIBLE_RADIUS_M, "mm")
        return SimulationSettings(**fields, reception_radius_m=radius_m, **more)


@dataclass(frozen=True, kw_only=True)
class PlacementOptions(UnitOptions):
    """Unit and position of meshes."""

    transform: Path | None = option(
        None,
        "4 x 4 matrix, row-major, metres, that moves the meshes into the antenna frame; or the "
        "alignment.json of a recording, for its own.",
        metavar="T.json",
    )

    @property
    def files(self) -> list[Path]:
        """The file of the transform, if there is one."""
        return [] if self.transform is None else [self.transform]

    def matrix(self) -> np.ndarray | None:
        """The transform, shape (4, 4); None if there is none."""
        from measurement_io import read_transform

        return None if self.transform is None else read_transform(self.transform)
