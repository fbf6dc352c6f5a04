"""The time line of a page: maxima and depths of every frame as bytes, and the metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clradar.compare import METRICS, Metrics, depth_map_of, metrics_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.report.slices import codes_of, packed, text_of
from clradar.report.tables import METRIC_TEXTS

MAX_FRAMES = 300
"""Of one page."""

MAX_PACKED_BYTES = 6_000_000
"""Of all pictures of a page; beyond it pixels are put together."""


@dataclass(slots=True)
class FrameSeries:
    """Images of a measurement and of simulations over frames, with their metrics.

    Parameters
    ----------
    labels : sequence of str
        Of the measurement, and of each simulation: plain text.
    dynamic_range_db : float, decibel
        Pixels further below an image's own maximum are background.

    Attributes
    ----------
    names : list of str
        Of the frames, in their order.
    metrics : list of list of Metrics or None
        Of every frame one for each simulation; None where one of the two images has nothing to
        compare.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.report import FrameSeries, frames_report
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> near, far = (clradar.DepthMap(0 * spot + z_m, spot, x_m, x_m) for z_m in (0.300, 0.302))
    >>> series = FrameSeries(["measured", "simulated"])
    >>> for number in range(3):
    ...     found = series.add(f"frame {number}", [near, far])
    >>> print(f"{series.mean(0, 'overlap'):.3f}")
    0.779
    >>> page = frames_report(series)
    """

    labels: Sequence[str]
    dynamic_range_db: float = DYNAMIC_RANGE_DB
    names: list[str] = field(default_factory=list)
    metrics: list[list[Metrics | None]] = field(default_factory=list)
    x_m: np.ndarray | None = None
    y_m: np.ndarray | None = None
    _level: list[list[np.ndarray]] = field(default_factory=list)
    _depth_m: list[list[np.ndarray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        what = "FrameSeries: dynamic_range_db"
        self.dynamic_range_db = checks.dynamic_range(what, self.dynamic_range_db)
        if len(self.labels) < 2:
            raise CompareError(
                "FrameSeries: expected labels of a measurement and of simulations, got "
                f"{len(self.labels)}"
            )

    def add(self, name: str, images: Sequence[Volume | DepthMap]) -> list[Metrics | None]:
        """Add a frame: its images in the order of the labels; return their metrics.

        An image without anything above zero leaves a gap.

        Raises
        ------
        CompareError
            Another number of images than of labels, other pixels than before, pixels at uneven
            distances, or too many frames.
        """
        if len(images) != len(self.labels):
            raise CompareError(
                f"FrameSeries.add: expected {len(self.labels)} images, got {len(images)}"
            )
        check_count(len(self.names) + 1)
        maps = [self._map(image) for image in images]
        first, *others = maps
        found = [
            None if first is None or one is None else metrics_of(first, one, self.dynamic_range_db)
            for one in others
        ]
        known = next((one for one in maps if one is not None), None)
        if known is not None:
            self._check_pixels(known)
        self.names.append(name)
        self.metrics.append(found)
        self._level.append([self._codes(one) for one in maps])
        self._depth_m.append([_depth(one) for one in maps])
        return found

    def mean(self, simulation: int, metric: str) -> float:
        """The mean of a metric over the frames that have it; NaN if none has."""
        values = self.values(simulation, metric)
        there = values[np.isfinite(values)]
        return float(there.mean()) if there.size else math.nan

    def mean_metrics(self, simulation: int) -> Metrics:
        """The mean of every metric over the frames."""
        means: dict[str, Any] = {name: self.mean(simulation, name) for name in METRICS}
        return Metrics(**means, dynamic_range_db=self.dynamic_range_db)

    def values(self, simulation: int, metric: str) -> np.ndarray:
        """A metric at every frame, shape (n,), float64; NaN where there is none."""
        found = [frame[simulation] for frame in self.metrics]
        return np.array([math.nan if one is None else getattr(one, metric) for one in found])

    def _map(self, image: Volume | DepthMap) -> DepthMap | None:
        try:
            return depth_map_of(image, self.dynamic_range_db, "image")
        except CompareError:
            amplitude = np.abs(image.data) if isinstance(image, Volume) else image.amplitude
            if np.any(amplitude):
                raise
            return None

    def _check_pixels(self, image: DepthMap) -> None:
        if self.x_m is None or self.y_m is None:
            for name, axis_m in (("x", image.x_m), ("y", image.y_m)):
                if len(axis_m) < 2 or not np.allclose(np.diff(axis_m), axis_m[1] - axis_m[0]):
                    raise CompareError(
                        f"FrameSeries.add: expected pixels at equal distances along {name}"
                    )
            self.x_m, self.y_m = image.x_m, image.y_m
        if not (_same(self.x_m, image.x_m) and _same(self.y_m, image.y_m)):
            raise CompareError("FrameSeries.add: expected the pixels of the frames before")

    def _codes(self, image: DepthMap | None) -> np.ndarray:
        if image is None:
            return np.zeros((0, 0), np.uint8)
        return codes_of(image.amplitude, self.dynamic_range_db)


def check_count(frames: int) -> None:
    """Raise where a page would have too many frames."""
    if frames > MAX_FRAMES:
        raise CompareError(
            f"report: expected at most {MAX_FRAMES} frames on a page, got {frames}; choose fewer"
        )


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and bool(np.allclose(one, other, atol=1e-7))


def _depth(image: DepthMap | None) -> np.ndarray:
    """Depths, shape (ny, nx), float32, metres; NaN: none."""
    return np.zeros((0, 0), np.float32) if image is None else image.depth_m.astype(np.float32)


def frame_data(series: FrameSeries) -> dict[str, Any]:
    """Return the frames for the page's script, in types of JSON.

    Cropped to the box around all that is above the dynamic range in any frame; pixels are put
    together until all pictures take `MAX_PACKED_BYTES` at most. A block shows its highest level,
    and the depth there.
    """
    if series.x_m is None or series.y_m is None:
        raise CompareError("frames_report: expected a frame with an image above zero, got none")
    shape = (len(series.names), len(series.labels), len(series.y_m), len(series.x_m))
    level, depth_m = np.zeros(shape, np.uint8), np.full(shape, np.nan, np.float32)
    for i in range(shape[0]):
        for j in range(shape[1]):
            if series._level[i][j].size:
                level[i, j], depth_m[i, j] = series._level[i][j], series._depth_m[i][j]
    rows, columns = (np.flatnonzero(level.any(axis=axes)) for axes in ((0, 1, 3), (0, 1, 2)))
    box = (..., slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    level, depth_m = level[box], depth_m[box]
    ends_m = (float(np.nanmin(depth_m)), float(np.nanmax(depth_m)))
    factor = 1
    while True:
        shown = _coarser(level, depth_m, factor)
        codes = np.stack([shown[0], _depth_codes(shown[1], ends_m)], axis=2)
        contents = [packed(codes[:, j]) for j in range(shape[1])]
        size = sum(map(len, contents))
        if size <= MAX_PACKED_BYTES:
            break
        factor = max(factor + 1, int(factor * (size / MAX_PACKED_BYTES) ** 0.5))
    step_mm = [1e3 * factor * float(axis[1] - axis[0]) for axis in (series.x_m, series.y_m)]
    first_mm = [1e3 * float(series.x_m[columns[0]]), 1e3 * float(series.y_m[rows[0]])]
    return {
        "names": series.names,
        "labels": list(series.labels),
        "counts": [codes.shape[4], codes.shape[3]],
        "first": [a + (1 - 1 / factor) / 2 * b for a, b in zip(first_mm, step_mm, strict=True)],
        "step": step_mm,
        "depth": [1e3 * end for end in ends_m],
        "factor": factor,
        "codes": [text_of(content) for content in contents],
        "metrics": [
            {
                "name": text.name,
                "digits": text.digits,
                "values": [
                    [None if math.isnan(v) else float(text.scale * v) for v in values]
                    for values in (series.values(j, text.field) for j in range(shape[1] - 1))
                ],
            }
            for text in METRIC_TEXTS
        ],
    }  # fmt: skip


def depths_mm(series: FrameSeries) -> np.ndarray:
    """All depths of all frames, shape (n,), millimetres."""
    every = np.concatenate([depth.ravel() for frame in series._depth_m for depth in frame])
    return np.asarray(1e3 * every[np.isfinite(every)])


def _coarser(level: np.ndarray, depth_m: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """The highest level of every block of pixels, and the depth there; both (n, m, ny, nx)."""
    if factor == 1:
        return level, depth_m
    n, m, rows, columns = level.shape
    pad = ((0, 0), (0, 0), (0, -rows % factor), (0, -columns % factor))
    blocks = []
    for array, empty in ((level, 0), (depth_m, np.nan)):
        whole = np.pad(array, pad, constant_values=empty)
        split = whole.reshape(n, m, whole.shape[2] // factor, factor, -1, factor)
        blocks.append(split.transpose(0, 1, 2, 4, 3, 5).reshape(*split.shape[:3], -1, factor**2))
    highest = blocks[0].argmax(axis=-1)[..., None]
    first, second = (np.take_along_axis(block, highest, axis=-1)[..., 0] for block in blocks)
    return first, second


def _depth_codes(depth_m: np.ndarray, ends_m: tuple[float, float]) -> np.ndarray:
    """Depths as bytes: 1 to 255 from the nearest to the farthest of all frames, 0: none."""
    span_m = max(ends_m[1] - ends_m[0], 1e-6)
    codes = np.round(1 + 254 * (np.nan_to_num(depth_m, nan=ends_m[0]) - ends_m[0]) / span_m)
    return np.where(np.isnan(depth_m), 0, codes).astype(np.uint8)
