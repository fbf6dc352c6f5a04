"""Where a simulated image disagrees with a measured one, before or after a motion."""

from __future__ import annotations

import numpy as np

from clradar.compare.images import check_same_pixels, depth_map_of
from clradar.compare.unmatched import WEAKER_DB, Disagreement, disagreement_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks


def disagreement(
    measured: Volume | DepthMap,
    simulated: Volume | DepthMap,
    transform: np.ndarray | None = None,
    *,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> Disagreement:
    """Return where a simulated image disagrees with a measured one, pixel by pixel and by objects.

    An object is unmatched where an image is 12 dB stronger than anything of the other within 6 mm
    across boresight and 10 mm along it, with 1 % of its image's energy at least: a displacement of
    a few millimetres, another seed or another alpha leave none.

    Parameters
    ----------
    measured, simulated : Volume or DepthMap
        With the same pixel centres along x and y, but for a `transform`.
    transform : array_like, shape (4, 4), optional
        Moves the simulated depth points first, and puts each on the nearest measured pixel: after
        ``found = align(measured, simulated)`` pass ``found.transform``, and the result is what the
        alignment leaves unexplained. The images may then be on different pixels. After
        ``found = register(measured, mesh)`` pass ``found.volume`` without a transform: it is on the
        pixels of the measurement already.
    dynamic_range_db : float, decibel
        Each image's mask is cut this far below its own maximum.

    Returns
    -------
    Disagreement
        `clradar.plot.disagreement_figure` draws it.

    Raises
    ------
    CompareError
        As `compare`, but for images of any size; or nothing of the simulation is on the measured
        pixels after the motion.
    ModelError
        `dynamic_range_db` is not a positive number, or `transform` no 4x4 matrix.

    Examples
    --------
    Two balls are measured, and the brighter one has been left out of the simulation.

    >>> import numpy as np
    >>> import clradar
    >>> from clradar.compare import disagreement
    >>> x_m = np.arange(-30, 31) * 1e-3
    >>> near, far = (
    ...     np.exp(-((np.hypot(x_m - x, x_m[:, None]) / 3e-3) ** 2)) for x in (-0.02, 0.02)
    ... )
    >>> both, one = (clradar.DepthMap(0 * a + 0.3, a, x_m, x_m) for a in (near + 0.6 * far, far))
    >>> for missing in disagreement(both, one).missing:
    ...     print(missing)
    the brightest object, at (-20, 0, 300) mm with 74 % of the energy
    """
    dynamic_range_db = checks.dynamic_range("disagreement: dynamic_range_db", dynamic_range_db)
    first = depth_map_of(measured, dynamic_range_db, "measured image")
    if transform is not None:
        matrix = checks.transform("disagreement: transform", transform)
        simulated = _moved(simulated, matrix, first)
    second = depth_map_of(simulated, dynamic_range_db, "simulated image")
    check_same_pixels(first, second)
    return disagreement_of(first, second)


def _moved(image: Volume | DepthMap, transform: np.ndarray, pixels: DepthMap) -> DepthMap:
    """Return the depth points of an image after a motion, each on the nearest pixel of another.

    Where several meet, the strongest is kept, as in a maximum projection. Points down to
    `WEAKER_DB` below the cut come along where they are known: weak is not missing.
    """
    deepest_db = pixels.dynamic_range_db + WEAKER_DB
    if isinstance(image, DepthMap):
        deepest_db = min(deepest_db, image.dynamic_range_db)
    cut = depth_map_of(image, max(deepest_db, pixels.dynamic_range_db), "simulated image")
    x_m, y_m, z_m = transform[:3, :3] @ cut.points_m().T + transform[:3, 3:]
    amplitude = cut.amplitude[cut.mask]
    column, inside_x = _nearest(pixels.x_m, x_m)
    row, inside_y = _nearest(pixels.y_m, y_m)
    inside = inside_x & inside_y
    if not inside.any():
        raise CompareError(
            "disagreement: expected a part of the simulated image on the measured pixels after the "
            "motion, got none"
        )
    depth_m = np.full(pixels.depth_m.shape, np.nan)
    strength = np.zeros(pixels.depth_m.shape, dtype=np.float32)
    order = np.argsort(amplitude[inside], kind="stable")  # of one pixel the strongest comes last
    at = row[inside][order], column[inside][order]
    depth_m[at], strength[at] = z_m[inside][order], amplitude[inside][order]
    return DepthMap(depth_m, strength, pixels.x_m, pixels.y_m, cut.dynamic_range_db)


def _nearest(axis_m: np.ndarray, at_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the nearest pixel centre, and whether a position is within the pixels."""
    if len(axis_m) == 1:
        return np.zeros(len(at_m), dtype=int), np.ones(len(at_m), dtype=bool)
    borders = (axis_m[1:] + axis_m[:-1]) / 2
    low, high = 2 * axis_m[0] - borders[0], 2 * axis_m[-1] - borders[-1]
    return np.searchsorted(borders, at_m), (at_m >= low) & (at_m <= high)
