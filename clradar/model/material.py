"""Materials of surfaces: what they reflect, and how rough they are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.constants import (
    PLAUSIBLE_COATING_M,
    PLAUSIBLE_CORRELATION_M,
    PLAUSIBLE_HZ,
    PLAUSIBLE_MICRO_ROUGHNESS_M,
    PLAUSIBLE_ROUGHNESS_M,
)
from clradar.errors import ModelError, quoted
from clradar.model import checks, fresnel
from clradar.model.permittivity import Permittivity, checked, permittivity_at
from clradar.model.plausible import check_plausible
from clradar.model.record import Record


@dataclass(frozen=True, slots=True, repr=False)
class Coating(Record):
    """A layer of even thickness on a material: the horny layer of skin, paint on metal.

    Parameters
    ----------
    thickness_m : float
    permittivity : complex, ColeCole, PowerLaw or PermittivityTable
        Relative, eps' - j eps''.
    """

    thickness_m: float
    permittivity: Permittivity

    def __post_init__(self) -> None:
        label = "Coating.thickness_m"
        thickness_m = checks.positive(label, self.thickness_m)
        check_plausible(label, "a thickness", thickness_m, PLAUSIBLE_COATING_M)
        eps = checked("Coating.permittivity", self.permittivity)
        self._set(thickness_m=thickness_m, permittivity=eps)


@dataclass(frozen=True, slots=True, repr=False)
class Material(Record):
    """What a surface is made of, and how rough it is (docs/materials.md).

    Parameters
    ----------
    name : str
    permittivity : complex, ColeCole, PowerLaw or PermittivityTable, optional
        Relative, eps' - j eps'' for the time factor exp(+j w t), of a half space. Either this or
        `conductor`.
    conductor : bool
        Whether it is a perfect one.
    coating : Coating, optional
    roughness_rms_m : float
        RMS h of the heights, which are Gaussian with correlation exp(-r^2/l^2).
    correlation_length_m : float, optional
        Their l. Needed if h > 0.
    micro_roughness_rms_m : float
        RMS of heights that are finer than a simulation's points.
    source : str
        Where the values are from; no part of equality.
    """

    name: str
    permittivity: Permittivity | None = None
    conductor: bool = False
    coating: Coating | None = None
    roughness_rms_m: float = 0.0
    correlation_length_m: float | None = None
    micro_roughness_rms_m: float = 0.0
    source: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        if not checks.text("Material.name", self.name).strip():
            checks.fail("Material.name", "a name", repr(self.name))
        checks.text("Material.source", self.source)
        if not isinstance(self.conductor, bool | np.bool_):
            checks.fail("Material.conductor", "True or False", repr(self.conductor))
        if self.conductor == (self.permittivity is not None):
            got = "both" if self.conductor else "neither"
            checks.fail("Material", "either a permittivity or conductor=True", got)
        if self.permittivity is not None:
            self._set(permittivity=checked("Material.permittivity", self.permittivity))
        if self.coating is not None:
            checks.instance("Material.coating", self.coating, Coating)
        self._set(conductor=bool(self.conductor))
        self._check_roughness()

    def _check_roughness(self) -> None:
        heights = {
            "roughness_rms_m": PLAUSIBLE_ROUGHNESS_M,
            "micro_roughness_rms_m": PLAUSIBLE_MICRO_ROUGHNESS_M,
        }
        for name, bounds in heights.items():
            height_m = checks.real(f"Material.{name}", getattr(self, name))
            check_plausible(f"Material.{name}", "an RMS height", height_m, bounds)
            self._set(**{name: height_m})
        label = "Material.correlation_length_m"
        if self.correlation_length_m is not None:
            length_m = checks.positive(label, self.correlation_length_m)
            check_plausible(label, "a length", length_m, PLAUSIBLE_CORRELATION_M)
            self._set(correlation_length_m=length_m)
        elif self.roughness_rms_m > 0:
            checks.fail(label, "a length, since roughness_rms_m is positive", "none")

    @property
    def rms_slope(self) -> float:
        """RMS slope of the roughness along one direction, sqrt(2) h / l."""
        if self.correlation_length_m is None:
            return 0.0
        return float(np.sqrt(2) * self.roughness_rms_m / self.correlation_length_m)

    def permittivity_at(self, frequency_hz: Any) -> np.ndarray:
        """Return the permittivity below a coating, complex128, shape (n,); a conductor has none."""
        if self.permittivity is None:
            checks.fail("Material.permittivity_at", "a dielectric", f"the conductor {self.name!r}")
        return self._at("permittivity", self.permittivity, frequency_hz)

    def _at(self, label: str, eps: Permittivity, frequency_hz: Any) -> np.ndarray:
        try:
            return permittivity_at(eps, frequency_hz)
        except ModelError as error:
            raise ModelError(f"material {quoted(self.name)}: {label}: {error}") from error

    def fresnel(self, frequency_hz: Any, cos_incidence: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the reflection coefficients r_s and r_p, complex128, shape (n, m) each.

        r_s is that of the electric field across the plane of incidence, r_p of the magnetic one:
        r_p = -r_s at normal incidence; -1 and +1 for a conductor.

        Parameters
        ----------
        frequency_hz : array_like, shape (n,)
        cos_incidence : array_like, shape (m,)
            Cosine of the angle between ray and normal, in [0, 1].
        """
        frequencies, cosines = _axes(frequency_hz, cos_incidence)
        eps = None if self.permittivity is None else self.permittivity_at(frequencies)[:, None]
        if self.coating is None:
            r_s, r_p = fresnel.half_space(eps, cosines)
            shape = (len(frequencies), len(cosines))
            return np.broadcast_to(r_s, shape), np.broadcast_to(r_p, shape)
        layer = self._at("coating.permittivity", self.coating.permittivity, frequencies)
        return fresnel.coated(eps, layer[:, None], self.coating.thickness_m, frequencies, cosines)

    def reflection(self, frequency_hz: Any, cos_incidence: Any) -> np.ndarray:
        """Return the coefficient (r_s - r_p) / 2 of the simulation, complex128, shape (n, m).

        -1 for a conductor at every angle. Arguments as of `fresnel`.
        """
        r_s, r_p = self.fresnel(frequency_hz, cos_incidence)
        return (r_s - r_p) / 2


METAL = Material("metal", conductor=True, source="perfect conductor")

PERFECT_CONDUCTOR = Material("perfect conductor", conductor=True)
"""What faces are made of where nobody said it: with another name than metal that was asked for."""


def _axes(frequency_hz: Any, cos_incidence: Any) -> tuple[np.ndarray, np.ndarray]:
    frequencies = checks.read_only("frequency_hz", np.atleast_1d(frequency_hz), np.float64, (None,))
    check_plausible("frequency_hz", "frequencies", frequencies, PLAUSIBLE_HZ, "Hz")
    cosines = checks.read_only("cos_incidence", np.atleast_1d(cos_incidence), np.float64, (None,))
    if cosines.min() < -1e-6 or cosines.max() > 1 + 1e-6:  # what float32 makes of 0 and 1
        found = f"[{cosines.min():g}, {cosines.max():g}]"
        checks.fail("cos_incidence", "cosines in [0, 1]", found)
    return frequencies, np.clip(cosines, fresnel.GRAZING_COS, 1.0)
