"""Images frame after frame, and counts them."""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from clradar.errors import ClradarError
from clradar.imaging.frame_imager import DEFAULT_METHOD, FrameImager
from clradar.imaging.placement import place_grid
from clradar.live.inbox import Arrived, Counts, Inbox
from clradar.live.sources import Source, started
from clradar.model import Capture, DepthMap, VoxelGrid
from clradar.opencl import Device
from clradar.view.grids import live_grid

WINDOW = 30
"""Frames over which rate and latency are taken."""

SAY_S = 1.0
"""Between two looks at the state while no frame comes."""


@dataclass(frozen=True, slots=True)
class Pace:
    """Frames shown, and how fast of late.

    Attributes
    ----------
    shown : int
    rate_hz : float
        Over the last 30; 0 before the second.
    latency_s, worst_s : float, seconds
        From the first byte of a frame, from the time when its file was last written, or from when
        it was due, to its depth map: median and largest of the last 30.
    """

    shown: int = 0
    rate_hz: float = 0.0
    latency_s: float = 0.0
    worst_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A frame, its depth map, and the state after it."""

    label: str
    capture: Capture
    image: DepthMap
    pace: Pace
    counts: Counts


class KeptImager:
    """The imager of the last frame, kept while radar, grid and settings are the same."""

    def __init__(self, tolerance_db: float | None, device: Device) -> None:
        self._tolerance_db, self._device = tolerance_db, device
        self._imager: FrameImager | None = None
        self._settings = ("", "")

    def close(self) -> None:
        """Free the device's memory."""
        if self._imager is not None:
            self._imager.close()
            self._imager = None

    def of(
        self, capture: Capture, grid: VoxelGrid | None, window: str, method: str = DEFAULT_METHOD
    ) -> FrameImager:
        """Return the imager of a frame; without a grid that of the last one, or one placed anew.

        Raises
        ------
        ModelError, DeviceError
            As `clradar.FrameImager`.
        """
        last = self._imager
        if (
            last is not None
            and self._settings == (window, method)
            and (grid is None or grid.same_voxels(last.grid))
            and capture.array.same_positions(last.array)
            and capture.waveform.same_frequencies(last.waveform)
        ):
            return last
        self.close()
        if grid is None:
            grid = live_grid(place_grid(capture, device=self._device))
        self._settings = (window, method)
        self._imager = FrameImager(
            capture.array, capture.waveform, grid, method=method, window=window,
            tolerance_db=self._tolerance_db if method == DEFAULT_METHOD else None,
            device=self._device,
        )  # fmt: skip
        return self._imager


class Images(Protocol):
    """Makes depth maps of frames."""

    def image(self, frame: Arrived) -> DepthMap | None:
        """Return the depth map of a frame; None where it is not to be shown."""


class LiveImages:
    """Depth maps of captures; antennas, frequencies and grid are kept until others come.

    Parameters
    ----------
    grid : VoxelGrid or None
        None: one placed around what the first frame shows, of half a million voxels at most.
    window : str
        As `clradar.backproject` takes it.
    tolerance_db : float or None
        As `clradar.backproject` takes it.
    dynamic_range_db : float
    device : Device
    """

    def __init__(
        self,
        grid: VoxelGrid | None,
        window: str,
        tolerance_db: float | None,
        dynamic_range_db: float,
        device: Device,
    ) -> None:
        self._grid, self._window, self._dynamic_range_db = grid, window, dynamic_range_db
        self._imager = KeptImager(tolerance_db, device)

    def close(self) -> None:
        """Free the device's memory."""
        self._imager.close()

    def image(self, frame: Arrived) -> DepthMap:
        """Return the depth map of a frame.

        Raises
        ------
        ModelError, DeviceError
            As `clradar.FrameImager`.
        """
        imager = self._imager.of(frame.capture, self._grid, self._window)
        imager.form(frame.capture)
        return imager.depth_map(self._dynamic_range_db)


def run(
    source: Source,
    images: Images,
    show: Callable[[Shown], None],
    waiting: Callable[[Pace, Counts], None],
    *,
    most: int | None = None,
) -> tuple[Pace, Counts]:
    """Image the newest frame of a source again and again, until it ends.

    Parameters
    ----------
    source : Source
    images : Images
    show : callable
        Called with every frame that was imaged.
    waiting : callable
        Called with the state about once a second while no frame comes, and with every frame that
        is not to be shown.
    most : int, optional
        End after so many frames.

    Returns
    -------
    Pace, Counts
        The state at the end. Frames that cannot be imaged are bad ones, and it goes on.
    """
    inbox, meter = Inbox(), _Meter()
    stop = started(source, inbox)
    try:
        while not inbox.ended and (most is None or meter.pace.shown < most):
            arrived = inbox.take(SAY_S)
            if arrived is None:
                waiting(meter.pace, inbox.counts)
                continue
            try:
                image = images.image(arrived)
            except ClradarError as error:
                inbox.refuse(f"{arrived.label}: {error}")
                continue
            if image is None:
                inbox.drop(1)
                waiting(meter.pace, inbox.counts)
                continue
            pace = meter.count(arrived)
            show(Shown(arrived.label, arrived.capture, image, pace, inbox.counts))
    finally:
        stop()
    return meter.pace, inbox.counts


class _Meter:
    """Rate and latency over the last frames."""

    def __init__(self) -> None:
        self.pace = Pace()
        self._ends_s: deque[float] = deque(maxlen=WINDOW)
        self._latencies_s: deque[float] = deque(maxlen=WINDOW)

    def count(self, arrived: Arrived) -> Pace:
        """Count a frame that has just been imaged."""
        now_s = time.perf_counter()
        self._ends_s.append(now_s)
        self._latencies_s.append(now_s - arrived.since_s)
        took_s = now_s - self._ends_s[0]
        self.pace = Pace(
            self.pace.shown + 1,
            (len(self._ends_s) - 1) / took_s if took_s > 0 else 0.0,
            statistics.median(self._latencies_s),
            max(self._latencies_s),
        )
        return self.pace
