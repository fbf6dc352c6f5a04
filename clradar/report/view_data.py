"""What the script of the page draws, in types of JSON: points, volumes to cut, panels."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clradar.compare.images import clipped_db
from clradar.model import DepthMap, Volume
from clradar.plot.drawing import Extent, depth_limits_mm

MAX_POINTS = 60_000  # points of one page over all its clouds: 17 bytes each, so 1 MB
COLOURS = (
    "#e08a00", "#2f7fd6", "#1f9e5a", "#c23b80", "#7a5cc7", "#12a3a3", "#b5543a", "#6d8a1f",
    "#5b7083",
)  # fmt: skip
"""Of the measured image and of simulated ones, repeated for more: of a brightness that contrasts
with white and with black."""


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """The depth points of one image, some of `total`, in a colour "#rrggbb".

    Levels are bytes: 0 at the lower end of the dynamic range, 255 at the maximum; in decibel.
    """

    points_mm: np.ndarray
    level: np.ndarray
    total: int
    colour: str


def clouds(images: Sequence[DepthMap], most: int = MAX_POINTS) -> list[Cloud]:
    """Return one cloud for each image, the first of them the measured one."""
    found, share = [], most // len(images)
    for i, image in enumerate(images):
        xyz_m = image.points_m()
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
                colour=COLOURS[0] if i == 0 else COLOURS[1 + (i - 1) % (len(COLOURS) - 1)],
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
                "points_mm": base64_of(cloud.points_mm.astype("<f4").tobytes()),
                "level": base64_of(cloud.level.tobytes()),
            }
            for cloud in drawn
        ],
        "pixel_mm": float(min(steps_mm, default=1.0)),
        "depth_mm": list(depth_limits_mm(images)),
    }


MAX_PACKED_BYTES = 1_500_000
"""Of all volumes of a page together; beyond it they are given by the maxima of blocks of voxels."""

MARGIN_VOXELS = 2  # around what is above the dynamic range
MOST_VOXELS = 30_000_000
"""Of all volumes together before they are packed: a browser holds them in memory."""


@dataclass(frozen=True, slots=True)
class _Part:
    """Levels of a box of voxels, shape (nz, ny, nx), uint8; 0 is below the dynamic range."""

    codes: np.ndarray
    origin_mm: np.ndarray
    step_mm: np.ndarray

    def coarser(self, factor: int) -> _Part:
        """The maxima of blocks of `factor` voxels along each axis that has as many."""
        from skimage.measure import block_reduce

        factors = tuple(min(factor, n) for n in self.codes.shape)
        by_axis = np.array(factors[::-1])
        return _Part(
            block_reduce(self.codes, factors, np.max),
            self.origin_mm + (by_axis - 1) / 2 * self.step_mm,
            by_axis * self.step_mm,
        )


def codes_of(amplitude: np.ndarray, dynamic_range_db: float) -> np.ndarray:
    """Levels below the maximum as bytes: 255 is the maximum, 1 the lower end, 0 is below that."""
    relative = amplitude / amplitude.max()
    floor = 10.0 ** (-dynamic_range_db / 20)
    level_db = 20 * np.log10(np.maximum(relative, floor))
    codes = np.round(1 + 254 * (1 + level_db / dynamic_range_db)).astype(np.uint8)
    return np.where(relative > floor, codes, np.uint8(0))


def slice_data(
    volumes: Sequence[tuple[str, Volume]], dynamic_range_db: float
) -> dict[str, Any] | None:
    """Return labelled volumes for the page's script, in types of JSON; None: nothing to cut.

    Cropped to the box around all that is above the dynamic range in any of them. Their axes may
    differ.
    """
    if not volumes or min(sum(n > 1 for n in v.grid.counts) for _, v in volumes) < 2:
        return None
    levels = [(v, codes_of(np.abs(v.data), dynamic_range_db)) for _, v in volumes]
    boxes = [_box_mm(*one) for one in levels]
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    parts = [_cropped(*one, low, high) for one in levels]
    factor, shown = 1, parts
    while True:
        contents = [zlib.compress(part.codes.tobytes(), 6) for part in shown]
        voxels = sum(part.codes.size for part in shown)
        size = sum(map(len, contents))
        if size <= MAX_PACKED_BYTES and voxels <= MOST_VOXELS:
            break
        # Coarser by as much as it is too large, at least by one step: packing takes time.
        factor = max(factor + 1, int(factor * (size / MAX_PACKED_BYTES) ** (1 / 3)))
        shown = [part.coarser(factor) for part in parts]
    return {
        "low": low.tolist(),
        "high": high.tolist(),
        "step": np.min([part.step_mm for part in shown], axis=0).tolist(),
        "range_db": dynamic_range_db,
        "factor": factor,
        "volumes": [
            {
                "label": label,
                "counts": list(part.codes.shape[::-1]),
                "origin": part.origin_mm.tolist(),
                "step": part.step_mm.tolist(),
                "codes": base64_of(content),
            }
            for (label, _), part, content in zip(volumes, shown, contents, strict=True)
        ],
    }


def _box_mm(volume: Volume, codes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The outer faces of the voxels that are above the dynamic range, with a margin."""
    there = np.nonzero(codes)
    first = np.array([int(i.min()) for i in reversed(there)]) - MARGIN_VOXELS
    last = np.array([int(i.max()) for i in reversed(there)]) + MARGIN_VOXELS
    last = np.minimum(last, np.array(volume.grid.counts) - 1)
    origin_mm, step_mm = 1e3 * volume.grid.origin_m, 1e3 * volume.grid.spacing_m
    return (
        origin_mm + (np.maximum(first, 0) - 0.5) * step_mm,
        origin_mm + (last + 0.5) * step_mm,
    )


def _cropped(volume: Volume, codes: np.ndarray, low: np.ndarray, high: np.ndarray) -> _Part:
    """The voxels of a volume in a box; at least one along each axis."""
    origin_mm, step_mm = 1e3 * volume.grid.origin_m, 1e3 * volume.grid.spacing_m
    most = np.array(volume.grid.counts) - 1
    first = np.clip(np.ceil((low - origin_mm) / step_mm - 1e-6), 0, most).astype(int)
    last = np.clip(np.floor((high - origin_mm) / step_mm + 1e-6), first, most).astype(int)
    z, y, x = (slice(a, b + 1) for a, b in zip(first[::-1], last[::-1], strict=True))
    return _Part(codes[z, y, x], origin_mm + first * step_mm, step_mm)


def panel_places(figure: Figure, images: Sequence[DepthMap]) -> list[dict[str, Any]]:
    """Return the panels of amplitudes and depths, in types of JSON."""
    to_mm = 1e3 / Extent.around(images).unit.per_m
    places = []
    for i, axes in enumerate(figure.axes[: 2 * len(images)]):
        axes.apply_aspect()  # an image of another shape fills a part of its place
        places.append(
            {
                "image": i % len(images),
                "box": list(axes.get_position().extents),
                "x": [to_mm * value for value in axes.get_xlim()],
                "y": [to_mm * value for value in axes.get_ylim()],
            }
        )
    return places


def base64_of(content: bytes) -> str:
    """Return bytes as text."""
    return base64.b64encode(content).decode("ascii")
