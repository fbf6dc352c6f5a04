"""The state of a view: what is wished, carried out in the background, and what is then shown."""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from clradar.compare.metrics import Metrics, metrics_of
from clradar.errors import ClradarError
from clradar.imaging.frame_imager import FrameImager
from clradar.imaging.placement import place_grid
from clradar.model import Capture, Scene, Volume
from clradar.model.progress import Progress
from clradar.opencl import Device
from clradar.view.beside import Beside
from clradar.view.drawn import Drawn, Flat
from clradar.view.sources import Content, Source
from clradar.view.wish import Wish, live_grid

KEPT_BYTES = 512 * 2**20  # of images: 150 frames of 101 x 101 x 41 voxels play from memory
PLAYED_HZ = 10.0  # at most, of frames that do not come by themselves


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What is viewed, what it begins with, and what is shown beside and within it."""

    source: Source
    wish: Wish
    beside: Beside | None = None
    mesh: Scene | None = None
    device: Device | None = None


class Outdated(Exception):
    """Raised to leave work whose result nobody wants any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A wish that was carried out: what was read, and what is drawn of it and beside it.

    Metrics are those of the second image against the first, None where they cannot be compared.
    `prepared`: an imager was made anew for it, which takes longer than an image.
    """

    wish: Wish
    content: Content
    first: Drawn
    second: Drawn | None = None
    metrics: Metrics | None = None
    prepared: bool = False

    @property
    def chosen(self) -> Drawn:
        """The one whose images are shown."""
        if self.second is not None and self.wish.side == "Simulated":
            return self.second
        return self.first


class Front:
    """What a session shows its results with; called from the session's thread."""

    def show(self, shown: Shown) -> None:
        """Draw a result."""

    def busy(self, text: str) -> None:
        """Say what is being done."""

    def refuse(self, text: str) -> None:
        """Say why a wish cannot be carried out; what is shown stays."""

    def following(self, on: bool) -> None:
        """Show that there are other frames, and whether the newest is followed."""

    def paced(self, text: str) -> None:
        """Show rate, latency and losses of followed frames."""


class Session:
    """Reads and images frames in a thread of its own, the newest wish alone."""

    def __init__(self, view: View, front: Front) -> None:
        self.source, self._beside, self._device = view.source, view.beside, view.device
        self._read = lru_cache(maxsize=1)(view.source.read)
        self._drawn = lru_cache(maxsize=1 if view.beside is None else 2)(Drawn.of)
        self._metrics = lru_cache(maxsize=1)(_metrics)
        self.wish, self._front = view.wish, front  # the newest wish
        self.shown: Shown | None = None
        """The last result, and why the last wish was not carried out, if it was not."""
        self.refused = ""
        self._images: dict[tuple[Hashable, ...], Volume | Flat] = {}
        self._imagers: dict[tuple[Hashable, ...], FrameImager] = {}
        """The last used ones, the newest last."""
        self._changed = threading.Condition()
        self._waiting = self._busy = self._closed = self._prepared = False
        self.due_s = math.inf
        """When the next frame is played, by `time.monotonic`; infinite: none is."""
        self._thread = threading.Thread(target=self._run, name="clradar view", daemon=True)
        self._thread.start()

    def change(self, **changes: Any) -> None:
        """Wish for something else, in place of what waits; the fields are those of `Wish`.

        What is being carried out is left.
        """
        with self._changed:
            self.wish = replace(self.wish, **changes)
            self._waiting = True
            self._changed.notify_all()

    def step(self, by: int) -> None:
        """Go on by some frames, around the end."""
        frames = self.source.frames()
        if not frames:
            return
        now = self.wish.frame  # which may be gone
        at = bisect_right(frames, now) - 1 if by > 0 else bisect_left(frames, now)
        self.change(frame=frames[(at + by) % len(frames)])

    def play(self, on: bool) -> None:
        """Begin to go on by a frame as soon as the one before is shown, or stop."""
        with self._changed:
            self.due_s = time.monotonic() if on else math.inf
            self._changed.notify_all()

    def settle(self) -> None:
        """Return when the newest wish has been carried out, or the session is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or not (self._waiting or self._busy))

    def close(self) -> None:
        """Leave what is being done, end the thread, and free the device's memory."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()
        for imager in self._imagers.values():
            imager.close()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                while not (self._closed or self._waiting):
                    left_s = self.due_s - time.monotonic()
                    if left_s > 0:
                        self._changed.wait(None if math.isinf(left_s) else left_s)
                        continue
                    self.due_s = time.monotonic() + 1 / PLAYED_HZ
                    self.step(1)
                if self._closed:
                    return
                self._waiting, self._busy, wish = False, True, self.wish
            try:
                self._carry_out(wish)
            except Outdated:
                continue
            except ClradarError as error:
                self.refused = str(error)
            except MemoryError:
                self.refused = "not enough memory"
            except Exception as error:  # of a library, say: it must be seen, and not end the thread
                self.refused = f"{type(error).__name__}: {error}"
            else:
                self.refused = ""
                continue
            self._front.refuse(self.refused)

    def _check(self, *_: int) -> None:
        """Leave work that is outdated; the progress callback of images."""
        if self._waiting or self._closed:
            raise Outdated

    def _carry_out(self, wish: Wish) -> None:
        content = self._read(wish.frame)
        if self._beside is not None:  # which is compared with it
            wish = replace(wish, quick=False)
        if isinstance(content, Capture) and wish.grid is None:
            wish = replace(wish, grid=live_grid(place_grid(content, device=self._device)))
            with self._changed:  # unless a grid has been wished for meanwhile
                if self.wish.grid is None:
                    self.wish = replace(self.wish, grid=wish.grid)
        image, self._prepared = content, False
        if isinstance(content, Capture):
            image = self._imaged(wish, (wish.frame,), lambda: content)
        first = self._drawn(image, wish.dynamic_range_db, wish.voxels)
        second = self._second(wish, content, first)
        metrics = None if second is None else self._metrics(first, second)
        self._show(Shown(wish, content, first, second, metrics, self._prepared))

    def _show(self, shown: Shown) -> None:
        self._front.show(shown)
        self.shown = shown

    def _second(self, wish: Wish, content: Content, first: Drawn) -> Drawn | None:
        if self._beside is None or first.volume is None:
            return None
        wish = replace(wish, grid=first.volume.grid)
        found = self._beside.of(wish, content)
        if found is None:
            return None
        key, make = found
        doing = "simulating" if self._beside.simulates else "reading"

        def progress(done: int, total: int) -> None:
            self._check()
            self._front.busy(f"{doing}, {100 * done // max(total, 1)} %")

        def made() -> Content:
            # What is there is shown while the second one is being made.
            self._show(Shown(wish, content, first))
            self._front.busy(doing)
            return make(progress)

        image = self._imaged(wish, ("beside", *key), made)
        return self._drawn(image, wish.dynamic_range_db, wish.voxels, second=True)

    def _imaged(
        self, wish: Wish, key: tuple[Hashable, ...], made: Callable[[], Content]
    ) -> Volume | Flat:
        """Return an image that is kept under a key and the wish's settings, or of what is made.

        Those used last are kept, within `KEPT_BYTES`.
        """
        key += _image_key(wish)
        image = self._images.pop(key, None)
        if image is None:
            content = made()
            if isinstance(content, Capture):
                self._front.busy("imaging")
                content = self._formed(content, wish, self._check)
            image = content
        self._images[key] = image
        while len(self._images) > 1 and sum(map(_bytes, self._images.values())) > KEPT_BYTES:
            del self._images[next(iter(self._images))]
        return image

    def _formed(self, capture: Capture, wish: Wish, progress: Progress) -> Volume:
        """Return the image of a capture on the wish's grid: the bits of `backproject`.

        Two imagers are kept: one of each of two images.
        """
        assert wish.grid is not None
        array, waveform = capture.array, capture.waveform
        radar = (array.tx_m.tobytes(), array.rx_m.tobytes(), waveform.frequencies_hz.tobytes())
        key = radar + _image_key(wish)
        imager = self._imagers.pop(key, None)
        if imager is None:
            while len(self._imagers) > 1:
                self._imagers.pop(next(iter(self._imagers))).close()
            imager = FrameImager(
                array, waveform, wish.grid, method=wish.method, window=wish.window,
                tolerance_db=wish.image_db, device=self._device,
            )  # fmt: skip
            self._prepared = True
        self._imagers[key] = imager
        imager.form(capture, progress)
        return imager.volume()


def _metrics(first: Drawn, second: Drawn) -> Metrics | None:
    with suppress(ClradarError):  # other pixels, or nothing to be seen
        return metrics_of(first.image, second.image, first.image.dynamic_range_db)
    return None


def _image_key(wish: Wish) -> tuple[Hashable, ...]:
    settings, grid = (wish.method, wish.window, wish.image_db), wish.grid
    if grid is None:
        return settings
    return (*settings, *grid.origin_m.tolist(), *grid.spacing_m.tolist(), *grid.counts)


def _bytes(image: Volume | Flat) -> int:
    return image.data.nbytes if isinstance(image, Volume) else image.image.depth_m.nbytes
