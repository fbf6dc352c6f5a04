"""Guard against values in another unit than the one that is expected.

The bounds are those of `clradar.constants`; files are held to the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clradar.constants import PLAUSIBLE_RANGE_M
from clradar.model import checks

UNITS_HZ = {"Hz": 1.0, "MHz": 1e6, "GHz": 1e9}
UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


def check_plausible(
    field: str, what: str, values: Any, bounds: tuple[float, float], unit: str = "m"
) -> None:
    """Raise a `ModelError` if no near-field radar can mean values; see `implausible`."""
    fault = implausible(what, values, bounds, unit)
    if fault is not None:
        checks.fail(field, *fault)


def place(field: str, value: Any) -> np.ndarray:
    """Return a point in the antenna frame, shape (3,), metres, within the plausible range."""
    point = checks.read_only(field, value, np.float64, (3,))
    farthest_m = np.abs(point).max()
    check_plausible(field, "coordinates", farthest_m, (0.0, PLAUSIBLE_RANGE_M[1]))
    return point


def implausible(
    what: str, values: Any, bounds: tuple[float, float], unit: str = "m"
) -> tuple[str, str] | None:
    """What is expected in place of values that no near-field radar can mean, and what is there.

    Parameters
    ----------
    what : str
        What the values are, such as "an aperture".
    values : float or array_like
        In `unit`.
    bounds : pair of float
        Lowest and highest plausible value, metres or hertz.
    unit : str
        One of `UNITS_M` or `UNITS_HZ`.

    Returns
    -------
    pair of str, or None
        The second names the other units in which the same numbers are plausible. None if they are
        plausible as they are.
    """
    units = UNITS_HZ if unit in UNITS_HZ else UNITS_M
    low, high = (bound / units[unit] for bound in bounds)
    every = np.atleast_1d(values)
    wrong = every[~((every >= low) & (every <= high))]  # NaN is wrong, too
    if not wrong.size:
        return None
    span = f"from {low:g} to {high:g}" if low > 0 else f"of at most {high:g}"
    return f"{what} {span} {unit}", f"{_span(wrong)} {unit}{_hint(wrong, bounds, unit, units)}"


def _hint(
    values: np.ndarray, bounds: tuple[float, float], unit: str, units: dict[str, float]
) -> str:
    low, high = bounds[0] / units[unit], bounds[1] / units[unit]

    def fits(factor: float) -> bool:
        with np.errstate(over="ignore", under="ignore"):
            return bool(low <= values.min() * factor and values.max() * factor <= high)

    # The likeliest mistakes, millimetres and gigahertz, come first.
    factors = {other: units[other] / units[unit] for other in reversed(units) if other != unit}
    meant = [
        f"{_span(values)} {other} ({_span(values * factor)} {unit})"
        for other, factor in factors.items()
        if fits(factor)
    ]
    if not meant and unit == "m" and values.max() < low and fits(1e3):  # converted twice
        meant = [f"{_span(values * 1e3)} {unit}"]
    return f"; did you mean {' or '.join(meant)}?" if meant else ""


def _span(values: np.ndarray) -> str:
    first, last = f"{values[0]:g}", f"{values[-1]:g}"
    return first if first == last else f"{first} to {last}"
