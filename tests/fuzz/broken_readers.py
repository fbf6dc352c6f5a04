"""Targets whose readers do what no reader may: the harness has to notice each of them."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from fuzz.targets import Target


def _seeds() -> list[bytes]:
    return [b"0123456789"]


def _target(name: str, misbehave: object) -> Target:
    def read(path: Path) -> object:
        content = path.read_bytes()
        if content in _seeds():
            return content
        if len(content) % 7 == 3:  # some inputs only
            misbehave(path)  # type: ignore[operator]
        raise MeasurementError(f"{path}: expected ten digits, got something else")

    return Target(name, _seeds, read, (bytes,))


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
    np.ones(1_500_000_000, np.uint8)


def _hang(path: Path) -> None:
    while True:
        time.sleep(1)


def _die(path: Path) -> None:
    signal.raise_signal(signal.SIGSEGV)


other_exception = _target("other_exception", _other_exception)
two_lines = _target("two_lines", _two_lines)
no_name = _target("no_name", _no_name)
subclass = _target("subclass", _subclass)
run_a_command = _target("run_a_command", _run_a_command)
start_a_program = _target("start_a_program", _start_a_program)
run_code = _target("run_code", _run_code)
import_a_module = _target("import_a_module", _import)
write = _target("write", _write)
open_another = _target("open_another", _open_another)
take_memory = _target("take_memory", _take_memory)
hang = _target("hang", _hang)
die = _target("die", _die)
