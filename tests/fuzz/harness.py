"""Read many mutated files, judge each outcome, and report the faults.

Allowed: a result of the target, or its error on printable lines that name the file. A fault is
anything else: another exception, a command run, a module imported, a file opened that is not the
input, too much memory or time. What parses binary files has a process of its own, which may end.
That takes ten times as long as most inputs need, so one process reads many, and an input that is
at fault there, or ends it, is judged as users read it.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any
from unittest import mock

from clradar.errors import ClradarWarning
from clradar.files.confined import process, wire
from fuzz.targets import Target

_MOST_FAULTS = 20
"""A run ends after so many: they have one cause, mostly."""

_LONG_S = 1.0
"""Processor time that ends a process with many inputs: a library's loop raises no exception."""


@dataclass(slots=True)
class Outcome:
    """What came of a run, and how many were judged again. Of each fault number, what, kept file."""

    results: int = 0
    errors: int = 0
    again: int = 0
    faults: list[tuple[int, str, Path]] = field(default_factory=list)

    def __str__(self) -> str:
        counts = f"{self.results} results, {self.errors} errors, {len(self.faults)} faults"
        lines = [f"input {index}: {what} [{saved}]" for index, what, saved in self.faults]
        return "\n".join([f"{counts}; {self.again} judged again", *lines])


def run(target: Target, count: int, *, seed: int = 0, start: int = 0, keep: Path) -> Outcome:
    """Read inputs `start` to `start + count` of a target; those at fault are kept in a folder."""
    outcome = Outcome()
    # In memory where the system offers it: every input is written to a file.
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with TemporaryDirectory(prefix="clradar-fuzz-", dir=base) as folder, warnings.catch_warnings():
        # Ours are meant for users; one that leaks from a library is a fault.
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ClradarWarning)
        path = target.place(Path(folder))
        for content in target.seeds():  # later nothing has to be imported or started
            path.write_bytes(content)
            found = [judge(target, path)]
            with _readers_here():
                found.append(judge(target, path))
            assert found == 2 * [("result", None)], f"a seed of {target.file_name} gives: {found}"
        watch = _watch()
        watch.folder = os.path.realpath(folder)
        with closing(_kinds(target, path, seed, list(range(start, start + count)))) as kinds:
            for index, kind in kinds:
                fault = None
                if kind == "fault":
                    path.write_bytes(target.mutated(seed, index))
                    kind, fault = judge(target, path, watch)
                    outcome.again += 1
                outcome.results += kind == "result"
                outcome.errors += kind == "error"
                if fault is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    saved = keep / f"{target.file_name.replace('/', '-')}-{seed}-{index}"
                    saved.write_bytes(path.read_bytes())
                    outcome.faults.append((index, fault, saved))
                    if len(outcome.faults) == _MOST_FAULTS:
                        break
    return outcome


def _kinds(target: Target, path: Path, seed: int, left: list[int]) -> Iterator[tuple[int, str]]:
    """Yield number and kind of inputs: "fault" also for one that ends the process."""
    while left:
        receiving, sending = os.pipe()
        if (child := os.fork()) == 0:
            with suppress(BaseException), _readers_here():
                for index in left:
                    path.write_bytes(target.mutated(seed, index))
                    signal.setitimer(signal.ITIMER_VIRTUAL, _LONG_S)
                    kind, _ = judge(target, path, _watch())
                    os.write(sending, f"{kind}\n".encode())
                    if kind == "fault":  # the other process takes the file
                        break
            os._exit(0)
        os.close(sending)
        kind = "result"
        try:
            with open(receiving) as kinds:
                for kind in map(str.strip, kinds):
                    yield left.pop(0), kind
        finally:
            os.waitpid(child, 0)
        if left and kind != "fault":
            yield left.pop(0), "fault"


@contextmanager
def _readers_here() -> Iterator[None]:
    """Read binary files in this process."""
    resource = process.resource

    def limit(what: int, most: tuple[int, int]) -> None:
        resource.setrlimit(what, (most[0], resource.getrlimit(what)[1]))

    def answer(request: Any, most_bytes: int) -> Any:
        sent, limits = io.BytesIO(), resource.getrlimit(resource.RLIMIT_NOFILE)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                process.reply({**request, "secret": ""}, sent)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        return wire.receive(io.BytesIO(sent.getvalue()), most_bytes)

    system = SimpleNamespace(**{**vars(resource), "setrlimit": limit})
    here = {"_forking": SimpleNamespace(answer=answer), "_confined": True, "resource": system}
    with mock.patch.multiple(process, **here):
        yield


@cache
def _watch() -> Watch:
    """One for a process: hooks stay."""
    return Watch()


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Processor time, of what Python runs; a confined reader has a limit of its own."""

    def out_of_time(*_: object) -> None:
        raise Canary(f"takes more than {seconds:g} s of processor time")

    before = signal.signal(signal.SIGPROF, out_of_time)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


# ---- what reading may do

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

    def __init__(self) -> None:
        self.armed = False
        self.seen: list[str] = []
        self.folder = ""
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.armed:
            return
        self.armed = False  # what is done here is ours
        try:
            ours = _is_above(process.__file__, ("_started", "_end"))
            fault = None if ours else self._fault(event, arguments)
        finally:
            self.armed = True
        if fault is not None:
            self.seen.append(fault)
            raise Canary(fault)

    def _fault(self, event: str, arguments: tuple[Any, ...]) -> str | None:
        if event == "open":
            path, _, flags = arguments[:3]
            if isinstance(flags, int) and flags & _WRITING:
                return f"opens {path!r} for writing"
            name = "" if isinstance(path, int) else os.path.realpath(os.fsdecode(path))
            module = _importing() and name.endswith((".py", ".pyc"))
            own = not name or module or name.startswith(self.folder + os.sep)
            return None if own else f"opens {name!r}"
        if event == "import":
            name = str(arguments[0])
            known = name in sys.modules or name.split(".")[0] in _LATE_IMPORTS  # or shut out there
            return None if known else f"imports {name}"
        if event == "exec":
            # A module that is imported late is executed too; any other code is foreign.
            name = getattr(arguments[0], "co_name", "?")
            return None if name == "<module>" and _importing() else f"executes {name}"
        if event == "pickle.find_class":
            return f"unpickles the name {arguments[0]}.{arguments[1]} by the standard library"
        if event.startswith(_FORBIDDEN) and not (event == "marshal.loads" and _importing()):
            return f"{event} {arguments!r:.200}"
        return None


def _is_above(file: str, functions: Sequence[str] = ()) -> bool:
    """Whether one of these functions of a file, or any, has called this."""
    frame: Any = sys._getframe(1)
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(file) and code.co_name in (functions or (code.co_name,)):
            return True
        frame = frame.f_back
    return False


_importing = partial(_is_above, "<frozen importlib")


def judge(target: Target, path: Path, watch: Watch | None = None) -> tuple[str, str | None]:
    """Read one input; return ("result" | "error" | "fault") and, for a fault, what it is."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory is that of now
    before = _peak_bytes()
    if watch is not None:
        watch.seen.clear()
    try:
        with _limited(target.processor_limit_s):
            if watch is not None:
                watch.armed = True
            found = target.read(path)
            if watch is not None:
                watch.armed = False
        fault = None if isinstance(found, target.result) else f"returns {type(found).__name__}"
        kind = "result"
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        kind, fault = "error", _fault_of(target, path, error)
    finally:
        if watch is not None:
            watch.armed = False
    if watch is not None and watch.seen:
        fault = watch.seen[0]
    elif (grown := _peak_bytes() - before) > target.resident_limit_bytes:
        fault = f"takes {grown / 1e6:.0f} MB of memory"
    return (kind, None) if fault is None else ("fault", fault)


def _fault_of(target: Target, path: Path, error: BaseException) -> str | None:
    message = str(error)
    first, *lines = message.split("\n")
    if not re.fullmatch(r"[0-9]+ mistakes, one per line:", first):
        lines = [message]
    if type(error) is not target.error:
        return f"raises {type(error).__name__}: {message:.300}"
    if not all(line.isprintable() and len(line) <= 2000 for line in lines):
        return f"says {message[:300]!r} in {len(message)} characters"
    if "Too many open files" in message:
        return f"opens something else than the file: {message:.300}"
    if path.name not in message and target.file_name.split("/")[0] not in message:
        return f"does not name the file: {message!r:.300}"
    return None


def _peak_bytes() -> int:
    """Return the largest resident memory that this process has had."""
    # getrusage counts what the parent had when it forked this process, too.
    status = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in status if line.startswith("VmHWM:")).split()[1]) * 1024
