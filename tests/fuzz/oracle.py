"""Judge the outcome of reading one input: a result, an error, or a fault.

Allowed: one of the target's results, or one of its errors on one printable line that names the
file. A fault is anything else: another exception, a command run, a module imported, a file
opened that is not the input, or more memory than the target's limit.
"""

from __future__ import annotations

import os
import re
import resource
import sys
from pathlib import Path
from typing import Any

from fuzz.targets import Target

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# What no reader does, by the prefix of Python's audit events.
_FORBIDDEN = (
    "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.putenv", "os.remove",
    "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate", "os.chmod",
    "os.chown", "os.utime", "os.kill", "shutil.", "subprocess.", "socket.connect", "socket.bind",
    "socket.getaddrinfo", "ctypes.", "pty.", "urllib.", "webbrowser.", "tempfile.", "marshal.",
    "code.", "function.", "sys.settrace", "sys.setprofile", "signal.", "builtins.input",
)  # fmt: skip
# Modules that a reader may import late, on a path that reading the seeds does not take.
_LATE_IMPORTS = ("encodings", "unicodedata", "numpy", "h5py", "measurement_io", "clradar", "json")


class Canary(BaseException):
    """Something that no reader may do was about to happen. Not an Exception: nobody catches it."""


class Watch:
    """An audit hook of this process that notes, and stops, what a reader has no business doing."""

    def __init__(self, folder: Path) -> None:
        self.armed = False
        self.seen: list[str] = []
        self._folder = os.path.realpath(folder)
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.armed:
            return
        self.armed = False  # what is done here is ours
        try:
            fault = self._fault(event, arguments)
        finally:
            self.armed = True
        if fault is not None:
            self.seen.append(fault)
            raise Canary(fault)

    def _fault(self, event: str, arguments: tuple[Any, ...]) -> str | None:
        if event == "open":
            return self._opened(*arguments[:3])
        if event == "import":
            name = str(arguments[0])
            return None if name.split(".")[0] in _LATE_IMPORTS else f"imports {name}"
        if event == "exec":
            # A module that is imported late is executed too; any other code is foreign.
            name = getattr(arguments[0], "co_name", "?")
            return None if name == "<module>" and _importing() else f"executes {name}"
        if event == "pickle.find_class":
            return f"unpickles the name {arguments[0]}.{arguments[1]} by the standard library"
        if event == "marshal.loads" and _importing():
            return None
        if any(event.startswith(prefix) for prefix in _FORBIDDEN):
            return f"{event} {arguments!r:.200}"
        return None

    def _opened(self, path: Any, mode: Any, flags: Any) -> str | None:
        if isinstance(flags, int) and flags & _WRITING:
            return f"opens {path!r} for writing"
        if isinstance(path, int):
            return None
        name = os.path.realpath(os.fsdecode(path))
        if name.startswith(self._folder + os.sep) or (
            _importing() and name.endswith((".py", ".pyc"))
        ):
            return None
        return f"opens {name!r}"


def _importing() -> bool:
    frame = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


def judge(target: Target, path: Path, watch: Watch | None = None) -> tuple[str, str | None]:
    """Read one input; return ("result" | "error" | "fault") and, for a fault, what it is."""
    before = resident_peak_bytes()
    if watch is not None:
        watch.seen.clear()
        watch.armed = True
    try:
        outcome, fault = _read(target, path)
    finally:
        if watch is not None:
            watch.armed = False
    if watch is not None and watch.seen:
        return "fault", watch.seen[0]
    grown = resident_peak_bytes() - before
    if grown > target.resident_limit_bytes:
        return "fault", f"takes {grown / 1e6:.0f} MB of memory"
    return outcome, fault


def _read(target: Target, path: Path) -> tuple[str, str | None]:
    try:
        result = target.read(path)
    except Canary as canary:
        return "fault", str(canary)
    except target.errors as error:
        message = str(error)
        if type(error) not in target.errors:
            return "fault", f"raises {type(error).__name__}, a subclass: {message:.300}"
        first, *lines = message.split("\n")
        several = re.fullmatch(r"[0-9]+ mistakes, one per line:", first)
        lines = lines if several else [message]
        if not all(line.isprintable() and len(line) <= 2000 for line in lines):
            return "fault", f"says {message[:300]!r} in {len(message)} characters"
        if "Too many open files" in message:
            return "fault", f"opens something else than the file: {message:.300}"
        if path.name not in message and target.file_name.split("/")[0] not in message:
            return "fault", f"does not name the file: {message!r:.300}"
        return "error", None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return "fault", f"raises {type(error).__name__}: {error!s:.300}"
    if not isinstance(result, target.results):
        return "fault", f"returns {type(result).__name__}"
    return "result", None


def resident_peak_bytes() -> int:
    """Return the largest resident memory that this process has had."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage counts what the parent had when it forked this process, too
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
