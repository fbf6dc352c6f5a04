"""The state of a view: what is wished, carried out in the background, and what is then shown."""

from __future__ import annotations

import threading
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from clradar.backproject import backproject
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import ClradarError
from clradar.imaging.placement import place_grid
from clradar.model import Capture, Volume, VoxelGrid
from clradar.opencl import Device
from clradar.view.grids import live_grid
from clradar.view.newest_wish import NewestWish, Outdated
from clradar.view.pictures import Cloud, Picture, picture_of, voxels_of
from clradar.view.sources import Source

KEPT_BYTES = 512 * 2**20
"""Of images: 150 frames of 101 x 101 x 41 voxels, so that a recording plays from memory."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is to be shown.

    Attributes
    ----------
    frame : int
        Its number in the source.
    grid : VoxelGrid or None
        Of images of captures. None: one that shows the object of the first of them (`live_grid`).
        Volumes have theirs.
    method, window : str
        As `clradar.backproject` takes them.
    dynamic_range_db : float, decibel
    voxels : bool
        Show voxels instead of depth points.
    """

    frame: int = 0
    grid: VoxelGrid | None = None
    method: str = "fast"
    window: str = "rect"
    dynamic_range_db: float = DYNAMIC_RANGE_DB
    voxels: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A wish that was carried out: its image, what is drawn of it, and the points or voxels."""

    wish: Wish
    volume: Volume
    picture: Picture
    cloud: Cloud
    content: Capture | Volume


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
    """

    def __init__(
        self,
        source: Source,
        wish: Wish,
        front: Front,
        device: Device | None = None,
        form: Callable[..., Volume] = backproject,
    ) -> None:
        self.source = source
        self._wish, self._front, self._device, self._form = wish, front, device, form
        self._lock = threading.Lock()
        self._content: tuple[int, Capture | Volume] | None = None
        self._images = _Images()
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
            volume = self._imaged(wish, content, check)
            picture = picture_of(volume, wish.dynamic_range_db)
            cloud = voxels_of(volume, wish.dynamic_range_db) if wish.voxels else picture.cloud
            self._front.show(Shown(wish, volume, picture, cloud, content))
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

    def _imaged(self, wish: Wish, content: Capture | Volume, check: Callable[[], None]) -> Volume:
        if isinstance(content, Volume):
            return content
        assert wish.grid is not None
        key = _key(wish)
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


def _key(wish: Wish) -> tuple[Any, ...]:
    grid = wish.grid
    assert grid is not None
    ends = (*grid.origin_m.tolist(), *grid.spacing_m.tolist(), *grid.counts)
    return (wish.frame, wish.method, wish.window, *ends)


class _Images:
    """Images that were formed, the last used ones within `KEPT_BYTES`."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[Any, ...], Volume] = OrderedDict()
        self._bytes = 0

    def get(self, key: tuple[Any, ...]) -> Volume | None:
        if key in self._kept:
            self._kept.move_to_end(key)
        return self._kept.get(key)

    def keep(self, key: tuple[Any, ...], volume: Volume) -> None:
        self._kept[key] = volume
        self._bytes += volume.data.nbytes
        while self._bytes > KEPT_BYTES and len(self._kept) > 1:
            _, dropped = self._kept.popitem(last=False)
            self._bytes -= dropped.data.nbytes
