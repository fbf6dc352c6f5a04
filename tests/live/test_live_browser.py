"""Frames of a stream in a browser: pixels that change, a sender that dies, garbage, the end."""

from __future__ import annotations

import contextlib
import signal
import socket
import struct
from pathlib import Path

import chromium
import pytest
from view_tab import Tab, in_browser, viewing

import clradar
from clradar.calibration import CornerReflector, response
from clradar.live import wire

pytest.importorskip("viser")

ARRAY = clradar.arrays.qar50()
HELLO = wire.Hello(ARRAY, clradar.Waveform.sfcw(72e9, 82e9, 16))


def frame(number: int, x_m: float) -> bytes:
    """A stream with one frame of a small corner reflector."""
    samples = response(CornerReflector((x_m, 0.0, 0.3)), HELLO.array, HELLO.waveform)
    head = HELLO.encoded() + wire.frame_head(HELLO, number, 0)
    return head + samples.astype("<c8").tobytes()


@in_browser
def test_a_stream_is_shown_whatever_its_senders_do(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        process, address = stack.enter_context(viewing("live", "tcp:0", "--view"))
        page = stack.enter_context(chromium.chromium(tmp_path, webgl=True))
        tab = Tab(page, address)
        tab.load("waiting for a sender")
        listening = page.js(r"document.body.textContent.match(/127\.0\.0\.1:(\d+): waiting/)[1]")

        def send(data: bytes, *, killed: bool = False) -> None:
            """By a sender of its own: one that waits for this browser may count as silent."""
            with socket.create_connection(("127.0.0.1", int(listening))) as connection:
                connection.sendall(data)
                if killed:  # its system resets the connection
                    linger = struct.pack("ii", 1, 0)
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)

        send(frame(7, 0.03))
        tab.says("frame 7: image of")
        tab.says("1 shown, latency")
        left = tab.lit(lambda m, s: len(m) > 50).mean()
        send(frame(8, -0.03))
        right = tab.lit(lambda m, s: len(m) > 50 and m.mean() > left + 50).mean()
        send(frame(9, 0.03)[:-5], killed=True)
        tab.says("1 bad, the last:")
        tab.says("No frame for")
        send(b"GET / HTTP/1.1\r\n\r\n")
        tab.says("2 bad, the last: stream: expected it to begin with")
        # Stopped: what comes is left out. Going on, it is shown again.
        page.key(" ", "Space")
        tab.says("Stopped.")
        send(frame(1, 0.03))
        tab.says("1 dropped")
        assert tab.lit(lambda m, s: len(m) > 50).mean() == right
        page.key(" ", "Space")
        tab.says("No frame for")
        send(frame(2, 0.03))
        tab.says("frame 2: image of")
        tab.lit(lambda m, s: len(m) > 50 and m.mean() < right - 50)
        page.key("ArrowLeft", "ArrowLeft")  # an earlier frame is looked at
        tab.says("frame 8: image of")
        send(frame(3, 0.03))
        tab.says("2 dropped")

        process.send_signal(signal.SIGINT)
        assert process.communicate()[1] == ""
        assert process.returncode == 0
