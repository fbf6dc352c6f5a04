"""Read many inputs of one target in a process of its own; `campaign` starts and watches it.

FOLDER/progress holds a `Progress`, shared with the parent; the input that is being read lies where
the target wants it. Faults go to FOLDER/faults.jsonl, their inputs to FOLDER/fault-NUMBER.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import mmap
import os
import resource
import signal
import struct
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

import reader_probes

from clradar.errors import ClradarWarning
from fuzz.oracle import Watch, judge, resident_peak_bytes
from fuzz.targets import Target
from measurement_io.confined import reading as confined

ADDRESS_SPACE_BYTES = 8 * 2**30
"""What a worker may allocate on top of what it has, so that a bomb does not take the machine."""


@dataclass(slots=True)
class Progress:
    """How far a run has come: what worker and parent share, in the bytes of one mapped file."""

    index: int = 0
    reading: int = 0  # 1 while an input is being read, 0 while the worker starts or makes one
    results: int = 0
    errors: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0

    def store(self, shared: mmap.mmap) -> None:
        shared[: _PROGRESS.size] = _PROGRESS.pack(*astuple(self))

    @classmethod
    def load(cls, shared: mmap.mmap) -> Progress:
        return cls(*_PROGRESS.unpack(shared[: _PROGRESS.size]))


_PROGRESS = struct.Struct("<QQQQdQ")


@contextmanager
def shared_progress(folder: Path) -> Iterator[mmap.mmap]:
    """Yield the bytes of FOLDER/progress, made when there is none."""
    path = folder / "progress"
    if not path.exists():
        path.write_bytes(bytes(_PROGRESS.size))
    with open(path, "r+b") as file, mmap.mmap(file.fileno(), _PROGRESS.size) as shared:
        yield shared


def run_quietly(name: str, seed: int, start: int, stop: int, folder: Path) -> None:
    """Read inputs `start` to `stop` of a target; what is printed goes to FOLDER/output."""
    with open(folder / "output", "wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    run(find_target(name), seed, start, stop, folder)


def find_target(name: str) -> Target:
    """Return a target by its name, or by `module:attribute` (for the tests of this harness)."""
    if ":" in name:
        module, attribute = name.split(":")
        target: Target = getattr(importlib.import_module(module), attribute)
        return target
    from fuzz.targets import TARGETS

    return TARGETS[name]


def run(target: Target, seed: int, start: int, stop: int, folder: Path) -> None:
    faulthandler.enable()
    # Ours are meant for users; one that leaks from a library is a fault.
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", ClradarWarning)
    place = folder / "files"
    place.mkdir(exist_ok=True)
    path = target.place(place)
    watch = Watch(place)
    read_seeds(target, path)
    limit_address_space()
    with shared_progress(folder) as shared:
        progress = Progress.load(shared)
        for index in range(start, stop):
            path.write_bytes(target.mutated(seed, index))
            progress.index, progress.reading = index, 1
            progress.store(shared)
            began = time.process_time()
            # The system ends this process where the time is up, whatever library it is in.
            signal.setitimer(signal.ITIMER_PROF, target.processor_limit_s)
            outcome, fault = judge(target, path, watch)
            signal.setitimer(signal.ITIMER_PROF, 0)
            progress.slowest_s = max(progress.slowest_s, time.process_time() - began)
            progress.peak_bytes = max(progress.peak_bytes, resident_peak_bytes())
            progress.results += outcome == "result"
            progress.errors += outcome == "error"
            progress.index, progress.reading = index + 1, 0
            progress.store(shared)
            if fault is not None:
                note_fault(folder, path, index, fault)
                if "of memory" in fault:
                    break  # the peak stays: a fresh process sees the next one


def read_seeds(target: Target, path: Path) -> None:
    """Read what is valid: it has to be, and later nothing has to be imported or started."""
    if target.any_format:  # start the process that an input may need that begins as HDF5 does
        probe = path.with_name("probe")
        probe.write_bytes(b"-")
        confined.run(reader_probes.same, probe, 1)
        probe.unlink()
    for content in target.seeds():
        path.write_bytes(content)
        outcome, fault = judge(target, path)
        if outcome != "result":
            raise RuntimeError(f"a seed of {target.name} gives no result: {outcome} {fault}")


def note_fault(folder: Path, path: Path, index: int, what: str) -> None:
    saved = folder / f"fault-{index}"
    saved.write_bytes(path.read_bytes())
    with open(folder / "faults.jsonl", "a", encoding="utf-8") as out:
        out.write(json.dumps({"index": index, "what": what, "saved": str(saved)}) + "\n")


def limit_address_space() -> None:
    """Cap what this process can allocate; only Linux tells how much it has."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except OSError:
        return
    limit = pages * os.sysconf("SC_PAGE_SIZE") + ADDRESS_SPACE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
