"""Wishes of the live view: the newest wins, errors are said, what was imaged is kept."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import clradar
from clradar.errors import MeasurementError
from clradar.imaging.frame_imager import FrameImager
from clradar.view.playing import Player
from clradar.view.session import Session, Shown, View
from clradar.view.sources import FixedFrames
from clradar.view.wish import QUICK_DB, Wish

GRID = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (2, 2, 2))


def capture(samples: float = 1.0) -> clradar.Capture:
    array = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]])
    waveform = clradar.Waveform([76e9, 77e9, 78e9])
    return clradar.Capture(np.full((2, 1, 3), samples), array, waveform)


class Record:
    """A front that keeps what it is told."""

    def __init__(self) -> None:
        self.shown: list[Wish] = []
        self.refused: list[str] = []

    def show(self, shown: Shown) -> None:
        self.shown.append(shown.wish)

    def busy(self, text: str) -> None:
        pass

    def refuse(self, text: str) -> None:
        self.refused.append(text)


class SlowImager:
    """Forms an image once it is let, unless the progress callback ends it."""

    def __init__(self) -> None:
        self.started, self.let = threading.Semaphore(0), threading.Semaphore(0)
        self.begun = self.done = 0

    def __call__(self, content: Any, wish: Wish, progress: Any) -> clradar.Volume:
        self.begun += 1
        self.started.release()
        self.let.acquire()
        progress(1, 2)
        self.done += 1
        assert wish.grid is not None
        return clradar.Volume(np.ones(wish.grid.shape), wish.grid)


@contextmanager
def session_of(read: Callable[[int], Any], form: Any) -> Iterator[tuple[Session, Record]]:
    front = Record()
    labels = tuple(f"frame {i}" for i in range(5))
    session = Session(
        View(source=FixedFrames("rec", labels, read), wish=Wish(grid=GRID)), front, form=form
    )
    try:
        yield session, front
    finally:
        session.close()


def test_the_newest_wish_wins_and_ends_the_one_before() -> None:
    form = SlowImager()
    with session_of(lambda _: capture(), form) as (session, front):
        session.change(frame=1)
        form.started.acquire()  # being imaged now
        for frame in (2, 3, 4):
            session.change(frame=frame)
        form.let.release(2)
        session.settle()
    assert [wish.frame for wish in front.shown] == [4]
    assert (form.begun, form.done) == (2, 1)  # frame 1 was left, 2 and 3 never begun


def test_an_image_is_formed_once_and_the_dynamic_range_forms_none() -> None:
    form = SlowImager()
    form.let.release(9)
    with session_of(lambda _: capture(), form) as (session, front):
        for changes in ({"frame": 0}, {"frame": 1}, {"frame": 0}, {"dynamic_range_db": 30.0}):
            session.change(**changes)
            session.settle()
        assert form.done == 2
        session.change(window="hann")
        session.settle()
        assert form.done == 3
    assert [wish.frame for wish in front.shown] == [0, 1, 0, 0, 0]


def test_a_frame_that_cannot_be_read_is_said_and_the_next_one_is_shown() -> None:
    def read(frame: int) -> clradar.Capture:
        if frame == 2:
            raise MeasurementError("000002.npy: expected a frame, got noise")
        return capture()

    form = SlowImager()
    form.let.release(9)
    with session_of(read, form) as (session, front):
        for frame in (2, 3):
            session.change(frame=frame)
            session.settle()
    assert front.refused == ["000002.npy: expected a frame, got noise"]
    assert [wish.frame for wish in front.shown] == [3]


def test_closing_ends_what_is_being_imaged() -> None:
    form = SlowImager()
    with session_of(lambda _: capture(), form) as (session, front):
        session.change()
        form.started.acquire()
        closing = threading.Thread(target=session.close)
        closing.start()
        session.settle()  # returns once it is closed
        form.let.release()
        closing.join()
    assert not front.shown


def test_playing_waits_for_every_frame_and_stops() -> None:
    enough = threading.Event()

    class Steps:
        events: tuple[str, ...] = ()

        def step(self, by: int) -> None:
            self.events += ("step",)

        def settle(self) -> None:
            self.events += ("settle",)
            if len(self.events) >= 8:
                enough.set()

    steps = Steps()
    source = FixedFrames("frames", ("0", "1"), lambda _: capture())
    ignore: Any = lambda _: None  # noqa: E731
    player = Player(steps, source, ignore, ignore, ignore)  # type: ignore[arg-type]
    player.per_second = 1e6
    player.start()
    player.play(True)
    enough.wait()
    player.play(False)
    player.close()
    assert steps.events == ("step", "settle") * (len(steps.events) // 2)


def test_frames_that_come_and_go_are_stepped_through_by_their_numbers() -> None:
    class Growing:
        name, grows = "folder", True
        there: tuple[int, ...] = ()

        def frames(self) -> tuple[int, ...]:
            return self.there

        def label(self, frame: int) -> str:
            return f"file {frame}"

        def read(self, frame: int) -> clradar.Capture:
            return capture()

    form, front = SlowImager(), Record()
    form.let.release(9)
    source = Growing()
    session = Session(View(source=source, wish=Wish(frame=3, grid=GRID)), front, form=form)
    for there, by in (((3, 7, 9), 1), ((3, 9, 11), 1), ((3, 11), -1), ((), 1)):
        source.there = there
        session.step(by)
        session.settle()
    session.close()
    assert [wish.frame for wish in front.shown] == [7, 9, 3]


@pytest.mark.device
def test_captures_without_a_grid_get_one_that_shows_them() -> None:
    form, front = SlowImager(), Record()
    form.let.release(9)
    empty = capture(0.0)  # with echoes there would be a warning of too few frequencies
    session = Session(
        View(source=FixedFrames("c", ("c",), lambda _: empty), wish=Wish()), front, form=form
    )
    session.change()
    session.settle()
    placed = session.wish.grid
    session.close()
    assert placed is not None
    assert front.shown[0].grid is placed


class Counting(Record):
    """A front whose player counts what it shows."""

    player: Player

    def show(self, shown: Shown) -> None:
        super().show(shown)
        self.player.shown(shown)


class Following:
    """A source of which each look finds another frame."""

    name, grows = "rec", True

    def __init__(self) -> None:
        self.there = 0
        self.comes = True

    def frames(self) -> tuple[int, ...]:
        return tuple(range(self.there))

    def label(self, frame: int) -> str:
        return f"frame {frame}"

    def read(self, frame: int) -> clradar.Capture:
        return capture()

    def look(self) -> bool:
        self.there += self.comes
        return self.comes

    def came_s(self, frame: int) -> float:
        return 0.0


@pytest.mark.parametrize("ended_by", ["quiet", "choice", "stop"])
def test_followed_frames_are_imaged_quickly_and_the_last_one_accurately(
    ended_by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[float | None] = []

    class Imager(FrameImager):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            made.append(kwargs["tolerance_db"])
            super().__init__(*args, **kwargs)

    monkeypatch.setattr("clradar.view.session.FrameImager", Imager)
    source = Following()
    front = Counting()
    session = Session(View(source=source, wish=Wish(frame=-1, grid=GRID)), front)
    front.player = player = Player(
        session, source, lambda _: None, lambda _: None, front.refused.append
    )
    try:
        for _ in range(2):
            player.look(source)
            session.settle()
        assert [wish.quick for wish in front.shown] == [True, True]
        assert made == [QUICK_DB]
        source.comes = False
        if ended_by == "quiet":
            monkeypatch.setattr("clradar.view.playing.QUIET_S", 0.0)
            player.look(source)
        elif ended_by == "choice":
            player.chosen()
        else:
            player.play(False)
        session.settle()
        player.look(source)
        session.settle()
    finally:
        session.close()
    assert [(wish.frame, wish.quick) for wish in front.shown] == [(0, True), (1, True), (1, False)]
    assert made == [QUICK_DB, None]
    assert not front.refused


def test_a_frame_that_is_chosen_while_a_quick_image_is_made_is_imaged_accurately():
    source, front, form = Following(), Counting(), SlowImager()
    session = Session(View(source=source, wish=Wish(frame=-1, grid=GRID)), front, form=form)
    front.player = player = Player(session, source, lambda _: None, lambda _: None, print)
    player.look(source)
    form.started.acquire()  # none has been shown yet
    player.chosen()
    session.change(frame=0)
    form.let.release(2)
    session.settle()
    session.close()
    assert [(wish.frame, wish.quick) for wish in front.shown] == [(0, False)]
