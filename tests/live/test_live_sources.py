"""Frames from folders, recordings and streams: damaged, half-written, too fast, cut off."""

from __future__ import annotations

import json
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import clradar
from clradar.errors import MeasurementError, ModelError
from clradar.live import open_source, replay, wire
from clradar.live.inbox import Arrived, Inbox
from clradar.live.sources import StreamSource, parsed_address, started
from measurement_io import open_recording, save_capture, save_recording

WAVEFORM = clradar.Waveform.sfcw(72e9, 82e9, 3)
QAR50 = clradar.arrays.qar50()
SMALL = clradar.AntennaArray(QAR50.tx_m[::20], QAR50.rx_m[::20], "small")
HELLO = wire.Hello(SMALL, WAVEFORM)


def frame(value: complex, array: clradar.AntennaArray = SMALL) -> clradar.Capture:
    data = np.full((array.n_tx, array.n_rx, WAVEFORM.n_freq), value, np.complex64)
    return clradar.Capture(data, array, WAVEFORM)


def value_of(arrived: Arrived | None) -> complex:
    assert arrived is not None
    return complex(arrived.capture.data[0, 0, 0])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames, 20 ms apart."""
    path = tmp_path_factory.mktemp("recording") / "plate" / "30"
    captures = [frame(i + 1j, QAR50) for i in range(4)]
    save_recording(path, captures, timestamps_us=[0, 20_000, 40_000, 60_000])
    return path


# Streams


class Listening:
    """A stream that is listened to; the test sends."""

    def __init__(self) -> None:
        self.source = StreamSource("127.0.0.1", 0)
        self.inbox = Inbox()
        self.stop = started(self.source, self.inbox)

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.source.port))


@pytest.fixture
def listening() -> Iterator[Listening]:
    made = Listening()
    yield made
    made.stop()
    assert made.inbox.ended or made.inbox.take() is not None


def sent(number: int, value: complex) -> bytes:
    return wire.frame_head(HELLO, number, 5) + frame(value).data.tobytes()


def test_a_stream_brings_what_was_sent(listening: Listening) -> None:
    with listening.connect() as connection:
        connection.sendall(HELLO.encoded() + sent(7, 2 - 3j))
        arrived = listening.inbox.take()
    assert arrived is not None
    np.testing.assert_array_equal(arrived.capture.data, frame(2 - 3j).data)
    assert arrived.capture.array.same_positions(SMALL)
    assert arrived.capture.waveform.same_frequencies(WAVEFORM)
    assert arrived.capture.meta["frame"] == 7
    assert arrived.capture.meta["timestamp_us"] == 5
    assert arrived.label == "frame 7"


def hello_with(**changes: object) -> bytes:
    values = json.loads(HELLO.encoded()[wire.HELLO.size :])
    text = json.dumps({**values, **changes}).encode()
    return wire.HELLO.pack(wire.HELLO_MAGIC, len(text)) + text


GARBAGE = {
    "noise": (np.random.default_rng(0).bytes(5000), "begin with"),
    "http": (b"GET / HTTP/1.1\r\nHost: a\r\n\r\n", "begin with"),
    "long hello": (wire.HELLO.pack(wire.HELLO_MAGIC, 2**32 - 1), "got 4294967295"),
    "no hello": (wire.HELLO.pack(wire.HELLO_MAGIC, 0), "got 0"),
    "no JSON": (wire.HELLO.pack(wire.HELLO_MAGIC, 4) + b"\xff\x00{[", "bad hello"),
    "nested": (wire.HELLO.pack(wire.HELLO_MAGIC, 9000) + 9000 * b"[", "bad hello"),
    "another field": (hello_with(more=1), "fields"),
    "text for antennas": (hello_with(tx_m="many"), "bad hello"),
    "far antennas": (hello_with(tx_m=[[1e9, 0, 0]]), "bad hello"),
    "no frequency": (hello_with(frequencies_hz=[]), "bad hello"),
    "huge frames": (
        hello_with(
            tx_m=[[1e-4 * i, 0, 0] for i in range(4000)],
            rx_m=[[0, 1e-4 * i, 0] for i in range(4000)],
        ),
        "at most",
    ),
    "another magic": (HELLO.encoded() + b"X" + sent(0, 1)[1:], "expected a frame"),
    "another size": (
        HELLO.encoded() + wire.FRAME.pack(wire.FRAME_MAGIC, 0, 0, 2**63),
        "as the hello says",
    ),
    "cut hello": (HELLO.encoded()[:-9], "ended within"),
    "cut head": (HELLO.encoded() + sent(0, 1)[:11], "ended within"),
    "cut frame": (HELLO.encoded() + sent(0, 1)[:-1], "ended within"),
}


@pytest.mark.parametrize("kind", GARBAGE)
def test_garbage_is_one_bad_frame_and_the_next_sender_gets_its_turn(
    listening: Listening, kind: str
) -> None:
    data, reason = GARBAGE[kind]
    with listening.connect() as connection:
        connection.sendall(data)
    counts = listening.inbox.wait_for(lambda counts: counts.bad > 0)
    assert counts.bad == 1
    assert reason in counts.reason or "reset" in counts.reason
    with listening.connect() as connection:
        connection.sendall(HELLO.encoded() + sent(1, 4j))
        assert value_of(listening.inbox.take()) == 4j


def test_a_killed_sender_is_followed_by_the_next(listening: Listening) -> None:
    """The system of a killed process resets its connection, here within a frame."""
    connection = listening.connect()
    connection.sendall(HELLO.encoded() + sent(0, 1) + sent(1, 2)[:-5])
    listening.inbox.wait_for(lambda counts: counts.arrived == 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
    listening.inbox.wait_for(lambda counts: counts.bad == 1)
    with listening.connect() as connection:
        connection.sendall(HELLO.encoded() + sent(0, 3))
        listening.inbox.wait_for(lambda counts: counts.arrived == 2)
    assert value_of(listening.inbox.take()) == 3
    assert listening.inbox.counts.dropped == 1


def test_a_sender_that_falls_silent_is_let_go(
    listening: Listening, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clradar.live.sources.SILENT_S", 0.0)
    with listening.connect() as silent:
        silent.sendall(HELLO.encoded() + sent(0, 1)[:-5])
        counts = listening.inbox.wait_for(lambda counts: counts.bad == 1)
        assert "nothing complete came" in counts.reason
        monkeypatch.undo()
        with listening.connect() as connection:
            connection.sendall(HELLO.encoded() + sent(0, 3))
            assert value_of(listening.inbox.take()) == 3


def test_of_a_sender_that_is_too_fast_the_newest_frame_is_left(listening: Listening) -> None:
    with listening.connect() as connection:
        connection.sendall(HELLO.encoded())
        for number in range(200):
            connection.sendall(sent(number, number))
        counts = listening.inbox.wait_for(lambda counts: counts.arrived == 200)
    assert counts.dropped == 199
    assert value_of(listening.inbox.take()) == 199


def test_listening_ends_while_a_sender_sends_on(listening: Listening) -> None:
    with listening.connect() as connection:
        connection.sendall(HELLO.encoded())

        def send_on() -> None:
            with suppress(OSError):  # that the connection has ended
                while True:
                    connection.sendall(sent(0, 1))

        sender = threading.Thread(target=send_on)
        sender.start()
        listening.inbox.wait_for(lambda counts: counts.arrived >= 3)
        listening.stop()
        sender.join()
    assert not sender.is_alive()


def test_a_frame_that_is_not_finite_is_left_out(listening: Listening) -> None:
    with listening.connect() as connection:
        wrong = bytearray(sent(0, 1))
        wrong[-8:] = np.complex64(np.nan).tobytes()
        connection.sendall(HELLO.encoded() + wrong + sent(1, 2))
        assert value_of(listening.inbox.take()) == 2
    counts = listening.inbox.counts
    assert (counts.arrived, counts.bad) == (1, 1)
    assert "frame 0" in counts.reason


def test_a_recording_is_replayed(listening: Listening, recording: Path) -> None:
    said: list[str] = []
    read = open_recording(recording)
    n = replay(read, "127.0.0.1", listening.source.port, rate_hz=np.inf, repeats=2, say=said.append)
    assert n == 8
    listening.inbox.wait_for(lambda counts: counts.arrived == 8)
    assert value_of(listening.inbox.take()) == 3 + 1j
    assert said[-1].startswith("8 frames sent")
    with pytest.raises(ModelError, match="rate_hz"):
        replay(read, "127.0.0.1", listening.source.port, rate_hz=0)


def test_nobody_listens(recording: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(MeasurementError, match="cannot listen"):
            StreamSource("127.0.0.1", port)
    with pytest.raises(MeasurementError, match=f"127.0.0.1:{port}: 0 frames sent"):
        replay(open_recording(recording), "127.0.0.1", port)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("5555", ("127.0.0.1", 5555)),
        (":5555", ("127.0.0.1", 5555)),
        ("0.0.0.0:1", ("0.0.0.0", 1)),
        ("[::1]:7", ("::1", 7)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert parsed_address(text) == address


@pytest.mark.parametrize("text", ["", "host", "a:b", "1:65536", "1:-1", "1:²"])
def test_no_addresses(text: str) -> None:
    with pytest.raises(MeasurementError, match="expected HOST:PORT"):
        parsed_address(text)


# Recordings


def test_a_recording_is_played_to_its_end(recording: Path) -> None:
    inbox, labels = Inbox(), []
    source = open_source(str(recording))
    assert "50 frames/s" in source.words
    stop = started(source, inbox)
    while not inbox.ended:
        arrived = inbox.take()
        if arrived is not None:
            labels.append(arrived.label)
    stop()
    counts = inbox.counts
    # However slow this machine is: nothing is lost without being counted, and the last one comes.
    assert labels == sorted(set(labels))
    assert labels[-1] == "frame 3"
    assert len(labels) + counts.dropped == 4


def test_damaged_frames_of_a_recording_are_left_out(recording: Path, tmp_path: Path) -> None:
    captures = [frame(i, QAR50) for i in range(3)]
    radar = save_recording(tmp_path / "plate" / "30", captures, timestamps_us=[0, 1, 2])
    (radar / "calibrated_data" / "000001.npy").write_bytes(b"\x93NUMPY garbage")
    source, inbox = open_source(str(radar)), Inbox()
    assert "8 frames/s (no time stamps)" in source.words  # a million per second is not believed
    stop = started(source, inbox)
    values = []
    while not inbox.ended:
        arrived = inbox.take()
        values += [value_of(arrived)] if arrived is not None else []
    stop()
    assert values[-1] == 2
    assert 1 not in values


# Folders


class Watching:
    """A folder that is watched; looks are made when the test says so."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.inbox = folder, Inbox()
        self._source = open_source(str(folder))
        self._looks, self._looked = threading.Semaphore(0), threading.Semaphore(0)
        self._stop = _Steps(self._looks, self._looked)
        self._thread = threading.Thread(target=self._source.run, args=(self.inbox, self._stop))
        self._thread.start()
        self._looked.acquire()

    def look(self, n: int = 1) -> None:
        for _ in range(n):
            self._looks.release()
            self._looked.acquire()

    def close(self) -> None:
        self._stop.ended = True
        self._looks.release()
        self._thread.join()


class _Steps(threading.Event):
    """An event whose `wait` returns when the test makes a step."""

    def __init__(self, looks: threading.Semaphore, looked: threading.Semaphore) -> None:
        super().__init__()
        self._looks, self._looked, self.ended = looks, looked, False

    def wait(self, timeout: float | None = None) -> bool:
        self._looked.release()
        self._looks.acquire()
        return self.ended


@pytest.fixture
def watching(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Watching]]:
    made: list[Watching] = []

    def watch() -> Watching:
        made.append(Watching(tmp_path, monkeypatch))
        return made[-1]

    yield watch
    for one in made:
        one.close()


def test_files_are_read_when_they_are_complete(
    watching: Callable[[], Watching], tmp_path: Path
) -> None:
    save_capture(tmp_path / "whole.h5", frame(5))
    whole = (tmp_path / "whole.h5").read_bytes()
    folder = watching()
    folder.look()
    assert value_of(folder.inbox.take(0)) == 5  # the newest that was there
    growing = tmp_path / "next.h5"
    for share in (0.3, 0.6, 1.0):
        growing.write_bytes(whole[: int(share * len(whole))])
        folder.look()
        assert folder.inbox.counts.arrived == 1
    folder.look()
    assert folder.inbox.counts.arrived == 2
    # A writer that stalls: the file looks complete, is bad, and is read again when it goes on.
    growing.write_bytes(whole[:3000])
    folder.look(2)
    assert folder.inbox.counts.bad == 1
    growing.write_bytes(whole)
    folder.look(2)
    counts = folder.inbox.counts
    assert (counts.arrived, counts.bad) == (3, 1)
    # Other files are nobody's frames.
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / ".next.npy").write_bytes(b"x")
    (tmp_path / "folder.npy").mkdir()
    folder.look(3)
    assert folder.inbox.counts == counts


def test_of_many_files_at_once_the_last_is_read(
    watching: Callable[[], Watching], tmp_path: Path
) -> None:
    folder = watching()
    folder.look()
    for i in range(5):
        save_capture(tmp_path / f"{i}.h5", frame(i))
    folder.look(2)
    assert value_of(folder.inbox.take(0)) == 4
    assert folder.inbox.counts.dropped == 4


@pytest.mark.skipif(os.name == "nt", reason="a folder that is open cannot be renamed there")
def test_a_folder_that_goes_is_one_trouble_and_may_come_back(
    watching: Callable[[], Watching], tmp_path: Path
) -> None:
    folder = watching()
    folder.look()
    tmp_path.rename(tmp_path.with_name("gone"))
    folder.look(5)
    assert folder.inbox.counts.bad == 1
    tmp_path.with_name("gone").rename(tmp_path)
    save_capture(tmp_path / "a.h5", frame(6))
    folder.look(2)
    assert value_of(folder.inbox.take(0)) == 6


def test_what_is_no_source_is_refused(tmp_path: Path) -> None:
    for name in (str(tmp_path / "none"), __file__):
        with pytest.raises(MeasurementError, match="a recording, a folder, or tcp:PORT"):
            open_source(name)
