"""Where the Kirchhoff approximation of a rough surface holds."""

from __future__ import annotations

import math

from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.errors import warn
from clradar.model.material import Material
from clradar.model.waveform import Waveform

STEEPEST = 0.3  # largest RMS slope: beyond it shadows and second bounces between heights matter
LEAST_CURVATURE_WAVELENGTHS = 2.0
"""Least mean radius of curvature, in the longest wavelengths of the band."""


WEAK_G = 0.05
"""Below this g = (2 k h)^2 the radius of curvature does not matter: at most the share g of what is
reflected is scattered by the roughness at all."""


def curvature_radius_m(material: Material) -> float:
    """Return the mean radius of curvature of a rough surface, metres; infinite for a smooth one.

    l^2 / (2 sqrt(3) h) (1 + 2 h^2 / l^2)^1.5 for Gaussian heights with correlation exp(-r^2/l^2).
    """
    height_m, length_m = material.roughness_rms_m, material.correlation_length_m
    if length_m is None or height_m == 0:
        return math.inf
    slope_squared = 2 * (height_m / length_m) ** 2
    return length_m**2 / (2 * math.sqrt(3) * height_m) * (1 + slope_squared) ** 1.5


def check_kirchhoff(material: Material, waveform: Waveform) -> None:
    """Warn where a material is too rough, at the waveform's frequencies, for physical optics.

    That is an RMS slope above 0.3, or a mean radius of curvature below two wavelengths with heights
    that matter.
    """
    text = f"material {material.name!r}: roughness of {1e3 * material.roughness_rms_m:g} mm over "
    text += f"{1e3 * (material.correlation_length_m or 0.0):g} mm"
    if material.rms_slope > STEEPEST:
        warn(
            f"{text} has an RMS slope of {material.rms_slope:.2f}, above {STEEPEST:g}: physical "
            "optics knows no shadows and no second bounce between its heights; take a smaller "
            "roughness or a larger correlation length"
        )
    radius_m = curvature_radius_m(material)
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / float(waveform.frequencies_hz[0])
    g = (4 * math.pi * material.roughness_rms_m / wavelength_m) ** 2
    if radius_m < LEAST_CURVATURE_WAVELENGTHS * wavelength_m and g > WEAK_G:
        warn(
            f"{text} curves with a mean radius of {1e3 * radius_m:.2g} mm, below "
            f"{LEAST_CURVATURE_WAVELENGTHS:g} wavelengths of {1e3 * wavelength_m:.2f} mm: physical "
            "optics takes it for locally flat; take a smaller roughness or a larger correlation "
            "length, or micro_roughness_rms_m for what is finer"
        )
