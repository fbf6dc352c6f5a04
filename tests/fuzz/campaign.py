"""Have a worker read many inputs, watch it, restart it when it dies, and report the faults."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import time
from dataclasses import dataclass
from functools import cache
from multiprocessing import forkserver
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from fuzz.worker import Progress, find_target, run_quietly, shared_progress

_WAIT_LIMIT_S = 1800.0
"""Longest time without progress. What is at fault uses processor time, which is limited."""

_MOST_FAULTS = 20
"""A run ends after so many: they have one cause, mostly."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One input that ended otherwise than allowed; `saved` is the file with its bytes."""

    target: str
    seed: int
    index: int
    what: str
    saved: Path

    def __str__(self) -> str:
        return f"{self.target}, seed {self.seed}, input {self.index}: {self.what} [{self.saved}]"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run."""

    results: int
    errors: int
    faults: tuple[Fault, ...]
    slowest_s: float
    peak_bytes: int
    wall_s: float

    def __str__(self) -> str:
        counts = f"{self.results} results, {self.errors} errors, {len(self.faults)} faults"
        cost = f"slowest {self.slowest_s:.2f} s, peak {self.peak_bytes / 1e6:.0f} MB"
        return "\n".join([f"{counts}; {cost}; {self.wall_s:.0f} s", *map(str, self.faults)])


def run(
    target: str,
    count: int,
    *,
    seed: int = 0,
    start: int = 0,
    keep: Path,
) -> Outcome:
    """Read inputs `start` to `start + count` of a target.

    Parameters
    ----------
    target : str
        A name in `fuzz.targets.TARGETS`, or `module:attribute`.
    count, seed, start : int
        Input `index` of a `seed` is always the same.
    keep : Path
        Folder for the inputs at fault; made when there is one.
    """
    began = time.monotonic()
    # In memory where the system offers it: every input is written to a file.
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    faults: list[Fault] = []
    with TemporaryDirectory(prefix="clradar-fuzz-", dir=base) as name:
        folder = Path(name)
        at, stop = start, start + count
        while at < stop and len(faults) < _MOST_FAULTS:
            what, at = _watched(target, seed, at, stop, folder)
            if what is None:
                continue
            fault = Fault(target, seed, at, what, _newest(folder / "files"))
            faults.append(_kept(fault, keep))
            at += 1
        for line in _lines(folder / "faults.jsonl"):
            fault = Fault(target, seed, line["index"], line["what"], Path(line["saved"]))
            faults.append(_kept(fault, keep))
        with shared_progress(folder) as shared:
            done = Progress.load(shared)
    return Outcome(
        done.results,
        done.errors,
        tuple(faults),
        done.slowest_s,
        done.peak_bytes,
        time.monotonic() - began,
    )


def _watched(target: str, seed: int, start: int, stop: int, folder: Path) -> tuple[str | None, int]:
    """Run one worker; return what it died of (None: of nothing) and the input it had come to."""
    output = folder / "output"
    with shared_progress(folder) as shared:
        progress = Progress.load(shared)
        progress.index, progress.reading = start, 0
        progress.store(shared)
        worker = _workers().Process(target=run_quietly, args=(target, seed, start, stop, folder))
        worker.start()
        try:
            last = progress
            while worker.is_alive():
                worker.join(_WAIT_LIMIT_S)
                progress = Progress.load(shared)
                if worker.is_alive() and progress == last:
                    _require(bool(progress.reading), "the worker did not start", output)
                    return f"does nothing for {_WAIT_LIMIT_S:g} s", progress.index
                last = progress
        finally:
            if worker.is_alive():
                worker.kill()
                worker.join()
        progress = Progress.load(shared)
    if worker.exitcode == 0:
        return None, progress.index
    if worker.exitcode == -signal.SIGPROF:
        limit_s = find_target(target).processor_limit_s
        return f"takes more than {limit_s:g} s of processor time", progress.index
    _require(bool(progress.reading), f"the worker ended with {worker.exitcode}", output)
    return f"ends the process with {worker.exitcode}: {_tail(output)}", progress.index


@cache
def _workers() -> multiprocessing.context.ForkServerContext:
    """Forks of one process that has imported the readers, which takes longer than a short run."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["fuzz.worker", "fuzz.targets"])
    here = Path(__file__).resolve().parent
    folders = [here.parent, here.parent / "support", here.parents[1]]
    paths = [*map(str, folders), os.environ.get("PYTHONPATH", "")]
    changed = {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    with patch.dict(os.environ, changed):
        # The worker may start no process: readers are forked by a server that the seeds start.
        os.environ.pop("CLRADAR_READERS", None)
        forkserver.ensure_running()
    return context


def _require(condition: bool, what: str, output: Path) -> None:
    if not condition:
        raise RuntimeError(f"fuzz: {what}: {_tail(output)}")


def _tail(output: Path) -> str:
    return " ".join(output.read_text(errors="replace")[-1500:].split())


def _newest(folder: Path) -> Path:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return max(files, key=lambda path: path.stat().st_mtime_ns)


def _kept(fault: Fault, keep: Path) -> Fault:
    keep.mkdir(parents=True, exist_ok=True)
    name = fault.target.replace(":", ".").replace("/", ".")
    target = keep / f"{name}-{fault.seed}-{fault.index}"
    shutil.copy(fault.saved, target)
    return Fault(fault.target, fault.seed, fault.index, fault.what, target)


def _lines(path: Path) -> list[dict]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
