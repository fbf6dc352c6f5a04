"""Who may connect to the live view, where it listens, and how it sends."""

from __future__ import annotations

import base64
import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import clradar
from clradar.errors import ClradarError, MeasurementError
from clradar.view.server import serving
from clradar.view.sources import FixedFrames
from clradar.view.wish import Wish

viser = pytest.importorskip("viser")

GRID = clradar.VoxelGrid(np.array([0, 0, 0.3]), np.full(3, 1e-3), (4, 3, 2))


def source() -> FixedFrames:
    volume = clradar.Volume(np.ones(GRID.shape, np.complex64), GRID)
    return FixedFrames("volume", ("volume",), lambda _: volume)


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with serving(source(), Wish(), port=8500) as (server, _):
        yield server.get_port()


def connected(port: int, *headers: str, upgrade: bool = True, path: str = "/") -> socket.socket:
    """A connection that has sent a request."""
    key = base64.b64encode(bytes(16)).decode()
    lines = [f"GET {path} HTTP/1.1", *headers]
    if upgrade:
        lines += ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"]
        lines += [f"Sec-WebSocket-Key: {key}"]
        lines += [f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]
    connection = socket.create_connection(("127.0.0.1", port))
    connection.sendall("\r\n".join([*lines, "", ""]).encode())
    return connection


def status(port: int, *headers: str, upgrade: bool = True, path: str = "/") -> int:
    with closing(connected(port, *headers, upgrade=upgrade, path=path)) as connection:
        return int(connection.makefile("rb").readline().split()[1])


@pytest.mark.parametrize(
    ("host", "origin", "expected"),
    [
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", 101),
        ("localhost:9000", "http://localhost:9000", 101),  # through a tunnel from another port
        ("[::1]:9000", "http://[::1]:9000", 101),
        ("127.0.0.1:{port}", None, 101),  # a program
        ("127.0.0.1:{port}", "https://example.org", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1:9000", 403),  # another server's page
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}.example.org", 403),
        ("127.0.0.1:{port}", "null", 403),  # a page in a frame without an origin, or a file
        ("example.org:{port}", "http://example.org:{port}", 403),  # a name made to point here
        ("localhost.example.org", None, 403),
        ("[::1", None, 403),
    ],
)
def test_only_its_own_page_connects(
    port: int, host: str, origin: str | None, expected: int
) -> None:
    headers = [f"Host: {host.format(port=port)}"]
    if origin is not None:
        headers.append(f"Origin: {origin.format(port=port)}")
    assert status(port, *headers) == expected


@pytest.mark.parametrize(
    ("path", "site", "expected"),
    [
        ("/click/xy/0.5/1", "same-origin", 204),
        ("/click/xy/0.5/1", "cross-site", 403),  # of a picture in another page, say
        ("/click/xy/0.5/1", None, 403),
        ("/click/xy/0.5/1.1", "same-origin", 400),
        ("/click/xy/nan/1", "same-origin", 400),
        ("/click/xy", "same-origin", 400),
    ],
)
def test_clicks_are_of_its_own_page(port: int, path: str, site: str | None, expected: int) -> None:
    headers = [f"Host: 127.0.0.1:{port}"]
    if site is not None:
        headers.append(f"Sec-Fetch-Site: {site}")
    assert status(port, *headers, upgrade=False, path=path) == expected


def test_the_page_is_for_names_of_this_machine_alone(port: int) -> None:
    assert status(port, f"Host: localhost:{port}", upgrade=False) == 200
    assert status(port, "Host: example.org", upgrade=False) == 403
    assert status(port, upgrade=False) == 403


def test_packets_are_compressed_where_the_browser_can(port: int) -> None:
    headers = (f"Host: localhost:{port}", "Sec-WebSocket-Extensions: permessage-deflate")
    with closing(connected(port, *headers)) as connection:
        lines = iter(connection.makefile("rb").readline, b"\r\n")
        assert any(line.startswith(b"Sec-WebSocket-Extensions: permessage") for line in lines)


def test_a_viser_that_goes_another_way_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = []

    def other_server(**_: Any) -> Any:
        return SimpleNamespace(stop=lambda: stopped.append(True))

    monkeypatch.setattr(viser, "ViserServer", other_server)
    with (
        pytest.raises(ClradarError, match="check who connects"),
        serving(source(), Wish(), port=8500),
    ):
        pass
    assert stopped


def test_a_port_in_use_is_passed_over() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        with serving(source(), Wish(), port=number) as (server, _):
            assert number < server.get_port() < number + 100


def test_without_a_free_port_the_error_says_which_were_tried() -> None:
    with (
        socket.create_server(("127.0.0.1", 65535)),
        pytest.raises(ClradarError, match="65535"),
        serving(source(), Wish(), port=65535),
    ):
        pass


@contextmanager
def halting_link(port: int) -> Iterator[tuple[int, threading.Event]]:
    """The port of a link that passes on what the server at `port` sends while the event is set."""
    passing = threading.Event()
    passing.set()
    with socket.create_server(("127.0.0.1", 0)) as entrance:
        link = socket.create_connection(("127.0.0.1", port))

        def pass_on(source: socket.socket, target: socket.socket, when: threading.Event) -> None:
            try:
                while block := source.recv(2**16):
                    when.wait()
                    target.sendall(block)
            except OSError:
                pass  # the test has ended

        def run() -> None:
            browser, _ = entrance.accept()
            always = threading.Event()
            always.set()
            back = threading.Thread(target=pass_on, args=(browser, link, always), daemon=True)
            back.start()
            pass_on(link, browser, passing)
            browser.close()

        threading.Thread(target=run, daemon=True).start()
        try:
            yield entrance.getsockname()[1], passing
        finally:
            passing.set()
            link.close()


def messages(browser: Any) -> list[dict[str, Any]]:
    """The messages that the next of viser's packets holds."""
    import msgspec.msgpack
    import zstandard

    packet = browser.recv()
    compressed = packet[16 : 16 + int.from_bytes(packet[8:16], "little")]
    packed = zstandard.ZstdDecompressor().decompress(compressed)
    found: list[dict[str, Any]] = msgspec.msgpack.decode(packed)["messages"]
    return found


def browser_at(port: int) -> Any:
    from websockets.sync.client import connect

    return connect(
        f"ws://127.0.0.1:{port}",
        subprotocols=[f"viser-v{viser.__version__}"],
        compression=None,  # which would make little of these points
        max_size=None,
    )


def test_a_first_frame_that_cannot_be_read_is_said_on_the_page() -> None:
    volume = source().read(0)

    def read(frame: int) -> clradar.Volume | clradar.Capture:
        if frame == 0:
            raise MeasurementError("000000.npy: expected a frame, got noise")
        return volume

    frames = FixedFrames("broken", ("frame A", "frame B"), read)
    with serving(frames, Wish(), port=0) as (server, session):
        session.settle()
        with browser_at(server.get_port()) as browser:
            while "expected a frame, got noise" not in str(messages(browser)):
                pass
            session.step(1)
            while "frame B: volume of" not in str(messages(browser)):
                pass


def test_a_link_that_does_not_keep_up_gets_the_newest_frame_and_not_those_between() -> None:
    def frames_until(browser: Any, last: str) -> int:
        """How many frames come until the last one has."""
        count = 0
        while True:
            got = messages(browser)
            count += sum(m["type"] == "PointCloudMessage" and m["name"] == "/big" for m in got)
            if any(last in str(m) for m in got):
                return count

    points = np.zeros((30_000, 3), np.float32)
    with serving(source(), Wish(), port=8500) as (server, session):
        session.settle()
        state = server.gui.add_markdown("frame none")
        with (
            halting_link(server.get_port()) as (slow_port, passing),
            browser_at(server.get_port()) as fast,
            browser_at(slow_port) as slow,
        ):
            frames_until(slow, "frame none")
            frames_until(fast, "frame none")
            passing.clear()
            for i in range(40):  # 11 MB
                with server.atomic():
                    server.scene.add_point_cloud("/big", points, np.zeros(3, np.uint8))
                    state.content = f"frame {i}."
                frames_until(fast, f"frame {i}.")
            passing.set()
            assert frames_until(slow, "frame 39.") <= 4


def test_a_bad_message_ends_its_connection_without_a_traceback(
    port: int, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(connected(port, f"Host: 127.0.0.1:{port}")) as connection:
        # A binary frame of one byte, masked with zeros: no message of viser.
        connection.sendall(b"\x82\x81" + bytes(4) + b"\xff")
        while connection.recv(65536):
            pass
    # Which nobody prints who does not ask for it, unlike those of websockets.
    assert [record.name for record in caplog.records] == ["clradar.view.connections"]
    assert logging.getLogger("clradar.view.connections").handlers
