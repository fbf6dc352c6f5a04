"""Point clouds of the 3-D view: depth points, subsampled and packed as base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.compare import clipped_db
from clradar.model import DepthMap
from clradar.plot import depth_limits_mm

MAX_POINTS = 60_000
"""Points of one page over all its clouds: 17 bytes each, so 1 MB."""

MEASURED_COLOUR = "#e08a00"
SIMULATED_COLOURS = (
    "#2f7fd6",
    "#1f9e5a",
    "#c23b80",
    "#7a5cc7",
    "#12a3a3",
    "#b5543a",
    "#6d8a1f",
    "#5b7083",
)
"""Of a brightness that contrasts with white and with black; repeated for more images."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """The depth points of one image.

    Attributes
    ----------
    points_mm : ndarray, shape (n, 3), float32, millimetres
        x, y, z in the antenna frame.
    level : ndarray, shape (n,), uint8
        Amplitude: 0 at the lower end of the dynamic range, 255 at the image's maximum; in decibel.
    total : int
        Number of depth points of the image before subsampling.
    colour : str
        "#rrggbb".
    """

    points_mm: np.ndarray
    level: np.ndarray
    total: int
    colour: str


def clouds(images: Sequence[DepthMap], most: int = MAX_POINTS) -> list[Cloud]:
    """Return one cloud for each image, the first of them the measured one.

    Parameters
    ----------
    images : sequence of DepthMap
    most : int
        Limit of the points of all clouds together. Beyond it all images get the same limit each,
        and larger ones are subsampled at random, with a fixed seed.
    """
    points = [image.points_m() for image in images]
    share = _share([len(p) for p in points], most)
    found = []
    for i, (image, xyz_m) in enumerate(zip(images, points, strict=True)):
        level = np.round(255 * (1 + clipped_db(image)[image.mask] / image.dynamic_range_db))
        kept = np.arange(len(xyz_m))
        if len(kept) > share:
            # Random, because every n-th point of a lattice makes stripes.
            kept = np.sort(np.random.default_rng(0).choice(kept, share, replace=False))
        found.append(
            Cloud(
                points_mm=(1e3 * xyz_m[kept]).astype(np.float32),
                level=level[kept].astype(np.uint8),
                total=len(xyz_m),
                colour=colour_of(i),
            )
        )
    return found


def view_data(images: Sequence[DepthMap], drawn: Sequence[Cloud]) -> dict[str, Any]:
    """Return the data of the page's script, in types of JSON."""
    steps_mm = [1e3 * np.diff(a).min() for i in images for a in (i.x_m, i.y_m) if len(a) > 1]
    return {
        "clouds": [
            {
                "colour": cloud.colour,
                "points_mm": _base64(cloud.points_mm.astype("<f4")),
                "level": _base64(cloud.level),
            }
            for cloud in drawn
        ],
        "pixel_mm": float(min(steps_mm, default=1.0)),
        "depth_mm": list(depth_limits_mm(images)),
    }


def _share(counts: Sequence[int], most: int) -> int:
    """Return the largest number per image with which the total is at most `most`."""
    left, share = most, 0
    ordered = sorted(counts)
    for i, count in enumerate(ordered):
        share = left // (len(ordered) - i)
        if count > share:
            return share
        left -= count
    return max(ordered)


def colour_of(i: int) -> str:
    """The colour of an image, the first of which is the measured one."""
    return MEASURED_COLOUR if i == 0 else SIMULATED_COLOURS[(i - 1) % len(SIMULATED_COLOURS)]


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
