"""Connections to the page: from pages of this machine alone, and no faster than they are read."""

from __future__ import annotations

import inspect
import logging
import socket
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server as websockets_server
from websockets.extensions.permessage_deflate import ServerPerMessageDeflateFactory

from clradar.errors import ClradarError

LOCAL_NAMES = {"localhost", "127.0.0.1", "::1"}

PORTS_TRIED = 100

_log = logging.getLogger("clradar.view.connections")
_log.addHandler(logging.NullHandler())

READ_TIMEOUT_S = 60.0
"""What is on its way to a slow browser may take this long before the connection counts as dead."""


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens at `port`, or at the next one that is free.

    Raises
    ------
    ClradarError
        None of 100 is.
    """
    last = min(port + PORTS_TRIED - 1, 65535)
    for tried in range(port, last + 1):
        try:
            return socket.create_server((host, tried))
        except OSError as error:
            reason = error.strerror
    raise ClradarError(f"port: expected one of {port} to {last} free at {host}, got: {reason}")


def refusal(hosts: Sequence[str], origins: Sequence[str]) -> str | None:
    """Return why a request with these headers is refused, None if it is not.

    A page of another site that is open in the same browser can connect to this machine, too: its
    origin says so. One whose own name was made to point here has itself as the host.
    """
    try:
        named = [urlsplit(f"//{host}").hostname for host in hosts]
    except ValueError:
        named = []
    if len(named) != 1 or named[0] not in LOCAL_NAMES:
        return "expected the host localhost or 127.0.0.1"
    if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
        return "expected the page of this server"
    return None  # programs send no origin


class PacedConnection(websockets_server.ServerConnection):
    """Waits until the other side has all but the last message before it sends another.

    Otherwise a slow link holds as many frames as the buffers on its way take. viser keeps of what
    is not sent yet only the newest of each.
    """

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._answers: deque[Awaitable[float]] = deque()

    async def send(self, message: Any, text: bool | None = None) -> None:
        await super().send(message, text)
        self._answers.append(await self.ping())
        if len(self._answers) > 1:
            await self._answers.popleft()


class Clicks:
    """Clicks on drawings of the page, which it tells by a request for /click/NAME/ACROSS/DOWN."""

    def __init__(self) -> None:
        self.act: Callable[[str, float, float], None] = lambda name, across, down: None
        """Called with the name of the drawing, and shares of its width and height."""

    def answer(self, path: str, sites: Sequence[str]) -> HTTPStatus | None:
        """Take in a request for this path by a page of these sites; None: it is for no click."""
        if not path.startswith("/click/"):
            return None
        if list(sites) != ["same-origin"]:
            return HTTPStatus.FORBIDDEN
        try:
            name, across, down = path.split("/")[2:]
            place = float(across), float(down)
        except ValueError:
            return HTTPStatus.BAD_REQUEST
        if not all(0.0 <= share <= 1.0 for share in place):
            return HTTPStatus.BAD_REQUEST
        self.act(name, *place)
        return HTTPStatus.NO_CONTENT


@contextmanager
def taking_over(listening: socket.socket, clicks: Clicks) -> Iterator[Callable[[], bool]]:
    """Let a server that viser starts during the block serve `listening`, checked and paced.

    Yields a function that says whether it does. viser has no options for this. It calls
    `websockets.asyncio.server.serve` by that name, which here is one with further arguments.
    """
    serve = websockets_server.serve
    served: list[bool] = []

    def serve_checked(
        handler: Any, *_: Any, process_request: Any = None, **options: Any
    ) -> websockets_server.serve:
        async def checked(connection: Any, request: Any) -> Any:
            headers = request.headers
            refused = refusal(headers.get_all("Host"), headers.get_all("Origin"))
            if refused is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{refused}\n")
            clicked = clicks.answer(request.path, headers.get_all("Sec-Fetch-Site"))
            if clicked is not None:
                return connection.respond(clicked, "")
            answer = process_request and process_request(connection, request)
            return await answer if inspect.isawaitable(answer) else answer

        served.append(True)
        options |= {"host": None, "port": None, "sock": listening, "process_request": checked}
        options |= {"create_connection": PacedConnection, "ping_timeout": READ_TIMEOUT_S}
        options |= {"logger": _log}  # else each bad message of a page is a traceback on stderr
        # Level 1 halves voxels in some milliseconds; higher ones take longer and save no more.
        settings = {"level": 1, "memLevel": 5}
        options |= {"extensions": [ServerPerMessageDeflateFactory(compress_settings=settings)]}
        return serve(handler, **options)

    websockets_server.serve = serve_checked
    try:
        yield lambda: bool(served)
    finally:
        websockets_server.serve = serve
