"""Read a file in a confined process, which a hostile file can crash but not use.

Libraries that read files may not be safe against damaged ones: the HDF5 library, with a few bytes
changed, loops for ever, allocates without bound, divides by zero or overwrites its own memory;
readers of meshes believe counts. So each file is read by a process that has just been forked for
it from a small server (started at the first need, some tenths of a second; a fork takes
milliseconds). That process has a limit of memory and of time, cannot write files or start
programs, and once the reader has its files open it cannot open anything else.

Systems other than Linux cannot do that: there a process is started for each file, which takes
some tenths of a second. macOS does not limit its memory; Windows limits nothing but the time. With
CLRADAR_READERS=spawn in the environment Linux starts one for each file, too: a way to try it.
"""

from __future__ import annotations

import atexit
import codecs
import importlib
import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from clradar.errors import ClradarError, MeasurementError
from clradar.files.confined import wire
from clradar.files.failures import clean, fail, shown
from clradar.files.limits import MAX_REQUEST_BYTES, START_LIMIT_S, WALL_LIMIT_S

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_READY = b"ready"
_ENCODINGS = ("ascii", "latin-1", "utf-8", "utf-8-sig", "raw-unicode-escape", "cp437")
"""Of what is read; the last one is that of names in ZIP archives."""

_START = """import sys
sys.path[:] = {path!r}
from importlib.util import find_spec, module_from_spec
for name in ("clradar", "clradar.dataset", "measurement_io"):
    if spec := find_spec(name):
        sys.modules[name] = module_from_spec(spec)
from {module} import {call}
"""
"""The packages are there and nothing of them is imported: readers need few of their modules."""

_FORKS = sys.platform == "linux" and os.environ.get("CLRADAR_READERS") != "spawn"
"""Whether the server works: it passes on sockets, and reads /proc."""

_lock = threading.Lock()
_server: tuple[subprocess.Popen[bytes], socket.socket] | None = None
_confined = False


@dataclass(frozen=True, slots=True)
class Reader:
    """What reads a kind of file, and how much of the machine it may take for one.

    Attributes
    ----------
    expected : str
        What the file should be, for messages: "a readable HDF5 file".
    library : str
        What may crash on it: "the HDF5 library".
    cpu_s : int
        Processor time in seconds.
    memory_bytes : int
        Memory on top of what the process has when it starts.
    most_bytes : int
        Most bytes of arrays that may come back.
    modules : tuple of str
        Modules to import before the process is forked: later it can open no file.
    error : type
        Class of the errors that `run` raises.
    """

    expected: str
    library: str
    cpu_s: int
    memory_bytes: int
    most_bytes: int
    modules: tuple[str, ...] = ()
    error: type[ClradarError] = MeasurementError


def run(reader: Reader, function: Callable[..., Any], path: Path, *arguments: Any) -> Any:
    """Call `function(path, *arguments)` in a confined process and return its result.

    Parameters
    ----------
    reader : Reader
    function : callable
        Of a module, by its name there. It returns what `clradar.files.confined.wire` can send, and
        calls `forbid_opening` when it has opened what it needs.
    path : Path
    *arguments
        What JSON can hold.

    Raises
    ------
    ClradarError
        `reader.error`: what the function raises, or that the process died of the file or of
        its limits.
    """
    request = {
        "module": function.__module__,
        "function": function.__qualname__,
        "modules": reader.modules,
        "folder": os.getcwd(),
        "path": os.fspath(path),
        "arguments": arguments,
        "expected": reader.expected,
        "cpu_s": reader.cpu_s,
        "memory_bytes": reader.memory_bytes,
    }
    message = json.dumps(request).encode("ascii")
    if len(message) > MAX_REQUEST_BYTES:
        got = f"{len(message)} bytes of them"
        fail(path, "a path and keys of sane length", got, error=reader.error)
    try:
        if _FORKS:
            answer = _answer_of(message, reader.most_bytes)
        else:
            answer = _answer_of_one(message, reader.most_bytes, reader.cpu_s)
    except NoServer as error:
        fail(path, "a process to read it in", clean(error), error=reader.error, cause=error)
    except (wire.BrokenMessage, OSError) as error:
        limits = f"{reader.cpu_s} s or {reader.memory_bytes >> 20} MiB"
        got = f"one on which {reader.library} crashes, or takes more than {limits}"
        fail(path, reader.expected, got, error=reader.error, cause=error)
    if not isinstance(answer, dict) or ("error" in answer) == ("result" in answer):
        got = "an invalid answer of the reading process"
        fail(path, reader.expected, got, error=reader.error)
    if "error" in answer:
        raise reader.error(clean(answer["error"]))
    return answer["result"]


class NoServer(Exception):
    """The server does not start, which no file can cause."""


def _answer_of(message: bytes, most_bytes: int) -> Any:
    """Send a request, and once more if the server itself died, which no file can cause."""
    if sys.platform == "win32":  # which has no such sockets
        raise NotImplementedError
    for last in (False, True):
        process, link = _running_server()
        ours, theirs = socket.socketpair()
        with ours:
            try:
                with theirs:
                    socket.send_fds(link, [message], [theirs.fileno()])
                return wire.receive(ours, most_bytes)
            except (wire.BrokenMessage, OSError):
                if last or process.poll() is None:
                    raise
        _stop_server()
    raise AssertionError


def _running_server() -> tuple[subprocess.Popen[bytes], socket.socket]:
    global _server
    with _lock:
        if _server is None:
            try:
                _server = _start_server()
            except OSError as error:
                raise NoServer(clean(error)) from error
        return _server


def _start_server() -> tuple[subprocess.Popen[bytes], socket.socket]:
    if sys.platform == "win32":  # which has no such sockets
        raise NotImplementedError
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        process = _started(
            f"serve; serve({theirs.fileno()})",
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
    greeting = ours.recv(MAX_REQUEST_BYTES)
    if greeting != _READY:
        ours.close()
        process.kill()
        process.wait()
        raise OSError(f"it does not start: {greeting.decode() or sys.executable}")
    return process, ours


def _started(call: str, **options: Any) -> subprocess.Popen[bytes]:
    """Start Python with a function of this module."""
    path = [os.path.abspath(entry) for entry in sys.path]
    return subprocess.Popen(
        [sys.executable, "-c", _START.format(path=path, module=__name__, call=call)],
        stderr=subprocess.DEVNULL,  # the C library prints there when it finds damage
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        **options,
    )


def _answer_of_one(message: bytes, most_bytes: int, cpu_s: int) -> Any:
    """Send a request to a process that is started for it."""
    pipe = subprocess.PIPE
    try:
        process = _started("serve_one; serve_one()", stdin=pipe, stdout=pipe)
    except OSError as error:
        raise NoServer(clean(error)) from error
    assert process.stdin is not None
    answer = cast(io.BufferedReader, process.stdout)
    timer = threading.Timer(START_LIMIT_S + 2 * cpu_s, process.kill)
    timer.start()
    try:
        with process, process.stdin as requests:
            if answer.read(len(_READY)) != _READY:
                raise NoServer(f"it does not start: {sys.executable}")
            requests.write(message)
            requests.close()
            link = SimpleNamespace(recv_into=answer.readinto, sendall=None)
            try:
                return wire.receive(link, most_bytes)
            finally:
                process.kill()
    finally:
        timer.cancel()


@atexit.register
def _stop_server() -> None:
    global _server
    with _lock:
        if _server is None:
            return
        process, link = _server
        _server = None
        link.close()
        process.kill()
        process.wait()


def _forget_server() -> None:
    """A forked process has a server of its own: this one answers its parent."""
    global _server, _lock
    if _server is not None:
        _server[0].returncode = 0  # it is not this process's to wait for
    _server, _lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_server)


# ---- the other side


def serve(link_number: int) -> None:
    """Answer requests, each in a forked process, until the other end closes."""
    if sys.platform == "win32":  # which has no such sockets
        raise NotImplementedError
    warnings.simplefilter("ignore")  # of forks, which are intended here
    with socket.socket(fileno=link_number) as link:
        for encoding in _ENCODINGS:
            codecs.lookup(encoding)  # loads it
        link.send(_READY)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # ended processes need no wait
        while True:
            message, handles, _, _ = socket.recv_fds(link, MAX_REQUEST_BYTES, 1)
            if not message:
                return
            # Here, so that they are imported once and not by every process.
            with suppress(Exception):
                _import_all(json.loads(message))
            if os.fork() == 0:
                link.close()
                with suppress(BaseException):
                    _answer(json.loads(message), socket.socket(fileno=handles[0]))
                os._exit(0)
            for handle in handles:
                os.close(handle)


def serve_one() -> None:
    """Answer the request on standard input on standard output."""
    warnings.simplefilter("ignore")
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is no answer
        for encoding in _ENCODINGS:
            codecs.lookup(encoding)
        answer.write(_READY)
        answer.flush()
        request = json.loads(sys.stdin.buffer.read())
        with suppress(Exception):
            _import_all(request)
        _answer(request, SimpleNamespace(sendall=answer.write, recv_into=None))


def _import_all(request: dict[str, Any]) -> None:
    for name in (request["module"], *request["modules"]):
        importlib.import_module(name)


def _answer(request: dict[str, Any], link: wire.Link) -> None:
    _limit(request["cpu_s"], request["memory_bytes"])
    path = Path(request["path"])
    try:
        os.chdir(request["folder"])
        _import_all(request)
        function = getattr(sys.modules[request["module"]], request["function"])
        wire.send(link, {"result": function(path, *request["arguments"])})
    except ClradarError as error:
        wire.send(link, {"error": str(error)})
    except Exception as error:
        got = f"{type(error).__name__}: {clean(error)}"
        wire.send(link, {"error": f"{shown(path)}: expected {request['expected']}, got {got}"})


def _limit(cpu_s: int, memory_bytes: int) -> None:
    """Limit memory, processor time, file sizes and child processes of this process.

    Only Linux says how much memory a process has, and holds it to its limit.
    """
    global _confined
    if resource is None or sys.platform == "win32":
        return
    _confined = True
    limits = [
        (resource.RLIMIT_CPU, cpu_s),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NPROC, 0),
    ]
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_bytes().split()[0])
        limits.append((resource.RLIMIT_AS, memory_bytes + pages * resource.getpagesize()))
    for what, most in limits:
        hard = resource.getrlimit(what)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (most, most))
    signal.alarm(WALL_LIMIT_S)


def forbid_opening() -> None:
    """Let this process open nothing any more, if it is one that reads for another."""
    if not _confined or sys.platform == "win32":
        return
    free = os.dup(0)
    os.close(free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (free, free))
