"""The one way to the page: requests of pages of this machine, passed on to where viser listens."""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import Coroutine, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from clradar.errors import ClradarError

HOST = "127.0.0.1"  # this machine alone: who may log in may look, through ssh
LOCAL_NAMES = {"localhost", "127.0.0.1", "::1"}

PORTS_TRIED = 100

HEAD_S = 10.0  # a request has to be complete after that
BUFFER_BYTES = 2**16  # on its way to a browser: a slow link gets the newest frame, not all


def listen(port: int, host: str = HOST) -> socket.socket:
    """Return a socket that listens at `port`, or at the next one that is free."""
    last = min(port + PORTS_TRIED - 1, 65535)
    for tried in range(port, last + 1):
        try:
            return socket.create_server((host, tried))
        except OSError as error:
            reason = error.strerror
    raise ClradarError(f"port: expected one of {port} to {last} free at {host}, got: {reason}")


def hidden_host() -> str:
    """Return an address of this machine that no page can guess: one of 16 million.

    Where there is only 127.0.0.1, as on macOS, it is that: there the port alone is not known.
    """
    host = f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(254)}.{secrets.randbelow(254) + 1}"
    try:
        with socket.create_server((host, 0)):
            return host
    except OSError:
        return HOST


def refusal(headers: Mapping[str, Sequence[str]], protocol: str) -> str | None:
    """Return why a request with these headers is refused, None if it is not.

    A page of another site that is open in the same browser can connect to this machine, too: its
    origin says so. One whose own name was made to point here has itself as the host.
    """
    hosts = headers.get("host", ())
    try:
        named = [urlsplit(f"//{host}").hostname for host in hosts]
    except ValueError:
        named = []
    if len(named) != 1 or named[0] not in LOCAL_NAMES:
        return "expected the host localhost or 127.0.0.1"
    origins = headers.get("origin", ())  # programs send none
    if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
        return "expected the page of this server"
    if "upgrade" in headers and protocol not in headers.get("sec-websocket-protocol", ()):
        return "expected the page of this version: reload it"
    return None


def headers_of(head: bytes) -> dict[str, list[str]]:
    """Return the headers of a request, by their names in lower case."""
    first, *lines = head.decode("latin-1").split("\r\n")
    method, _, version = first.split(" ")
    if method != "GET" or version != "HTTP/1.1":
        raise ValueError("not GET of HTTP/1.1")
    headers: dict[str, list[str]] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        if not colon or not name or name != name.strip():
            raise ValueError("not a header")
        headers.setdefault(name.lower(), []).append(value.strip())
    return headers


@contextmanager
def gate(
    listening: socket.socket,
    target: tuple[str, int],
    protocol: str,
    loop: asyncio.AbstractEventLoop,
) -> Iterator[None]:
    """Take requests at a socket during the block, and pass those that may on to a target."""
    tasks: set[asyncio.Task[Any]] = set()

    def run(work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, loop).result()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        with closing(writer), suppress(OSError, asyncio.CancelledError):
            await _pass_on(reader, writer, target, protocol)

    async def close() -> None:
        server.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    server = run(asyncio.start_server(serve, sock=listening))
    try:
        yield
    finally:
        run(close())


async def _pass_on(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    target: tuple[str, int],
    protocol: str,
) -> None:
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
        refused = refusal(headers_of(head[:-4]), protocol)
    except (asyncio.IncompleteReadError, asyncio.TimeoutError):
        return  # opened in advance: the browser would take it for its next request's answer
    except (asyncio.LimitOverrunError, ValueError):
        refused = "expected a request of a browser"
    if refused is not None:
        body = f"{refused}\n".encode()
        writer.write(
            b"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nConnection: close\r\n"
            b"Content-Length: %d\r\n\r\n%s" % (len(body), body)
        )
        await writer.drain()
        return
    # viser ends a connection after each answer but that of a websocket: one head is all.
    from_viser, to_viser = await asyncio.open_connection(*target, limit=BUFFER_BYTES)
    for one, buffer in ((to_viser, socket.SO_RCVBUF), (writer, socket.SO_SNDBUF)):
        one.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, buffer, BUFFER_BYTES)
        one.transport.set_write_buffer_limits(BUFFER_BYTES)
    to_viser.write(head)
    ways = ((reader, to_viser), (from_viser, writer))
    copies = [asyncio.ensure_future(_copy(*ends)) for ends in ways]
    try:
        await asyncio.wait(copies, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for copy in copies:
            copy.cancel()
        await asyncio.gather(*copies, return_exceptions=True)
        to_viser.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(BUFFER_BYTES):
        writer.write(data)
        await writer.drain()
