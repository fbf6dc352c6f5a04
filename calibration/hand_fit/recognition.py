"""Whether what was measured is the hand that was fitted, and what of it is in the image."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES, SHAPE_STD, vector_of
from calibration.hand_fit.result import DIGITS, HandFit, end_joints
from calibration.registration.depth_surface import NOT_ALIGNED
from calibration.registration.mesh_pose import MIN_LIKENESS
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume

MIN_OVERLAP = 0.65
"""Least overlap of a simulation of the fit with the measurement. Of 11 hands it is 0.79 or more, of
a box, a sphere and a plate 0.52 to 0.62 (docs/hand-fit-method.md)."""

MARGIN_M = 4e-3  # of the image, about a resolution cell: what is nearer to its edge is cut
UNUSUAL_STD = 3.0
"""Standard deviations among adults beyond which a shape is remarked: one adult of 400."""

ELSEWHERE = 4.0
"""`Information.widening` from which it is remarked: standard deviations are doubled there. In
development it was above in fits with a tip that was 9 to 97 mm off (docs/hand-fit-method.md)."""


def not_fitted(reason: str) -> CompareError:
    return CompareError(f"could not fit the hand, because {reason}")


@contextmanager
def said_of_the_hand() -> Iterator[None]:
    """Say of the hand what could not be aligned."""
    try:
        yield
    except CompareError as error:
        if not str(error).startswith(NOT_ALIGNED):
            raise
        raise not_fitted(str(error).removeprefix(NOT_ALIGNED)) from error


def check_likeness(likeness: float) -> None:
    """Raise where the rendering of the fit correlates as little as with noise."""
    if not likeness >= MIN_LIKENESS:
        raise not_fitted(
            "the measurement disagrees with it: its image and the rendering correlate by "
            f"{likeness:.2f}, and {MIN_LIKENESS:.2f} is the least; it shows noise, or another "
            "object"
        )


def check_overlap(overlap: float, start: str) -> None:
    """Raise where a simulation of the fit overlaps as little as with other objects."""
    if overlap < MIN_OVERLAP:
        raise not_fitted(
            f"simulated as it was found from '{start}', it overlaps with the measurement by "
            f"{overlap:.2f}, and {MIN_OVERLAP:.2f} is the least: it is another object, the other "
            "hand (handedness='either', --hand either), or in another pose (pose='all', --pose all)"
        )


def doubts(fit: HandFit, measured: Volume | DepthMap, widening: float = 1.0) -> tuple[str, ...]:
    """Remarks on a fit, one clause each; `widening` as of `Information`."""
    found = []
    if widening > ELSEWHERE:
        found.append(
            "whole parts of it lie in front of or behind what was measured, as with digits in "
            f"wrong places: standard deviations are {np.sqrt(widening):.1f} times as large for it"
        )
    cut = [
        digit
        for digit, end in zip(DIGITS, end_joints(fit.joints_m), strict=True)
        if _is_cut(fit.joints_m[end], measured)
    ]
    if cut:
        found.append(
            f"outside of the measured image, or within {1e3 * MARGIN_M:.0f} mm of its edge, are "
            f"the tips of: {', '.join(cut)} (a larger grid shows them: --x-mm, --y-mm, --z-mm)"
        )
    if fit.shape is not None and any(name.startswith("shape") for name in fit.parameter_names):
        away = vector_of(fit.shape) / SHAPE_STD
        found += [
            f"its shape is unusual: {name} {abs(value):.1f} standard deviations "
            f"{'above' if value > 0 else 'below'} the average adult's"
            for name, value in zip(SHAPE_NAMES, away, strict=True)
            if abs(value) > UNUSUAL_STD
        ]
    return tuple(found)


def _is_cut(point_m: np.ndarray, measured: Volume | DepthMap) -> bool:
    """Whether a point is not in the image, or at its edge."""
    image = measured.grid if isinstance(measured, Volume) else measured
    axes_m = [image.x_m, image.y_m]
    if isinstance(measured, Volume):
        axes_m.append(measured.grid.z_m)
    return any(
        value_m < axis_m[0] + MARGIN_M or value_m > axis_m[-1] - MARGIN_M
        for value_m, axis_m in zip(point_m, axes_m, strict=False)
    )
