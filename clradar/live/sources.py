"""Where frames come from: a folder that is written, a recording, or a stream by TCP."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Protocol

import numpy as np

from clradar.errors import ClradarError, MeasurementError
from clradar.files.failures import fail
from clradar.files.watched_folder import WatchedFolder, visible
from clradar.live import wire
from clradar.live.inbox import Arrived, Inbox
from clradar.live.schedule import schedule_of
from measurement_io import Recording, open_capture, open_recording
from measurement_io.maroon.folders import FRAMES_FOLDER, find_radar_folder

SCHEME = "tcp:"
HOST = "127.0.0.1"

LOOK_S = 0.02
"""Between two looks into a folder; a file is complete when it has not changed in between."""

SUFFIXES = (".npy", ".h5", ".hdf5")
"""Of files in a folder that are frames."""

SILENT_S = 10.0
"""A sender that says nothing for so long, or does not finish a frame, has vanished: the next one
gets its turn."""

POLL_S = 0.2
"""How often a source that waits looks whether it is to stop."""


class Source(Protocol):
    """Brings frames into an inbox until it ends or is to stop."""

    words: str
    """What it is, for the line on the screen."""

    def run(self, inbox: Inbox, stop: threading.Event) -> None:
        """Bring frames; called in a thread of its own. Errors of frames go to the inbox."""


def open_source(name: str, *, variant: str = "raw", watch: bool = False) -> Source:
    """Return the source of a name.

    Parameters
    ----------
    name : str
        "tcp:PORT" or "tcp:HOST:PORT", to listen there; a recording, to be played at its own rate;
        any other folder, to wait for the files that are written into it.
    variant : {"raw", "emptyfiltered"}
        Of a recording's frames.
    watch : bool
        Wait for files also in a folder that is a recording.

    Raises
    ------
    MeasurementError
        No such folder, a port that is none or is in use.
    """
    if name.startswith(SCHEME):
        host, port = parsed_address(name[len(SCHEME) :].removeprefix("//"))
        return StreamSource(host, port)
    path = Path(name)
    expected = f"a recording, a folder, or {SCHEME}PORT"
    if not path.is_dir():
        fail(path, expected, "a file" if path.exists() else "nothing there")
    try:
        radar = find_radar_folder(path)
    except MeasurementError:
        return FolderSource(path)
    if watch:
        return FolderSource(radar / FRAMES_FOLDER)
    return RecordingSource(open_recording(path, variant=variant))


def parsed_address(text: str) -> tuple[str, int]:
    """Return host and port of "HOST:PORT", ":PORT" or "PORT".

    Raises
    ------
    MeasurementError
        No number from 0 to 65535 at the end.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) < 2**16):
        raise MeasurementError(f"address: expected HOST:PORT or PORT, got {text!r}")
    return host.strip("[]") or HOST, int(port)


class FolderSource:
    """The files that appear in a folder, each as soon as it has been complete for two looks."""

    def __init__(self, folder: Path) -> None:
        self.words = f"{folder}: waiting for files"
        self._watched = WatchedFolder(folder, _is_frame)
        self._trouble = ""

    def run(self, inbox: Inbox, stop: threading.Event) -> None:
        """Of what is there at first, only the newest file is shown."""
        old = self._looked(inbox) + ([] if stop.wait(LOOK_S) else self._looked(inbox))
        self._read_last(inbox, old)
        while not stop.wait(LOOK_S):
            found = self._looked(inbox)
            inbox.drop(max(0, len(found) - 1))
            self._read_last(inbox, found)

    def _looked(self, inbox: Inbox) -> list[Path]:
        try:
            found = self._watched.changes()
        except MeasurementError as error:
            # It may come back; until then one error stands for all looks.
            if str(error) != self._trouble:
                self._trouble = str(error)
                inbox.refuse(self._trouble)
            return []
        self._trouble = ""
        return found

    def _read_last(self, inbox: Inbox, paths: list[Path]) -> None:
        for path in paths[-1:]:
            try:
                written_s = time.time() - path.stat().st_mtime
                since_s = time.perf_counter() - max(0.0, written_s)
                inbox.put(Arrived(open_capture(path), path.name, since_s))
            except (ClradarError, OSError) as error:
                inbox.refuse(str(error))


def _is_frame(name: str) -> bool:
    return visible(name) and name.lower().endswith(SUFFIXES)


class RecordingSource:
    """The frames of a recording at its own rate; what is not read in time is left out."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._schedule = schedule_of(recording)
        self.words = f"recording, {len(recording)} frames, {self._schedule.words}"

    def run(self, inbox: Inbox, stop: threading.Event) -> None:
        begun_s, at = time.perf_counter(), 0
        while at < len(self._recording):
            due_s = begun_s + self._schedule.due_s(at)
            if stop.wait(max(0.0, due_s - time.perf_counter())):
                return
            newest = min(self._schedule.latest(time.perf_counter() - begun_s), self._last)
            inbox.drop(max(0, newest - at))
            at = max(at, newest)
            label = f"frame {self._recording.frame_numbers[at]}"
            since_s = begun_s + self._schedule.due_s(at)
            try:
                inbox.put(Arrived(self._recording[at], label, since_s))
            except ClradarError as error:
                inbox.refuse(str(error))
            at += 1

    @property
    def _last(self) -> int:
        return len(self._recording) - 1


class StreamSource:
    """The frames of one sender after the other, by TCP in the form of `wire`.

    Parameters
    ----------
    host : str
        Address to listen at. Whoever can reach it can send.
    port : int
        0: any that is free.

    Raises
    ------
    MeasurementError
        The address is not this machine's, or in use.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            self._listener = socket.create_server((host, port), backlog=2)
        except (OSError, UnicodeError) as error:
            raise MeasurementError(f"{host}:{port}: cannot listen there: {error}") from error
        self.host, self.port = host, int(self._listener.getsockname()[1])
        self.words = f"{host}:{self.port}: waiting for a sender"

    def run(self, inbox: Inbox, stop: threading.Event) -> None:
        with closing(self._listener):
            self._listener.settimeout(POLL_S)
            while not stop.is_set():
                try:
                    connection, _ = self._listener.accept()
                except TimeoutError:
                    continue
                except OSError as error:
                    inbox.refuse(f"{self.host}:{self.port}: {error}")
                    continue
                with closing(connection):
                    try:
                        self._receive_all(_Stream(connection, stop), inbox)
                    except (MeasurementError, OSError) as error:
                        if not stop.is_set():
                            inbox.refuse(str(error))

    def _receive_all(self, stream: _Stream, inbox: Inbox) -> None:
        """Receive the frames of one sender until it ends."""
        head = stream.receive(wire.HELLO.size)
        if head is None:
            return
        hello = wire.decoded_hello(stream.rest(wire.hello_bytes(head)))
        while True:
            head = stream.receive(wire.FRAME.size)
            if head is None:
                return
            since_s = stream.begun_s
            number, timestamp_us = wire.decoded_frame_head(hello, head)
            samples = np.empty(hello.shape, np.complex64)
            stream.fill(samples.reshape(-1).view(np.uint8).data)
            try:
                capture = wire.frame_capture(hello, number, timestamp_us, samples, stream.peer)
            except MeasurementError as error:
                inbox.refuse(str(error))
                continue
            inbox.put(Arrived(capture, f"frame {number}", since_s))


class _Stream:
    """Bytes of a connection, each message of which has to come within `SILENT_S`."""

    def __init__(self, connection: socket.socket, stop: threading.Event) -> None:
        self._connection, self._stop = connection, stop
        connection.settimeout(POLL_S)
        self.peer = "{}:{}".format(*connection.getpeername()[:2])
        self.begun_s = 0.0
        """When the first byte of the last message came."""

    def receive(self, n_bytes: int) -> bytes | None:
        """Return the first bytes of a message; None if the sender has ended before it."""
        data = bytearray(n_bytes)
        return bytes(data) if self._fill(memoryview(data), begins=True) else None

    def rest(self, n_bytes: int) -> bytes:
        """Return further bytes of a message."""
        data = bytearray(n_bytes)
        self.fill(memoryview(data))
        return bytes(data)

    def fill(self, into: memoryview) -> None:
        """Receive further bytes of a message into memory."""
        self._fill(into, begins=False)

    def _fill(self, into: memoryview, begins: bool) -> bool:
        deadline_s = time.perf_counter() + SILENT_S
        done = 0
        while done < len(into):
            # Also while frames keep coming: a steady sender never lets a wait time out.
            if self._stop.is_set():
                raise TimeoutError
            try:
                n = self._connection.recv_into(into[done:])
            except TimeoutError:
                if time.perf_counter() > deadline_s:
                    raise MeasurementError(
                        f"{self.peer}: nothing complete came for {SILENT_S:g} s"
                    ) from None
                continue
            if n == 0:
                if begins and done == 0:
                    return False
                raise MeasurementError(f"{self.peer}: the sender ended within a message")
            if begins and done == 0:
                self.begun_s = time.perf_counter()
            done += n
        return True


def started(source: Source, inbox: Inbox) -> Callable[[], None]:
    """Run a source in a thread of its own; return what stops it and waits for its end."""
    stop = threading.Event()

    def run() -> None:
        try:
            source.run(inbox, stop)
        finally:
            inbox.end()

    thread = threading.Thread(target=run, name="frames", daemon=True)
    thread.start()

    def stopped() -> None:
        stop.set()
        thread.join()

    return stopped
