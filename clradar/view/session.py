"""The state of a view: what is wished, carried out in the background, and what is then shown."""

from __future__ import annotations

import threading
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from clradar.backproject import backproject
from clradar.errors import ClradarError
from clradar.imaging.placement import place_grid
from clradar.model import Capture, Volume
from clradar.opencl import Device
from clradar.view.beside import Beside
from clradar.view.grids import live_grid
from clradar.view.newest_wish import NewestWish, Outdated
from clradar.view.pictures import Cloud, Picture, picture_of, voxels_of
from clradar.view.sources import Source
from clradar.view.wish import Wish

KEPT_BYTES = 512 * 2**20
"""Of images: 150 frames of 101 x 101 x 41 voxels, so that a recording plays from memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A volume, its depth map, and its points or voxels."""

    volume: Volume
    picture: Picture
    cloud: Cloud

    @classmethod
    def of(cls, volume: Volume, wish: Wish, second: bool = False) -> Drawn:
        """Return what is drawn of a volume."""
        picture = picture_of(volume, wish.dynamic_range_db, second)
        cloud = picture.cloud
        if wish.voxels:
            cloud = voxels_of(volume, wish.dynamic_range_db, second=second)
        return cls(volume, picture, cloud)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A wish that was carried out: what was read, and what is drawn of it and beside it."""

    wish: Wish
    content: Capture | Volume
    first: Drawn
    second: Drawn | None = None

    @property
    def chosen(self) -> Drawn:
        """The one whose images are shown."""
        if self.second is not None and self.wish.side == "simulated":
            return self.second
        return self.first


class Front(Protocol):
    """What a session shows its results with; called from the session's thread."""

    def show(self, shown: Shown) -> None:
        """Draw a result."""

    def busy(self, words: str) -> None:
        """Say what is being done."""

    def refuse(self, words: str) -> None:
        """Say why a wish cannot be carried out; what is shown stays."""


class Session:
    """Reads and images frames in a thread of its own, the newest wish alone.

    Parameters
    ----------
    source : Source
    wish : Wish
        The first one.
    front : Front
    device : Device or None
    form : callable
        As `clradar.backproject`.
    beside : Beside or None
        What is shown as second image.
    """

    def __init__(
        self,
        source: Source,
        wish: Wish,
        front: Front,
        device: Device | None = None,
        form: Callable[..., Volume] = backproject,
        beside: Beside | None = None,
    ) -> None:
        self.source = source
        self._beside = beside
        self._wish, self._front, self._device, self._form = wish, front, device, form
        self._lock = threading.Lock()
        self._content: tuple[int, Capture | Volume] | None = None
        self._images = _Images()
        self._last_drawn: dict[bool, tuple[tuple[Volume, float, bool], Drawn]] = {}
        self._work = NewestWish(self._carry_out)

    @property
    def wish(self) -> Wish:
        """The newest wish."""
        return self._wish

    def change(self, **changes: Any) -> None:
        """Wish for something else; the fields are those of `Wish`."""
        with self._lock:
            self._wish = replace(self._wish, **changes)
            self._work.wish(self._wish)

    def step(self, by: int) -> None:
        """Go on by some frames, around the end."""
        frames = self.source.frames()
        if not frames:
            return
        with self._lock:
            now = self._wish.frame  # which may be gone
            at = bisect_right(frames, now) - 1 if by > 0 else bisect_left(frames, now)
            self._wish = replace(self._wish, frame=frames[(at + by) % len(frames)])
            self._work.wish(self._wish)

    def settle(self) -> None:
        """Return when the newest wish has been carried out, or the session is closed."""
        self._work.settle()

    def close(self) -> None:
        """End the thread."""
        self._work.close()

    def _carry_out(self, wish: Wish, check: Callable[[], None]) -> None:
        try:
            content = self._read(wish.frame)
            if isinstance(content, Capture) and wish.grid is None:
                wish = self._placed(wish, content)
            key = (wish.frame, *_image_key(wish))
            volume = self._imaged(wish, content, key, check)
            first = self._drawn(volume, wish)
            second = self._second(wish, content, first, check)
            self._front.show(Shown(wish, content, first, second))
        except Outdated:
            raise
        except ClradarError as error:
            self._front.refuse(str(error))
        except MemoryError:
            self._front.refuse("not enough memory")
        except Exception as error:  # of a library, say: it must be seen, and not end the thread
            self._front.refuse(f"{type(error).__name__}: {error}")

    def _read(self, frame: int) -> Capture | Volume:
        if self._content is None or self._content[0] != frame:
            self._content = (frame, self.source.read(frame))
        return self._content[1]

    def _placed(self, wish: Wish, capture: Capture) -> Wish:
        grid = live_grid(place_grid(capture, device=self._device))
        with self._lock:  # unless a grid has been wished for meanwhile
            if self._wish.grid is None:
                self._wish = replace(self._wish, grid=grid)
        return replace(wish, grid=grid)

    def _second(
        self, wish: Wish, content: Capture | Volume, first: Drawn, check: Callable[[], None]
    ) -> Drawn | None:
        beside = None if self._beside is None else self._beside.key(wish, content)
        if self._beside is None or beside is None:
            return None
        wish = replace(wish, grid=first.volume.grid)
        key = ("beside", beside, *_image_key(wish))
        volume = self._images.get(key)
        if volume is None:
            # What is there is shown while the second one is being made.
            self._front.show(Shown(wish, content, first))
            words = "simulating" if self._beside.simulates else "reading"
            self._front.busy(words)

            def progress(done: int, total: int) -> None:
                check()

            other = self._beside.of(wish, content, progress)
            volume = self._imaged(wish, other, key, check)
            if isinstance(other, Volume):
                self._images.keep(key, volume)
        return self._drawn(volume, wish, second=True)

    def _drawn(self, volume: Volume, wish: Wish, second: bool = False) -> Drawn:
        """Return what is drawn of a volume: the same object as before, where it would be equal."""
        key = (volume, wish.dynamic_range_db, wish.voxels)
        last = self._last_drawn.get(second)
        if last is None or last[0][0] is not volume or last[0][1:] != key[1:]:
            self._last_drawn[second] = last = (key, Drawn.of(volume, wish, second))
        return last[1]

    def _imaged(
        self,
        wish: Wish,
        content: Capture | Volume,
        key: tuple[Hashable, ...],
        check: Callable[[], None],
    ) -> Volume:
        if isinstance(content, Volume):
            return content
        found = self._images.get(key)
        if found is not None:
            return found
        self._front.busy("imaging")

        def progress(done: int, total: int) -> None:
            check()

        # The grid was placed or typed here: warnings about it would come with every frame.
        volume = self._form(
            content, wish.grid, method=wish.method, window=wish.window, check_grid=False,
            device=self._device, progress=progress,
        )  # fmt: skip
        self._images.keep(key, volume)
        return volume


def _image_key(wish: Wish) -> tuple[Hashable, ...]:
    grid = wish.grid
    if grid is None:  # of a volume, which is not kept
        return ()
    ends = (*grid.origin_m.tolist(), *grid.spacing_m.tolist(), *grid.counts)
    return (wish.method, wish.window, *ends)


class _Images:
    """Images that were formed, the last used ones within `KEPT_BYTES`."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[Hashable, ...], Volume] = OrderedDict()
        self._bytes = 0

    def get(self, key: tuple[Hashable, ...]) -> Volume | None:
        if key in self._kept:
            self._kept.move_to_end(key)
        return self._kept.get(key)

    def keep(self, key: tuple[Hashable, ...], volume: Volume) -> None:
        self._kept[key] = volume
        self._bytes += volume.data.nbytes
        while self._bytes > KEPT_BYTES and len(self._kept) > 1:
            _, dropped = self._kept.popitem(last=False)
            self._bytes -= dropped.data.nbytes
