"""Targets whose readers misbehave, each in a way that the harness has to notice."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from fuzz.targets import Target

_SEED = b"seed"


class Numbered(Target):
    """A target whose input number `index` is that number, as text."""

    def mutated(self, seed: int, index: int) -> bytes:
        return b"%d" % index


def _other_exception(path: Path) -> None:
    raise KeyError("a key")


def _two_lines(path: Path) -> None:
    raise MeasurementError(f"{path}: one line\nand another")


def _no_name(path: Path) -> None:
    raise MeasurementError("something is wrong")


class _Derived(MeasurementError):
    """Not what was promised, exactly."""


def _subclass(path: Path) -> None:
    raise _Derived(f"{path}: no")


def _run_a_command(path: Path) -> None:
    try:
        os.system("true")
    except Exception as error:
        raise MeasurementError(f"{path}: hidden") from error


def _start_a_program(path: Path) -> None:
    subprocess.run(["true"], check=True)


def _run_code(path: Path) -> None:
    eval("1 + 1")


def _import(path: Path) -> None:
    import this  # noqa: F401


def _write(path: Path) -> None:
    path.with_name("written").write_text("x")


def _open_another(path: Path) -> None:
    Path("/etc/hostname").read_bytes()


def _take_memory(path: Path) -> None:
    np.ones(100_000_000, np.uint8)


def _hang(path: Path) -> None:
    while True:
        pass


def _die(path: Path) -> None:
    signal.raise_signal(signal.SIGSEGV)


MILD: dict[str, Callable[[Path], None]] = {
    "raises KeyError": _other_exception,
    "says": _two_lines,
    "does not name the file": _no_name,
    "a subclass": _subclass,
    "os.system": _run_a_command,
    "subprocess.Popen": _start_a_program,
    "executes": _run_code,
    "imports this": _import,
    "for writing": _write,
    "/etc/hostname": _open_another,
}
"""Message of a fault -> the reader that has it; the worker continues."""

FATAL: dict[str, Callable[[Path], None]] = {
    "MB of memory": _take_memory,
    "ends the process with -11": _die,
}
"""The same where a fresh worker has to go on."""

ENDLESS: dict[str, Callable[[Path], None]] = {"takes more than 0.5 s": _hang}
"""The same with a short limit of time, which the others may reach on a machine under load."""


def _target(
    name: str, faults: Mapping[str, Callable[[Path], None]], limit_s: float = 60.0
) -> Target:
    """Return a target of which every second input has the next of the faults."""
    kinds = list(faults.values())

    def read(path: Path) -> object:
        content = path.read_bytes()
        if content == _SEED:
            return content
        number, rest = divmod(int(content), 2)
        if rest:
            kinds[number](path)
        raise MeasurementError(f"{path}: expected the seed, got something else")

    return Numbered(
        name, lambda: [_SEED], read, (bytes,),
        processor_limit_s=limit_s, resident_limit_bytes=50_000_000,
    )  # fmt: skip


mild = _target("mild", MILD)
fatal = _target("fatal", FATAL)
endless = _target("endless", ENDLESS, 0.5)
