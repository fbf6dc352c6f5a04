"""Who may connect to the view, where it listens, and what others send."""

import base64
import logging
import socket
import sys
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from fronts import frames, volume

from clradar.view.server import running, serving
from clradar.view.session import View
from clradar.view.wish import Wish

viser = pytest.importorskip("viser")

VIEW = View(source=frames(volume()), wish=Wish())


@pytest.fixture(scope="module")
def port():
    with serving(VIEW, 8500) as (port, _):
        yield port


def connected(port, *headers, upgrade=True, version=viser.__version__):
    """A connection that has sent a request."""
    key = base64.b64encode(bytes(16)).decode()
    lines = ["GET / HTTP/1.1", *headers]
    if upgrade:
        lines += ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"]
        lines += [f"Sec-WebSocket-Key: {key}", f"Sec-WebSocket-Protocol: viser-v{version}"]
    return sent(port, "\r\n".join([*lines, "", ""]).encode())


def sent(port, data):
    connection = socket.create_connection(("127.0.0.1", port))
    connection.sendall(data)
    return connection


def status(connection):
    with closing(connection):
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
def test_only_its_own_page_connects(port, host, origin, expected):
    headers = [f"Host: {host.format(port=port)}"]
    if origin is not None:
        headers.append(f"Origin: {origin.format(port=port)}")
    assert status(connected(port, *headers)) == expected


def test_the_page_is_for_names_of_this_machine_alone(port):
    here = f"Host: localhost:{port}"
    assert status(connected(port, here, upgrade=False)) == 200
    assert status(connected(port, "Host: example.org", upgrade=False)) == 403
    assert status(connected(port, upgrade=False)) == 403
    assert status(connected(port, here, here, upgrade=False)) == 403
    assert status(connected(port, here, version="0.1")) == 403  # viser would print a line


@pytest.mark.parametrize(
    "data",
    [
        b"\xff\x00 no request\r\n\r\n",
        b"GET / HTTP/1.0\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\n Host: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: " + 2**17 * b"x" + b"\r\n\r\n",
    ],
)
def test_what_is_no_request_is_refused(port, data):
    assert status(sent(port, data)) == 403


@pytest.mark.parametrize("data", [b"", b"GET / HT"])
def test_a_connection_that_is_not_used_ends_without_an_answer(port, data, monkeypatch):
    """A browser opens some in advance, and takes what it finds there for its next answer."""
    monkeypatch.setattr("clradar.view.gate.HEAD_S", 0.01)
    with closing(sent(port, data)) as connection:
        assert connection.recv(1) == b""


def test_viser_itself_is_where_no_page_can_guess():
    with running("view", 0) as (server, port):
        assert server.get_host() != "127.0.0.1" or sys.platform != "linux"
        assert server.get_port() != port or server.get_host() != "127.0.0.1"
        assert server.request_share_url() is None  # nothing leaves this machine


def test_a_port_in_use_is_passed_over():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        with serving(VIEW, number) as (port, _):
            assert number < port < number + 100


def messages(browser):
    """The messages that the next of viser's packets holds."""
    import msgspec.msgpack
    import zstandard

    packet = browser.recv()
    compressed = packet[16 : 16 + int.from_bytes(packet[8:16], "little")]
    packed = zstandard.ZstdDecompressor().decompress(compressed)
    found: list[dict[str, Any]] = msgspec.msgpack.decode(packed)["messages"]
    return found


def browser_at(port, **options):
    from websockets.sync.client import connect

    protocol: Any = f"viser-v{viser.__version__}"
    return connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None, **options)


def test_a_link_that_does_not_keep_up_gets_fewer_frames():
    def frames_until(browser, last):
        """How many frames come until the last one has."""
        count = 0
        while True:
            got = messages(browser)
            count += sum(m["type"] == "PointCloudMessage" and m["name"] == "/big" for m in got)
            if any(last in str(m) for m in got):
                return count

    points = np.zeros((60_000, 3), np.float32)
    with running("view", 0) as (server, port):
        state = server.gui.add_markdown("frame none")
        # One that takes nothing from its queue of one message reads nothing.
        link = socket.socket()
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**16)
        link.connect(("127.0.0.1", port))
        with browser_at(port) as fast, browser_at(port, sock=link, max_queue=1) as slow:
            frames_until(slow, "frame none")
            frames_until(fast, "frame none")
            for i in range(40):  # 22 MB
                with server.atomic():
                    server.scene.add_point_cloud("/big", points, np.zeros(3, np.uint8))
                    state.content = f"frame {i}."
                frames_until(fast, f"frame {i}.")
            assert frames_until(slow, "frame 39.") < 30  # 16: what the systems' buffers hold


def test_what_others_send_prints_no_traceback(port, capfd):
    # Binary frames of one byte and of an unknown message, masked with zeros.
    for payload in (b"\xff", b"\x81\xa4type\xa3odd"):
        head = b"\x82" + bytes([0x80 | len(payload)]) + bytes(4)
        with closing(connected(port, f"Host: 127.0.0.1:{port}")) as connection:
            connection.sendall(head + payload)
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(65536):
                pass
    assert capfd.readouterr() == ("", "")
    assert logging.getLogger("websockets.server").handlers  # while it is served
