"""Read many mutated files in a process of its own, judge each outcome, and report the faults.

Allowed: a result of the target, or its error on printable lines that name the file. A fault is
anything else: another exception, a command run, a module imported, a file opened that is not the
input, too much memory or time, the end of the process.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import re
import resource
import signal
import sys
import time
import warnings
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import reader_probes

from clradar.errors import ClradarWarning
from fuzz.targets import TARGETS, Target
from measurement_io.confined import reading as confined

ADDRESS_SPACE_BYTES = 8 * 2**30
"""What a worker may allocate on top of what it has, so that a bomb does not take the machine."""

_WAIT_LIMIT_S = 1800.0
"""Longest time without progress. What is at fault uses processor time, which is limited."""

_MOST_FAULTS = 20
"""A run ends after so many: they have one cause, mostly."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One input that ended otherwise than allowed; `saved` is the file with its bytes."""

    name: str
    index: int
    what: str
    saved: Path

    def __str__(self) -> str:
        return f"{self.name}, input {self.index}: {self.what} [{self.saved}]"


@dataclass(slots=True)
class Outcome:
    """What came of a run."""

    results: int = 0
    errors: int = 0
    faults: list[Fault] = field(default_factory=list)
    slowest_s: float = 0.0
    peak_bytes: int = 0

    def __str__(self) -> str:
        counts = f"{self.results} results, {self.errors} errors, {len(self.faults)} faults"
        cost = f"slowest {self.slowest_s:.2f} s, peak {self.peak_bytes / 1e6:.0f} MB"
        return "\n".join([f"{counts}; {cost}", *map(str, self.faults)])


def find_target(name: str) -> Target:
    """Return a target by its name, or by `module:attribute` (for the tests of this harness)."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute) if attribute else TARGETS[name]


def run(name: str, count: int, *, seed: int = 0, start: int = 0, keep: Path) -> Outcome:
    """Read inputs `start` to `start + count` of a target; those at fault are kept in a folder."""
    outcome, at, stop = Outcome(), start, start + count
    while at < stop and len(outcome.faults) < _MOST_FAULTS:
        at = _watched(outcome, name, seed, at, stop, keep)
    return outcome


def _watched(outcome: Outcome, name: str, seed: int, at: int, stop: int, keep: Path) -> int:
    """Add what one worker does to an outcome; return the input after the last one that it read."""
    target = find_target(name)

    def note(what: str) -> None:
        keep.mkdir(parents=True, exist_ok=True)
        saved = keep / f"{name.replace(':', '.')}-{seed}-{at}"
        saved.write_bytes(target.mutated(seed, at))
        outcome.faults.append(Fault(name, at, what, saved))

    # In memory where the system offers it: every input is written to a file.
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with TemporaryDirectory(prefix="clradar-fuzz-", dir=base) as folder:
        here, there = multiprocessing.Pipe(duplex=False)
        arguments = (name, seed, at, stop, Path(folder), there)
        worker = _workers().Process(target=_work, args=arguments)
        worker.start()
        there.close()
        reading, what = False, f"does nothing for {_WAIT_LIMIT_S:g} s"
        try:
            while here.poll(_WAIT_LIMIT_S):
                kind, fault, spent_s, peak_bytes = here.recv()
                reading = kind == "reading"
                if reading:
                    continue
                outcome.results += kind == "result"
                outcome.errors += kind == "error"
                outcome.slowest_s = max(outcome.slowest_s, spent_s)
                outcome.peak_bytes = max(outcome.peak_bytes, peak_bytes)
                if kind == "fault":
                    note(fault)
                at += 1
        except EOFError:
            worker.join()
            output = " ".join((Path(folder) / "output").read_text(errors="replace")[-1500:].split())
            what = f"ends the process with {worker.exitcode}: {output}"
            if worker.exitcode == -signal.SIGPROF:
                what = f"takes more than {target.processor_limit_s:g} s of processor time"
        finally:
            worker.kill()
            worker.join()
        if worker.exitcode == 0:
            return at
        if not reading:
            raise RuntimeError(f"fuzz: the worker {what}")
        note(what)
        return at + 1


@cache
def _workers() -> multiprocessing.context.ForkServerContext:
    """Forks of one process that has imported the readers, which takes longer than a short run."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["fuzz.harness"])
    tests = Path(__file__).resolve().parents[1]
    paths = [str(tests), str(tests / "support"), str(tests.parent), os.getenv("PYTHONPATH", "")]
    with patch.dict(os.environ, {"PYTHONPATH": os.pathsep.join(filter(None, paths))}):
        # The worker may start no process: readers are forked by a server that the seeds start.
        os.environ.pop("CLRADAR_READERS", None)
        forkserver.ensure_running()
    return context


def _work(name: str, seed: int, start: int, stop: int, folder: Path, out: Connection) -> None:
    """Read inputs in this process; what is printed goes to FOLDER/output."""
    with open(folder / "output", "wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    # Ours are meant for users; one that leaks from a library is a fault.
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", ClradarWarning)
    target = find_target(name)
    (folder / "files").mkdir()
    path = target.place(folder / "files")
    watch = Watch(folder / "files")
    probe = path.with_name("probe")  # starts the process that any input may need
    probe.write_bytes(b"-")
    confined.run(reader_probes.same, probe, 1)
    probe.unlink()
    for content in target.seeds():  # later nothing has to be imported or started
        path.write_bytes(content)
        kind, fault = judge(target, path)
        if kind != "result":
            raise RuntimeError(f"a seed of {name} gives no result: {kind} {fault}")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + ADDRESS_SPACE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    for index in range(start, stop):
        path.write_bytes(target.mutated(seed, index))
        out.send(("reading", None, 0.0, 0))
        began = time.process_time()
        # The system ends this process where the time is up, whatever library it is in.
        signal.setitimer(signal.ITIMER_PROF, target.processor_limit_s)
        kind, fault = judge(target, path, watch)
        signal.setitimer(signal.ITIMER_PROF, 0)
        out.send((kind, fault, time.process_time() - began, _peak_bytes()))
        if fault is not None and "of memory" in fault:
            break  # the peak stays: a fresh process sees the next one


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
            path, _, flags = arguments[:3]
            if isinstance(flags, int) and flags & _WRITING:
                return f"opens {path!r} for writing"
            name = "" if isinstance(path, int) else os.path.realpath(os.fsdecode(path))
            module = _importing() and name.endswith((".py", ".pyc"))
            own = not name or module or name.startswith(self._folder + os.sep)
            return None if own else f"opens {name!r}"
        if event == "import":
            name = str(arguments[0])
            return None if name.split(".")[0] in _LATE_IMPORTS else f"imports {name}"
        if event == "exec":
            # A module that is imported late is executed too; any other code is foreign.
            name = getattr(arguments[0], "co_name", "?")
            return None if name == "<module>" and _importing() else f"executes {name}"
        if event == "pickle.find_class":
            return f"unpickles the name {arguments[0]}.{arguments[1]} by the standard library"
        if event.startswith(_FORBIDDEN) and not (event == "marshal.loads" and _importing()):
            return f"{event} {arguments!r:.200}"
        return None


def _importing() -> bool:
    frame: Any = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def judge(target: Target, path: Path, watch: Watch | None = None) -> tuple[str, str | None]:
    """Read one input; return ("result" | "error" | "fault") and, for a fault, what it is."""
    before = _peak_bytes()
    if watch is not None:
        watch.seen.clear()
        watch.armed = True
    try:
        found = target.read(path)
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
