"""Settings record of a simulation, and how functions take it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np

from clradar.constants import PLAUSIBLE_RADIUS_M
from clradar.geometry.normals import CREASE_DEG
from clradar.model import PERFECT_CONDUCTOR, AntennaArray, Scene, TraceStatistics, Waveform, checks
from clradar.model.plausible import check_plausible
from clradar.opencl import Device
from clradar.tracing.suited import (
    EXPECTED_ALPHA,
    RECEPTION_RADIUS_M,
    affordable_rays,
    least_expected_alpha,
    suited_radius_m,
)

SAMPLES_PER_MM2 = 10.0
RAYS_PER_SAMPLE = 4

EXPECTED_SAMPLES_PER_MM2 = 1.0
"""For ``estimator="expected"``, which needs fewer; each then has as many more rays."""

PHYSICAL_SAMPLES_PER_MM2 = 4.0
"""For ``estimator="physical"``: half a millimetre, an eighth of a wavelength at 77 GHz."""

UNUSED_BY_PHYSICAL = (
    "rays_per_face",
    "rays_per_sample",
    "reception_radius_m",
    "max_bounces",
    "amplitude",
    "pattern_exponent",
)
"""Fields that have to keep their defaults with ``estimator="physical"``."""

MOST_EXPONENT = 1e4  # of an antenna's pattern: it halves the power 0.5 degrees off boresight
FILLED_IN = (
    "samples_per_mm2",
    "rays_per_face",
    "rays_per_sample",
    "reception_radius_m",
    "estimator",
)
"""Fields that `SimulationSettings.resolved` fills in where they are None."""

CHECKS: dict[str, tuple[Any, ...]] = {
    "samples_per_mm2": (checks.positive,),
    "rays_per_face": (checks.whole, 1, 2**20),
    "rays_per_sample": (checks.whole, 1, 2**16),
    "reception_radius_m": (checks.positive,),
    "max_bounces": (checks.whole, 1, 255),
    "normals": (checks.one_of, ("smooth", "face")),
    "crease_deg": (checks.real,),
    "facets": (checks.one_of, ("curved", "flat")),
    "amplitude": (checks.one_of, ("unit", "spreading")),
    "pattern_exponent": (checks.real,),
    "seed": (checks.whole, 0, 2**64 - 1),
    "estimator": (checks.one_of, ("stochastic", "expected", "physical")),
}
"""Check of each field and its limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationSettings:
    """How rays are launched, reflected and received: the settings of a simulation.

    Functions that simulate take these fields as keyword arguments, or a record as `settings`.
    Equations, and the paper: docs/equations.md.

    Attributes
    ----------
    samples_per_mm2 : float, optional
        Density of surface samples. None: `rays_per_face` counts, or where that is None, too, 10 (1
        with the expected estimator, 4 with the physical one).
    rays_per_face : int, 1 to 2^20, optional
        So many samples on every face instead, as in the paper.
    rays_per_sample : int, 1 to 2^16, optional
        Outgoing rays per sample and Tx. None: 4 with a density, 1 with `rays_per_face`; with the
        expected estimator and no density ten times as many, for the same scale.
    reception_radius_m : float, 0.1 mm to 1 m, optional
        Of the sphere about an Rx that a ray has to enter before it hits anything. None: 10 mm,
        which grows with range where `clradar.simulate` draws random rays (E4).
    max_bounces : int, 1 to 255
        Reflections per path at most; 1 with the expected estimator.
    normals : "smooth" or "face"
        Shading normals, interpolated from the vertices or those of the faces.
    crease_deg : float
        Edges sharper than this stay sharp in "smooth".
    facets : "curved" or "flat"
        Whether paths are reflected on the curved surface that the corners' normals describe (E1).
    amplitude : "unit" or "spreading"
        1 per path as in the paper, or 1 / (R1 R2), the lengths up to the last reflection and from
        there on in metres.
    pattern_exponent : float, 0 to 10 000
        With "spreading": both antennas have the field pattern cos(angle to +z)^exponent.
    seed : int, 0 to 2^64 - 1
    estimator : "stochastic", "expected" or "physical", optional
        "stochastic": random rays, as in the paper. "expected": their mean over directions, without
        shot noise. "physical": the Kirchhoff sum over the scene's materials, S-parameters; without
        alpha, and fields about rays keep their defaults. None: "stochastic", but `clradar.simulate`
        takes "physical" for a scene with a material, else "expected" unless rays or several bounces
        are asked for or an alpha is below about 0.12. See docs/estimators.md.
    """

    samples_per_mm2: float | None = None
    rays_per_face: int | None = None
    rays_per_sample: int | None = None
    reception_radius_m: float | None = None
    max_bounces: int = 1
    normals: str = "smooth"
    crease_deg: float = CREASE_DEG
    facets: str = "curved"
    amplitude: str = "unit"
    pattern_exponent: float = 0.0
    seed: int = 0
    estimator: str | None = None

    def __post_init__(self) -> None:
        if self.samples_per_mm2 is not None and self.rays_per_face is not None:
            checks.fail(
                "samples_per_mm2, rays_per_face",
                "one of the two",
                f"both ({self.samples_per_mm2}, {self.rays_per_face})",
            )
        for name, (check, *limits) in CHECKS.items():
            value = getattr(self, name)
            if value is not None or name not in FILLED_IN:
                object.__setattr__(self, name, check(name, value, *limits))
        if self.reception_radius_m is not None:
            check_plausible(
                "reception_radius_m", "a radius", self.reception_radius_m, PLAUSIBLE_RADIUS_M
            )
        exponent = self.pattern_exponent
        if not 0 <= exponent <= MOST_EXPONENT or (exponent > 0 and self.amplitude != "spreading"):
            checks.fail(
                "pattern_exponent",
                f"0, or a positive number with amplitude='spreading', at most {MOST_EXPONENT:g}",
                exponent,
            )
        if self.estimator == "expected" and self.max_bounces > 1:
            checks.fail("max_bounces", "1 with estimator='expected'", self.max_bounces)
        if self.estimator == "physical":
            for name in UNUSED_BY_PHYSICAL:
                default, value = type(self).__dataclass_fields__[name].default, getattr(self, name)
                if name == "reception_radius_m" and value is not None:
                    default = RECEPTION_RADIUS_M
                if value != default:
                    expected = (
                        f"the default ({default}) with estimator='physical', which has no rays"
                    )
                    checks.fail(name, expected, value)

    @property
    def radius_m(self) -> float:
        """The reception radius, with the default where it is None.

        :meta private:
        """
        return RECEPTION_RADIUS_M if self.reception_radius_m is None else self.reception_radius_m

    def resolved(self) -> SimulationSettings:
        """Fill in the fields that are None; a resolved record stays as it is."""
        rays, density, estimator = self.rays_per_sample, self.samples_per_mm2, self.estimator
        radius_m = (
            RECEPTION_RADIUS_M if self.reception_radius_m is None else self.reception_radius_m
        )
        if estimator == "physical":
            density = density or PHYSICAL_SAMPLES_PER_MM2
            return replace(self, samples_per_mm2=density, reception_radius_m=radius_m)
        if rays is None:
            rays = RAYS_PER_SAMPLE if self.rays_per_face is None else 1
        if density is None and self.rays_per_face is None:
            density = SAMPLES_PER_MM2
            if estimator == "expected":
                # Fewer samples, of which each has more rays: the sum keeps its mean.
                density = EXPECTED_SAMPLES_PER_MM2
                rays *= round(SAMPLES_PER_MM2 / EXPECTED_SAMPLES_PER_MM2)
        return replace(
            self,
            samples_per_mm2=density,
            rays_per_sample=rays,
            reception_radius_m=radius_m,
            estimator="stochastic" if estimator is None else estimator,
        )

    def for_scene(
        self, scene: Scene, array: AntennaArray | None = None, waveform: Waveform | None = None
    ) -> SimulationSettings:
        """Choose the estimator of `clradar.simulate`, and what suits the range, if not given."""
        if array is None or waveform is None:
            return self._with_estimator(scene, EXPECTED_ALPHA)
        radius_m = suited_radius_m(scene, array, waveform)
        own = self.reception_radius_m
        least = least_expected_alpha(scene, array, radius_m) if own is None else EXPECTED_ALPHA
        chosen = self._with_estimator(scene, least)
        if chosen.estimator in (None, "stochastic"):
            return replace(chosen, reception_radius_m=radius_m) if own is None else chosen
        given = (chosen.samples_per_mm2, chosen.rays_per_face, chosen.rays_per_sample)
        if chosen.estimator == "physical" or any(value is not None for value in given):
            return chosen
        usual = chosen.resolved()
        assert usual.samples_per_mm2 is not None
        assert usual.rays_per_sample is not None
        rays = affordable_rays(scene, array, usual.samples_per_mm2, usual.rays_per_sample)
        density = usual.samples_per_mm2 * usual.rays_per_sample / rays
        return replace(chosen, samples_per_mm2=density, rays_per_sample=rays)

    def _with_estimator(self, scene: Scene, least_alpha: float) -> SimulationSettings:
        # The density of samples is for the quality of a result, and no wish for another estimator.
        asked = (self.rays_per_face, self.rays_per_sample, self.estimator)
        if self.max_bounces > 1 or any(value is not None for value in asked):
            return self
        if scene.materials != (PERFECT_CONDUCTOR,):
            return replace(self, estimator="physical")
        if np.min(scene.alpha) < least_alpha:
            return self
        return replace(self, estimator="expected")


def resolve_settings(
    settings: SimulationSettings | None = None, /, **fields: Any
) -> SimulationSettings:
    """Settings with some fields replaced, checked and resolved; None stands for the defaults."""
    return merged_settings(settings, **fields).resolved()


def merged_settings(
    settings: SimulationSettings | None = None, /, **fields: Any
) -> SimulationSettings:
    """Settings with some fields replaced, checked."""
    if settings is None:
        return SimulationSettings(**fields)
    checks.instance("settings", settings, SimulationSettings)
    return replace(settings, **fields)


def require_stochastic(function: str, settings: SimulationSettings) -> None:
    """Raise a `ModelError` for another estimator in a function of random rays."""
    if settings.estimator == "physical":
        checks.fail(
            f"{function}: estimator",
            "'stochastic', for rays and alphas (clradar.simulate takes 'physical', with "
            "Scene.with_material in place of alphas)",
            "'physical'",
        )
    checks.one_of(f"{function}: estimator", settings.estimator, ("stochastic",))


Function = TypeVar("Function", bound=Callable[..., Any])


def takes_settings(function: Function) -> Function:
    """Show the fields of `SimulationSettings` in the signature of a function for its `**fields`."""
    shown = inspect.signature(function)
    fields = inspect.signature(SimulationSettings).parameters.values()
    plain = [p for p in shown.parameters.values() if p.kind is not p.VAR_KEYWORD]
    function.__signature__ = shown.replace(parameters=[*plain, *fields])  # type: ignore[attr-defined]
    return function


def simulated_meta(
    scene: Scene,
    settings: SimulationSettings,
    statistics: TraceStatistics,
    n_paths: int,
    device: Device,
) -> dict[str, Any]:
    """The `meta` of a simulated capture: settings, scene digest, counts of rays, device.

    With the physical estimator a path is a sample that a Tx and an Rx see, no ray goes out, and the
    samples are S-parameters (`Capture.absolute`).
    """
    return {
        "kind": "simulated",
        **({"absolute": True} if settings.estimator == "physical" else {}),
        "settings": asdict(settings),
        "scene": {
            "sha256": scene.digest(),
            "faces": scene.n_faces,
            "parts": list(scene.part_names),
            "alpha_min": float(np.min(scene.alpha)),
            "alpha_max": float(np.max(scene.alpha)),
        },
        "rays": {
            **asdict(statistics),
            "absorbed_share": statistics.absorbed_share,
            "paths": n_paths,
        },
        "device": device.describe(),
    }
