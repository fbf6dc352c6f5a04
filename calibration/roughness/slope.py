"""The slope that a roughness alpha stands for, and the roughness in metres that has it."""

from __future__ import annotations

import math

from clradar.model import checks


def slope_of_alpha(alpha: float) -> float:
    """Return the RMS slope, along one direction, of a surface that scatters as widely as alpha.

    Parameters
    ----------
    alpha : float
        In [0, 1].

    Raises
    ------
    ModelError
        It is not in [0, 1].

    Notes
    -----
    alpha / (4 (1 - alpha / 3)). A facet that reflects the incoming direction t_i into the outgoing
    t_c of E3 has the normal t_c - t_i. For small alpha, t_c deviates by alpha t_d, whose
    components across have the variance 1/4, and the normal by half of that: alpha / 4. The other
    factor is fitted. The slopes of the lobe's density at normal incidence are within 4 % of it up
    to alpha = 0.8 and 10 % smaller at 1; at an incidence of 30 degrees they are 15 to 30 % larger
    (docs/sweep-method.md).

    Examples
    --------
    Heights h with a correlation length of 3 mm, whose slope is sqrt(2) h / l:

    >>> import calibration
    >>> slope = calibration.slope_of_alpha(0.3)
    >>> print(f"{slope:.4f}, h = {3 * slope / 2**0.5:.2f} mm")
    0.0833, h = 0.18 mm
    """
    value = checks.real("slope_of_alpha: alpha", alpha)
    if not 0.0 <= value <= 1.0:
        checks.fail("slope_of_alpha: alpha", "a number in [0, 1]", value)
    return value / (4.0 * (1.0 - value / 3.0))


def alpha_of_slope(slope: float) -> float:
    """Return the alpha whose lobe has an RMS slope: the inverse of `slope_of_alpha`.

    Parameters
    ----------
    slope : float
        RMS slope along one direction, sqrt(2) h / l for roughness h and correlation length l; in
        [0, 0.375].

    Raises
    ------
    ModelError
        It is not: no alpha is as rough as that.

    Examples
    --------
    >>> import math
    >>> import calibration
    >>> print(f"{calibration.alpha_of_slope(math.sqrt(2) * 0.33e-3 / 3e-3):.2f}")
    0.52
    """
    value = checks.real("alpha_of_slope: slope", slope)
    if not 0.0 <= value <= STEEPEST:
        checks.fail("alpha_of_slope: slope", f"a number in [0, {STEEPEST:g}]", value)
    return value / (0.25 + value / 3.0)


STEEPEST = slope_of_alpha(1.0)


def slope_of_roughness(roughness_m: float, correlation_m: float) -> float:
    """Return the RMS slope sqrt(2) h / l of Gaussian heights with correlation exp(-r^2 / l^2)."""
    return math.sqrt(2.0) * roughness_m / correlation_m
