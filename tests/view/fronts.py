"""Fronts of the view that keep what they are told, and sessions of them."""

import threading
from contextlib import contextmanager

import numpy as np

import clradar
from clradar.view.playing import Player
from clradar.view.session import Front as Told, Shown, View
from clradar.view.sources import Source
from clradar.view.wish import Wish

GRID = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (4, 3, 2))
ARRAY = clradar.AntennaArray([[-0.1, 0, 0], [0.1, 0, 0]], [[0, 0.1, 0]])


def volume(amplitude=1.0):
    return clradar.Volume(np.full(GRID.shape, amplitude, np.complex64), GRID)


def capture(samples=1.0):
    waveform = clradar.Waveform([76e9, 77e9, 78e9])
    return clradar.Capture(np.full((2, 1, 3), samples), ARRAY, waveform)


def frames(*contents, name="rec"):
    labels = tuple(f"{name} {i}" for i in range(len(contents)))
    return Source(name, labels, contents.__getitem__)


class Front(Told):
    """What is shown and said."""

    def __init__(self):
        self.shown: list[Shown] = []
        self.said: list[str] = []
        self.followed: list[bool] = []

    def show(self, shown):
        self.shown.append(shown)

    def following(self, on):
        self.followed.append(on)

    def refuse(self, text):
        self.said.append(text)

    wishes = property(lambda self: [shown.wish for shown in self.shown])


class SlowImager:
    """Forms an image once it is let, unless the progress callback ends it."""

    def __init__(self, let=0):
        self.started, self.let = threading.Semaphore(0), threading.Semaphore(let)
        self.begun = self.done = 0

    def __call__(self, content, wish, progress):
        self.begun += 1
        self.started.release()
        self.let.acquire()
        progress(1, 2)
        self.done += 1
        return clradar.Volume(np.ones(wish.grid.shape), wish.grid)


@contextmanager
def session_of(source, wish=None, beside=None, form=None):
    """A session with what its front is told."""
    front = Front()
    wish = Wish(grid=GRID) if wish is None else wish
    session = Player(View(source=source, wish=wish, beside=beside), front)
    session._formed = form or session._formed
    try:
        yield session, front
    finally:
        session.close()


def changed(session, *wishes):
    """Change what is wished, and wait each time until it is there."""
    for changes in wishes:
        session.change(**changes)
        session.settle()
