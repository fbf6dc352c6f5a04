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
MESH_UNITS_M = {**UNITS_M, "inch": 25.4e-3}

HAND_M, HAND_AT_M = 0.2, 0.3
"""Size and range that units of length are judged by; a body at 3 m is ten times both."""

SMALL_M, LARGE_M, FAR_M = 0.07, 5.0, 10.0
"""What is smaller and nearer than the first and half an aperture, or larger than the second and
farther away than the third, is most likely a hand in another unit."""


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

    `bounds` are the lowest and highest plausible value of `what`, in metres or hertz; `values` are
    in `unit`, one of `UNITS_M` or `UNITS_HZ`. The second text names the other units in which the
    same numbers are plausible. None if they are plausible as they are.
    """
    units = UNITS_HZ if unit in UNITS_HZ else UNITS_M
    low, high = (bound / units[unit] for bound in bounds)
    every = np.atleast_1d(values)
    wrong = every[~((every >= low) & (every <= high))]  # NaN is wrong, too
    if not wrong.size:
        return None
    span = f"from {low:g} to {high:g}" if low > 0 else f"of at most {high:g}"
    return f"{what} {span} {unit}", f"{_span(wrong)} {unit}{_hint(wrong, bounds, unit, units)}"


def unlikeliness(size_m: float, range_m: float) -> float:
    """How far a size and a range are from those of a hand, as logarithms; 0 of what is 0."""
    ratios = [size_m / HAND_M if size_m > 0 else 1.0, range_m / HAND_AT_M if range_m > 0 else 1.0]
    return float(np.abs(np.log(ratios)).sum())


def doubtful_place(size_m: float, at_m: np.ndarray, antennas_m: np.ndarray) -> str | None:
    """What is said of a size and a place that are most likely in another unit; None if they fit.

    Of a point, whose size is 0, nothing but the range.
    """
    middle_m = (antennas_m.min(axis=0) + antennas_m.max(axis=0)) / 2
    range_m = float(np.linalg.norm(at_m - middle_m))
    aperture_m = float(np.ptp(antennas_m, axis=0).max())
    least_m = max(min(SMALL_M, aperture_m / 2), PLAUSIBLE_RANGE_M[0])
    small = max(size_m, range_m) < (least_m if size_m else least_m / 5)
    if not small and not (size_m > LARGE_M and range_m > FAR_M):
        return None
    mixed = {
        f"in {unit}, not {taken}": MESH_UNITS_M[unit] / MESH_UNITS_M[taken]
        for taken in UNITS_M
        for unit in MESH_UNITS_M
        if (MESH_UNITS_M[unit] > MESH_UNITS_M[taken]) == small and unit != taken
    }
    likely = sorted(
        mixed, key=lambda words: unlikeliness(*(mixed[words] * v for v in (size_m, range_m)))
    )
    meant = ", ".join(
        f"{place_words(mixed[words] * size_m, mixed[words] * range_m)} if {words}"
        for words in likely[:3]
    )
    large = f"{_length(size_m)} large and " if size_m else ""
    return (
        f"{large}{_length(range_m)} from the middle of antennas that are {_length(aperture_m)} "
        f"apart; is its unit right? It would be {meant}"
    )


def place_words(size_m: float, range_m: float) -> str:
    """A size and a range in words, without what is 0."""
    return " at ".join(_length(value_m) for value_m in (size_m, range_m) if value_m)


def _length(length_m: float) -> str:
    return f"{length_m:.3g} m" if length_m >= 1 else f"{1e3 * length_m:.3g} mm"


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
