"""Wishes of the live view: the newest wins, errors are said, and what is shown beside an image."""

import threading
from dataclasses import replace
from typing import Any

import pytest
from fronts import GRID, SlowImager, capture, changed, frames, session_of, volume

import clradar
from clradar.errors import ClradarError, MeasurementError
from clradar.imaging.frame_imager import FrameImager
from clradar.view import beside, server
from clradar.view.beside import recorded, simulated
from clradar.view.sources import Source
from clradar.view.wish import BY_ALPHA, QUICK_DB, Wish
from measurement_io import open_recording, save_recording

CAPTURES = frames(*[capture()] * 5)


def test_the_newest_wish_wins_and_ends_the_one_before():
    form = SlowImager()
    with session_of(CAPTURES, form=form) as (session, front):
        session.change(frame=1)
        form.started.acquire()  # being imaged now
        for frame in (2, 3, 4):
            session.change(frame=frame)
        form.let.release(2)
        session.settle()
    assert [wish.frame for wish in front.wishes] == [4]
    assert (form.begun, form.done) == (2, 1)  # frame 1 was left, 2 and 3 never begun


def test_an_image_is_formed_once_and_the_dynamic_range_forms_none():
    form = SlowImager(let=9)
    with session_of(CAPTURES, form=form) as (session, front):
        changed(session, {"frame": 0}, {"frame": 1}, {"frame": 0}, {"dynamic_range_db": 30.0})
        assert form.done == 2
        changed(session, {"window": "hann"})
        assert form.done == 3
    assert [wish.frame for wish in front.wishes] == [0, 1, 0, 0, 0]


def test_a_frame_that_cannot_be_read_is_said_and_the_next_one_is_shown():
    def read(frame):
        if frame == 2:
            raise MeasurementError("000002.npy: expected a frame, got noise")
        return capture()

    source = Source("rec", tuple("01234"), read)
    with session_of(source, form=SlowImager(let=9)) as (session, front):
        changed(session, {"frame": 2}, {"frame": 3})
    assert front.said == ["000002.npy: expected a frame, got noise"]
    assert [wish.frame for wish in front.wishes] == [3]


def test_closing_ends_what_is_being_imaged():
    form = SlowImager()
    with session_of(CAPTURES, form=form) as (session, front):
        session.change()
        form.started.acquire()
        closing = threading.Thread(target=session.close)
        closing.start()
        session.settle()  # returns once it is closed
        form.let.release()
        closing.join()
    assert not front.shown


class Following(Source):
    """A source of which each look finds another frame."""

    grows = comes = True
    there: tuple[int, ...] = ()

    def frames(self):
        return self.there

    def read(self, frame):
        return capture()

    def look(self):
        if self.comes:
            self.there += (len(self.there),)
        return self.comes


def test_frames_that_come_and_go_are_stepped_through_by_their_numbers():
    source = Following("rec")
    with session_of(source, Wish(frame=3, grid=GRID), form=SlowImager(let=9)) as (session, front):
        for there, by in (((3, 7, 9), 1), ((3, 9, 11), 1), ((3, 11), -1), ((), 1)):
            source.there = there
            session.step(by)
            session.settle()
    assert [wish.frame for wish in front.wishes] == [7, 9, 3]


@pytest.mark.device
def test_captures_without_a_grid_get_one_that_shows_them():
    empty = frames(capture(0.0))  # with echoes there would be a warning of too few frequencies
    with session_of(empty, Wish(), form=SlowImager(let=9)) as (session, front):
        changed(session, {})
        assert session.wish.grid is not None
        assert front.wishes[0].grid is session.wish.grid


@pytest.mark.parametrize("ended_by", ["quiet", "choice", "stop"])
def test_followed_frames_are_imaged_quickly_and_the_last_one_accurately(ended_by, monkeypatch):
    made: list[float | None] = []

    class Imager(FrameImager):
        def __init__(self, *args, **kwargs):
            made.append(kwargs["tolerance_db"])
            super().__init__(*args, **kwargs)

    monkeypatch.setattr("clradar.view.session.FrameImager", Imager)
    source = Following("rec")
    with session_of(source, Wish(frame=-1, grid=GRID)) as (session, front):

        def look():
            session.look()
            session.settle()

        look()
        look()
        assert [wish.quick for wish in front.wishes] == [True, True]
        assert made == [QUICK_DB]
        source.comes = False
        if ended_by == "quiet":
            monkeypatch.setattr("clradar.view.playing.QUIET_S", 0.0)
            session.look()
        elif ended_by == "choice":
            session.chosen()
        else:
            session.play(False)
        session.settle()
        look()
    found = [(wish.frame, wish.quick) for wish in front.wishes]
    assert found == [(0, True), (1, True), (1, False)]
    assert made == [QUICK_DB, None]
    assert not front.said


def test_a_frame_that_is_chosen_while_a_quick_image_is_made_is_imaged_accurately():
    source, form = Following("rec"), SlowImager()
    with session_of(source, Wish(frame=-1, grid=GRID), form=form) as (session, front):
        session.look()
        form.started.acquire()  # none has been shown yet
        session.chosen()
        session.change(frame=0)
        form.let.release(2)
        session.settle()
    assert [(wish.frame, wish.quick) for wish in front.wishes] == [(0, False)]


MESH = clradar.Scene([[0, 0, 0.3], [0.01, 0, 0.3], [0, 0.01, 0.3]], [[0, 1, 2]])


def test_a_recording_of_as_many_frames_goes_along():
    measured = frames(*map(volume, (1, 2, 3)))
    along, one = frames(*map(volume, (4, 5, 6)), name="along"), frames(volume(7), name="one")
    others = recorded(measured, (along, one))
    assert others.labels == ("along", "one")
    with session_of(measured, Wish(), others) as (session, front):
        changed(session, {"frame": 2}, {"frame": 1}, {"other": 1})
    pairs = [
        tuple(float(one.image.amplitude.max()) for one in (shown.first, shown.second))
        for shown in front.shown
        if shown.second is not None
    ]
    assert pairs == [(3, 6), (2, 5), (2, 7)]


def test_a_mesh_is_simulated_once_for_each_alpha_and_material(monkeypatch):
    asked: list[tuple[Any, ...]] = []

    def simulate(scene, *_, estimator, **more):
        if float(scene.alpha[0]) == 0.9:
            raise clradar.errors.DeviceError("out of memory")
        asked.append((float(scene.alpha[0]), scene.materials[0].name, estimator))
        return capture()

    monkeypatch.setattr(beside, "simulate", simulate)
    form = SlowImager(let=99)
    with session_of(CAPTURES, None, simulated(MESH), form=form) as (session, front):
        changed(session, {}, {"frame": 1}, {"alpha": 0.2}, {"alpha": 0.5}, {"material": "palm"})
        changed(session, {"alpha": 0.7}, {"material": BY_ALPHA, "alpha": 0.9})
    assert asked == [
        (0.5, "perfect conductor", None),
        (0.2, "perfect conductor", None),
        (0.5, "palm", "physical"),
    ]
    # The measured image is there while the first one is simulated, and when it cannot be.
    assert [shown.second is None for shown in front.shown][:2] == [True, False]
    assert front.shown[-1].second is None
    assert front.said[-1] == "out of memory"


def test_arrays_of_other_gains_are_simulated_for_themselves():
    simulation, own = simulated(MESH), capture()
    arrays = [
        own.array,
        replace(own.array, tx_gain=[0.5] * 2),
        replace(own.array, tx_boresight=[[0.1, 0, 1]] * 2),
        replace(own.array, tx_pattern=clradar.AntennaPattern(exponent=1.0)),
    ]
    keys = {simulation.of(Wish(), replace(own, array=array))[0] for array in arrays}
    assert len(keys) == len(arrays)
    assert simulation.of(Wish(), volume()) is None  # which does not say what radar recorded it


def test_python_shows_a_capture_a_list_or_a_recording_that_is_not_read(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(server, "serve", lambda view, port: seen.append(view.source))
    of_five = replace(capture(), meta={"frame": 5})
    radar = save_recording(tmp_path / "plate" / "30", [capture(), capture(2.0)])
    recording = open_recording(radar)
    (radar / "calibrated_data" / "000000.npy").write_bytes(b"damaged")
    for given in (of_five, [volume(), of_five], recording):
        clradar.view.show(given)
    labels = [[source.label(frame) for frame in source.frames()] for source in seen]
    assert labels == [["frame 5"], ["frame 0", "frame 5"], ["frame 0", "frame 1"]]
    assert (seen[2].read(1).data == 2.0).all()


@pytest.mark.parametrize(
    ("given", "words"),
    [({"frames": [3]}, "frames: expected a Capture or Volume, got int"),
     ({"frames": []}, "one frame, got none"), ({"method": "fst"}, "show: method"),
     ({"window": "flat"}, "show: window")],
    ids=["numbers", "nothing", "method", "window"],
)  # fmt: skip
def test_python_shows_nothing_else(given, words):
    with pytest.raises(ClradarError, match=words):
        clradar.view.show(**{"frames": [capture()], **given})
