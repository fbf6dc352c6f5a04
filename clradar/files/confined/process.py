"""Read a file in a confined process, which a hostile file can crash but not use.

A library may loop for ever, allocate without bound or overwrite its own memory on a damaged file.
So each file is read by a process that has just been forked for it from a small server (started at
the first need, some tenths of a second; a fork takes milliseconds). It has a limit of memory and of
time, cannot write files or start programs, and once the reader has its files open it can open
nothing else.

Systems other than Linux cannot do that: there a process is started for each file, and one for all
frames of a recording (`Companion`), which is given their content and opens none of them. macOS does
not limit its memory; Windows limits nothing but the time. With CLRADAR_READERS=spawn in the
environment Linux does it that way, too.
"""

from __future__ import annotations

import atexit
import codecs
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, BinaryIO

from clradar.errors import ClradarError, MeasurementError
from clradar.files.confined import wire
from clradar.files.failures import clean, fail, read_bytes, shown
from clradar.files.limits import (
    MAX_FRAME_BYTES,
    MAX_REQUEST_BYTES,
    START_LIMIT_S,
    WALL_FACTOR,
    WALL_LIMIT_S,
)

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_READY = b"ready\n"
_NO_CONTENT = b"\xff" * 8
_ENCODINGS = (
    "ascii", "latin-1", "utf-8", "utf-8-sig", "raw-unicode-escape", "cp437",
    "utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be",
)  # fmt: skip
"""Of what is read: cp437 of names in ZIP archives, UTF-16 and UTF-32 of text in MATLAB files."""

_LATE = ("numpy.ma", "unicodedata")
"""Modules that numpy and Python import late, when no file can be opened any more."""

_FORKS = sys.platform == "linux" and os.environ.get("CLRADAR_READERS") != "spawn"
"""Whether the server works: it passes on sockets, and reads /proc."""

_lock = threading.Lock()
_server: tuple[subprocess.Popen[bytes], socket.socket] | None = None
_confined = False


def run(
    function: Callable[..., Any],
    path: Path,
    *arguments: Any,
    expected: str,
    cpu_s: int,
    memory_bytes: int,
    most_bytes: int,
    modules: tuple[str, ...] = (),
    error: type[ClradarError] = MeasurementError,
    companion: Companion | None = None,
) -> Any:
    """Call `function(path, *arguments)` in a confined process and return its result.

    The function is one of a module. It returns what `clradar.files.confined.wire` can send, and
    calls `file_bytes`, or `forbid_opening` when it has opened what it needs. Its arguments are what
    JSON can hold. `expected` says in messages what the file is to be; `memory_bytes` is on top of
    what the process has when it starts, `most_bytes` limits the arrays that come back, and
    `modules` are imported, functions ("module:name") called before: later it can open no file.

    A companion reads this file and others like it where a process for each would be started; the
    function then takes the content by `file_bytes` alone.
    """
    request = {
        "module": function.__module__,
        "function": function.__qualname__,
        "modules": modules,
        "folder": os.getcwd(),
        "path": os.fspath(path),
        "arguments": arguments,
        "expected": expected,
        "cpu_s": cpu_s,
        "memory_bytes": memory_bytes,
    }
    message = json.dumps(request).encode("ascii")
    if len(message) > MAX_REQUEST_BYTES:
        got = f"{len(message)} bytes of them"
        fail(path, "a path and keys of sane length", got, error=error)
    try:
        if _FORKS:
            answer = _answer_of(message, most_bytes, START_LIMIT_S + WALL_FACTOR * cpu_s)
        else:
            content, own = None, companion or Companion()
            if companion is not None:
                content = read_bytes(path, expected, MAX_FRAME_BYTES, error=error)
            answer = own.answer(message, content, most_bytes, cpu_s)
    except NoServer as cause:
        fail(path, "a process to read it in", clean(cause), error=error, cause=cause)
    except (wire.BrokenMessage, OSError) as cause:
        limits = f"{cpu_s} s or {memory_bytes >> 20} MiB"
        got = f"one on which its reader crashes, or takes more than {limits}"
        fail(path, expected, got, error=error, cause=cause)
    if not isinstance(answer, dict) or ("error" in answer) == ("result" in answer):
        fail(path, expected, "an invalid answer of its process", error=error)
    if "error" in answer:
        raise error(clean(answer["error"], 4))  # ours, with paths and words of the file
    return answer["result"]


class NoServer(Exception):
    """The server does not start, which no file can cause."""


def _answer_of(message: bytes, most_bytes: int, wall_s: float) -> Any:
    """Have a process forked for a request."""
    if sys.platform == "win32":  # which has no such sockets
        raise NotImplementedError
    link = _running_server()
    ours, theirs = socket.socketpair()
    with ours:
        with theirs:
            socket.send_fds(link, [message], [theirs.fileno()])
        ours.settimeout(wall_s)  # of a process that was stopped
        with ours.makefile("rb") as answer:
            return wire.receive(answer, most_bytes)


def _running_server() -> socket.socket:
    """The link to the server; another one where it has died, which no file can cause."""
    global _server
    if sys.platform == "win32":
        raise NotImplementedError
    with _lock:
        if _server is not None and _server[0].poll() is not None:
            _server[1].close()
            _server = None
        if _server is None:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            try:
                process, answers = _started("serve", theirs)
            except NoServer:
                ours.close()
                raise
            finally:
                theirs.close()
            answers.close()
            _server = process, ours
        return _server[1]


def _started(call: str, requests: Any) -> tuple[subprocess.Popen[bytes], Any]:
    """Start Python with a function of this module; return the process and its output."""
    path = [os.path.abspath(entry) for entry in sys.path]
    code = f"import sys; sys.path[:] = {path!r}; from {__name__} import {call}; {call}()"
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=requests,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # the C library prints there when it finds damage
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
    except OSError as error:
        raise NoServer(clean(error)) from error
    assert process.stdout is not None
    if not any(line.endswith(_READY) for line in process.stdout):  # others may print before
        _end(process)
        raise NoServer(f"it does not start: {sys.executable}")
    return process, process.stdout


class Companion:
    """A process that reads many files, of which it is given the content; or opens a single one.

    It starts at the first need and ends with this object, and another takes over where it dies. In
    a copy for, or a fork of, another process it is a new one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def __reduce__(self) -> Any:
        return Companion, ()

    def answer(self, message: bytes, content: bytes | None, most_bytes: int, cpu_s: int) -> Any:
        with self._lock:
            process = self._running()
            assert process.stdin is not None
            timer = threading.Timer(START_LIMIT_S + 2 * cpu_s, process.kill)
            timer.start()
            try:
                for part in (message, content):
                    size = _NO_CONTENT if part is None else len(part).to_bytes(8, "little")
                    process.stdin.write(size + (part or b""))
                process.stdin.flush()
                return wire.receive(process.stdout, most_bytes)
            except (wire.BrokenMessage, OSError):
                self._process = None
                _end(process)
                raise
            finally:
                timer.cancel()

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._owner != os.getpid():
            process, _ = _started("serve_many", subprocess.PIPE)
            self._process, self._owner = process, os.getpid()
            weakref.finalize(self, _end, process)
        return self._process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    with suppress(OSError), process:  # closes its pipes and waits
        pass


@atexit.register
def _stop_server() -> None:
    global _server
    with _lock:
        if _server is not None:
            _server[1].close()
            _end(_server[0])
        _server = None


def _forget_server() -> None:
    """A forked process has a server of its own: this one answers its parent."""
    global _server, _lock
    if _server is not None:
        _server[0].returncode = 0  # it is not this process's to wait for
        _server[1].close()
    _server, _lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_server)


# ---- the other side


def _greet() -> BinaryIO:
    """Say that this process has started; return its output, which nothing else can write to."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    answer.write(_READY)
    answer.flush()
    return answer


def serve() -> None:
    """Answer requests of a socket, each in a forked process, until the other end closes."""
    if sys.platform == "win32":
        raise NotImplementedError
    warnings.simplefilter("ignore")  # of forks, which are intended here
    _greet().close()
    with socket.socket(fileno=0) as link:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # ended processes need no wait
        while True:
            message, handles, _, _ = socket.recv_fds(link, MAX_REQUEST_BYTES, 1)
            if not message:
                return
            with suppress(Exception):  # once, and not by every process
                _import_all(json.loads(message))
            if os.fork() == 0:
                os.dup2(1, 0)  # closes the link
                with suppress(BaseException), os.fdopen(handles[0], "wb") as answer:
                    _answer(json.loads(message), answer)
                os._exit(0)
            for handle in handles:
                os.close(handle)


def serve_many() -> None:
    """Answer requests on standard input, each with the content of its file, until it closes.

    One without content opens the file, and is the last.
    """
    global _handed
    warnings.simplefilter("ignore")
    requests = sys.stdin.buffer
    with _greet() as answer:
        while length := requests.read(8):
            request = json.loads(requests.read(int.from_bytes(length, "little")))
            size = requests.read(8)
            with suppress(Exception):
                _import_all(request)
            if size == _NO_CONTENT:
                _answer(request, answer)
                return
            _handed = requests.read(int.from_bytes(size, "little"))
            _limit(request["cpu_s"], request["memory_bytes"], again=True)
            forbid_opening()
            _reply(request, answer)


def _import_all(request: dict[str, Any]) -> None:
    for encoding in _ENCODINGS:
        codecs.lookup(encoding)  # loads it
    for name in (request["module"], *request["modules"], *_LATE):
        if callable(found := resolve_name(name if ":" in name else f"{name}:")):
            found()


def _answer(request: dict[str, Any], answer: Any) -> None:
    _limit(request["cpu_s"], request["memory_bytes"])
    with suppress(OSError):
        os.chdir(request["folder"])
    _reply(request, answer)


def _reply(request: dict[str, Any], answer: Any) -> None:
    path = Path(request["path"])
    try:
        _import_all(request)
        function = getattr(sys.modules[request["module"]], request["function"])
        wire.send(answer, {"result": function(path, *request["arguments"])})
    except ClradarError as error:
        wire.send(answer, {"error": str(error)})
    except Exception as error:
        got = f"{type(error).__name__}: {clean(error)}"
        wire.send(answer, {"error": f"{shown(path)}: expected {request['expected']}, got {got}"})


def _limit(cpu_s: int, memory_bytes: int, *, again: bool = False) -> None:
    """Limit memory (on Linux), processor time, file sizes and child processes of this process.

    With `again`, time is limited on top of what was used, and both can be for a further file.
    """
    global _confined, _pages
    if resource is None or sys.platform == "win32":
        return
    _confined = True
    for_ever = (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE, resource.RLIMIT_NPROC)
    limits = dict.fromkeys(for_ever, 0)
    limits[resource.RLIMIT_CPU] = cpu_s + again * (int(time.process_time()) + 1)
    if sys.platform == "linux":
        if _pages is None:  # later this process can open no file
            _pages = int(Path("/proc/self/statm").read_bytes().split()[0])
        limits[resource.RLIMIT_AS] = memory_bytes + _pages * resource.getpagesize()
    for what, most in limits.items():
        hard = resource.getrlimit(what)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (most, hard if again and what not in for_ever else most))
    signal.alarm(WALL_LIMIT_S)


_pages: int | None = None
_handed: bytes | None = None


def file_bytes(
    path: Path, expected: str, limit: int, *, error: type[ClradarError] = MeasurementError
) -> bytes:
    """Return a file's content, handed over or read; then this process can open nothing any more."""
    content = read_bytes(path, expected, limit, error=error) if _handed is None else _handed
    forbid_opening()
    return content


def forbid_opening() -> None:
    """Let this process open nothing any more, if it is one that reads for another."""
    if _confined and sys.platform != "win32":
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))  # of numbers of files from now on
