"""A headless Chromium for tests, driven through a pipe: no network, no driver, no package."""

import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DEADLINE_S = 1800.0
"""Limit of one answer, which no working browser reaches: a start takes seconds."""


def installed() -> str | None:
    """Return the path of a Chromium, None where there is none, or no way to drive one."""
    if sys.platform == "win32":
        return None
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class _Pipe:
    """Messages of a browser; those that are no answers are events of one of its tabs."""

    def __init__(self, reading: int, writing: int) -> None:
        self._reading, self.writing = reading, writing
        self._buffer = b""
        self.last = 0
        self.pages: dict[str | None, Page] = {}

    def read(self) -> dict[str, Any]:
        """The next message."""
        end = time.monotonic() + DEADLINE_S
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._reading], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"no message from Chromium for {DEADLINE_S:g} s"
            block = os.read(self._reading, 2**20)
            assert block, "Chromium ended"
            self._buffer += block
        message, self._buffer = self._buffer.split(b"\0", 1)
        found: dict[str, Any] = json.loads(message)
        page = self.pages.get(found.get("sessionId"))
        if "id" not in found and page is not None:
            page.events.append(found)
        return found


class Page:
    """One tab, controlled by commands of the DevTools protocol."""

    def __init__(self, pipe: "_Pipe") -> None:
        self._pipe = pipe
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []
        # A page in a window of its own is drawn while another one is looked at.
        target = self.call("Target.createTarget", url="about:blank", newWindow=True)["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        pipe.pages[self._session] = self
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def another(self) -> "Page":
        """Another tab of the same browser."""
        return Page(self._pipe)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the result of one command."""
        pipe = self._pipe
        pipe.last += 1
        message: dict[str, Any] = {"id": pipe.last, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        left = json.dumps(message).encode() + b"\0"
        while left:
            left = left[os.write(pipe.writing, left) :]
        while True:
            answer = pipe.read()
            if answer.get("id") == pipe.last:
                assert "error" not in answer, (method, answer["error"])
                result: dict[str, Any] = answer["result"]
                return result

    def resize(self, width: int, height: int, *, phone: bool = False, ratio: float = 1.0) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=ratio,
            mobile=phone,
        )
        self.call("Emulation.setTouchEmulationEnabled", enabled=phone)

    def prefer(self, scheme: str) -> None:
        """Ask for a "light" or a "dark" page."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def open(self, path: Path | str) -> None:
        """Load a file or an address and wait until it is complete and has been drawn twice."""
        self.events.clear()
        self.call("Page.navigate", url=path if isinstance(path, str) else path.absolute().as_uri())
        # By the event and not by the state of the document, which may be that of the page before.
        while all(event.get("method") != "Page.loadEventFired" for event in self.events):
            self._pipe.read()
        self.settle()

    def settle(self) -> None:
        """Wait until the last changes have been drawn."""
        self.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def js(self, expression: str) -> Any:
        """Return the value of an expression, awaited."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start: tuple[float, float], by: tuple[float, float], steps: int = 4) -> None:
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1)
        for i in range(1, steps + 1):
            x, y = (s + b * i / steps for s, b in zip(start, by, strict=True))
            self.mouse("mouseMoved", x, y, button="left", buttons=1)
        self.mouse("mouseReleased", x, y, button="left", clickCount=1)
        self.settle()

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        touches = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=touches)

    def key(self, key: str, code: str = "") -> None:
        """Press and release a key; `code` is that of its place on the keyboard, such as "KeyV"."""
        text = key if len(key) == 1 else ""
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=code, text=text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, code=code)
        self.settle()

    def complaints(self) -> list[str]:
        """Return the messages of console and log, and uncaught errors."""
        self.js("0")  # what came before this is here now
        kinds = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
        return [json.dumps(e["params"]) for e in self.events if e.get("method") in kinds]

    def requests(self) -> list[str]:
        """Return the addresses that the page requested."""
        sent = [e for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [e["params"]["request"]["url"] for e in sent]


@contextmanager
def chromium(profile: Path, *, webgl: bool = False) -> Iterator[Page]:
    """Yield a tab of a headless Chromium whose files are all in `profile`; WebGL is in software."""
    import fcntl  # which Windows has not

    program = installed()
    assert program is not None
    pipes = [*os.pipe(), *os.pipe()]
    # Chromium reads from descriptor 3 and writes to 4. Ours are moved out of the way of these.
    ours = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 10) for fd in pipes]
    for fd in pipes:
        os.close(fd)
    its_reading, writing, reading, its_writing = ours
    command = [
        program,
        "--headless",
        # In a container there is often no sandbox to be had, and the pages are our own.
        "--no-sandbox",
        *(["--enable-unsafe-swiftshader"] if webgl else ["--disable-gpu"]),
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--disable-component-update",
        # A page that asks for another machine does not get there.
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
        "--no-first-run",
        "--hide-scrollbars",
        "--remote-debugging-pipe",
        f"--user-data-dir={profile}",
    ]
    redirected = f'exec "$@" 3<&{its_reading} 4>&{its_writing}'
    with subprocess.Popen(
        ["bash", "-c", redirected, "bash", *command],
        pass_fds=(its_reading, its_writing),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "HOME": str(profile), "XDG_CONFIG_HOME": str(profile)},
    ) as process:
        os.close(its_reading)
        os.close(its_writing)
        try:
            yield Page(_Pipe(reading, writing))
        finally:
            os.close(writing)  # it ends when its pipe does
            os.close(reading)
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
