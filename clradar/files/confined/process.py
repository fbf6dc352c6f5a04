"""Read a file in a confined process, which a hostile file can crash but not use.

A library may loop for ever, allocate without bound or overwrite its own memory on a damaged file.
So each file is read by a process that has just been forked for it from a small one (started at the
first need, some tenths of a second; a fork takes milliseconds). It has a limit of memory and of
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
import os
import signal
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

import numpy as np

from clradar.errors import ClradarError, MeasurementError
from clradar.files.confined import wire
from clradar.files.failures import clean, fail, read_bytes, shown
from clradar.files.limits import MAX_FRAME_BYTES, START_LIMIT_S, WALL_FACTOR

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_READY = b"ready\n"
_ENCODINGS = (
    "ascii", "latin-1", "utf-8", "utf-8-sig", "raw-unicode-escape", "cp437",
    "utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be",
)  # fmt: skip
"""Of what is read: cp437 of names in ZIP archives, UTF-16 and UTF-32 of text in MATLAB files."""

_LATE = ("numpy.ma", "unicodedata")
"""Modules that numpy and Python import late, when no file can be opened any more."""

_FORKS = sys.platform == "linux" and os.environ.get("CLRADAR_READERS") != "spawn"
"""Whether a process that reads is a fork."""

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

    The function is one of a module. It takes and returns what `clradar.files.confined.wire` can
    send, and calls `file_bytes`, or `forbid_opening` when it has opened what it needs. `expected`
    says in messages what the file is to be; `memory_bytes` is on top of what the process has when
    it starts, `most_bytes` limits the arrays that come back, and `modules` are imported, functions
    ("module:name") called before: later it can open no file.

    A companion reads this file and others like it where a process for each would be started; the
    function then takes the content by `file_bytes` alone.
    """
    content, own = None, _forking if _FORKS else companion or Companion()
    if own is companion:
        content = np.frombuffer(read_bytes(path, expected, MAX_FRAME_BYTES, error=error), np.uint8)
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
        "content": content,
        "forks": _FORKS,
    }
    try:
        answer = own.answer(request, most_bytes)
    except NoProcess as cause:
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


class NoProcess(Exception):
    """The process does not start, which no file can cause."""


class Companion:
    """A process that reads files, each in a fork of it; or many, of which it is given the content;
    or a single one.

    It starts at the first need and ends with this object, and another takes over where it dies. In
    a copy for, or a fork of, another process it is a new one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def __reduce__(self) -> Any:
        return Companion, ()

    def answer(self, request: dict[str, Any], most_bytes: int) -> Any:
        secret = os.urandom(16).hex()  # what an earlier file has left is no answer
        with self._lock:
            process = self._running()
            limit_s = START_LIMIT_S + (WALL_FACTOR if resource else 2) * request["cpu_s"]
            timer = threading.Timer(limit_s, _end, (process,))
            timer.start()
            try:
                wire.send(process.stdin, {**request, "secret": secret})
                answer = wire.receive(process.stdout, most_bytes)
                if not isinstance(answer, dict) or answer.pop("secret", None) != secret:
                    raise wire.BrokenMessage("of another request")
            except BaseException:  # an interruption, too: the rest of its answer is still to come
                self.end()
                raise
            finally:
                timer.cancel()
            return answer

    def end(self) -> None:
        if self._process is not None:
            _end(self._process)
            self._process = None

    def _running(self) -> subprocess.Popen[bytes]:
        process = self._process
        if process is None or self._owner != os.getpid() or process.poll() is not None:
            process = self._process = _started()
            self._owner = os.getpid()
            weakref.finalize(self, _end, process)
        return process


def _started() -> subprocess.Popen[bytes]:
    """Start Python with `serve`."""
    path = [os.path.abspath(entry) for entry in sys.path]
    code = f"import sys; sys.path[:] = {path!r}; from {__name__} import serve; serve()"
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # the C library prints there when it finds damage
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # it has no Ctrl-C, and ends with its forks
        )
    except OSError as error:
        raise NoProcess(clean(error)) from error
    assert process.stdout is not None
    if not any(line.endswith(_READY) for line in process.stdout):  # others may print before
        _end(process)
        raise NoProcess(f"it does not start: {sys.executable}")
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(OSError), process:  # closes its pipes and waits
        if process.poll() is None:
            if sys.platform == "win32":
                process.kill()
            else:
                os.killpg(process.pid, signal.SIGKILL)


_forking = Companion()
atexit.register(_forking.end)
if hasattr(os, "register_at_fork"):
    # It may be held by a thread that is not there.
    os.register_at_fork(after_in_child=lambda: setattr(_forking, "_lock", threading.Lock()))


# ---- the other side


def serve() -> None:
    """Answer requests on standard input until it closes: each in a fork, or with the content of its
    file; one that is without is the last."""
    global _handed
    warnings.simplefilter("ignore")  # of forks, too, which are intended here
    with _greet() as answer, suppress(wire.BrokenMessage):
        while True:
            request = wire.receive(sys.stdin.buffer, MAX_FRAME_BYTES)
            with suppress(Exception):  # once, and not by every fork
                _import_all(request)
            if sys.platform != "win32" and request["forks"] and (child := os.fork()):
                if os.waitpid(child, 0)[1]:  # its answer may be cut short
                    return
                continue
            if request["content"] is not None:
                _handed = request["content"].tobytes()
            failed = True
            with suppress(BaseException):
                _answer(request, answer)
                failed = False
            if failed or _handed is None:
                os._exit(failed)


def _greet() -> BinaryIO:
    """Say that this process has started; return its output, which nothing else can write to."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    answer.write(_READY)
    answer.flush()
    return answer


def _import_all(request: dict[str, Any]) -> None:
    for encoding in _ENCODINGS:
        codecs.lookup(encoding)  # loads it
    for name in (request["module"], *request["modules"], *_LATE):
        if callable(found := resolve_name(name if ":" in name else f"{name}:")):
            found()


def _answer(request: dict[str, Any], answer: Any) -> None:
    _limit(request["cpu_s"], request["memory_bytes"], again=_handed is not None)
    if _handed is None:
        with suppress(OSError):
            os.chdir(request["folder"])
    else:
        forbid_opening()
    reply(request, answer)


def reply(request: dict[str, Any], answer: Any) -> None:
    """Call the function of a request, and send what it returns, or its error."""
    path, found = Path(request["path"]), {"secret": request["secret"]}
    try:
        _import_all(request)
        function = getattr(sys.modules[request["module"]], request["function"])
        wire.send(answer, {**found, "result": function(path, *request["arguments"])})
    except ClradarError as error:
        wire.send(answer, {**found, "error": str(error)})
    except Exception as error:
        got = f"{type(error).__name__}: {clean(error)}"
        text = f"{shown(path)}: expected {request['expected']}, got {got}"
        wire.send(answer, {**found, "error": text})


def _limit(cpu_s: int, memory_bytes: int, *, again: bool) -> None:
    """Limit memory (on Linux), processor time, file sizes and child processes of this process.

    With `again`, memory and time can be limited anew for a further file.
    """
    global _confined, _pages
    if resource is None or sys.platform == "win32":
        return
    _confined = True
    for_ever = (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE, resource.RLIMIT_NPROC)
    limits = dict.fromkeys(for_ever, 0)
    limits[resource.RLIMIT_CPU] = cpu_s + int(time.process_time()) + 1
    if sys.platform == "linux":
        if _pages is None:  # later this process can open no file
            _pages = int(Path("/proc/self/statm").read_bytes().split()[0])
        limits[resource.RLIMIT_AS] = memory_bytes + _pages * resource.getpagesize()
    for what, most in limits.items():
        hard = resource.getrlimit(what)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (most, hard if again and what not in for_ever else most))


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
