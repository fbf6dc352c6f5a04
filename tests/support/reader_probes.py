"""Functions that tests have called in the process that reads HDF5 files."""

import os
import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

import numpy as np

from clradar.files.confined import process
from clradar.files.failures import fail
from measurement_io.confined import hdf5_guard


def same(path: Path, value: Any) -> Any:
    return value


def arrays(path: Path) -> dict[str, Any]:
    pair = np.zeros(3, np.dtype({"names": ["r", "i"], "formats": ["f4", "f8"], "offsets": [4, 16]}))
    pair["i"] = [1, 2, 3]
    return {
        "complex": (np.arange(6) * (1 - 1j)).astype(np.complex64).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "big-endian": np.arange(3, dtype=">i2"),
        "scalar": np.array(1.5),
        "empty": np.zeros((0, 3), bool),
        "text": np.array([["a", "bc"]]),
        "pair": pair,
    }


def content(path: Path) -> list[Any]:
    read = process.file_bytes(path, "a file", 2**20)
    return [np.frombuffer(read, np.uint8), os.getpid()]


def crash(path: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def loop(path: Path) -> None:
    while True:
        pass


def wait(path: Path) -> None:
    threading.Event().wait()


def take(path: Path, count: int) -> int:
    return int(np.ones(count, np.uint8).sum())


def large(path: Path, count: int) -> np.ndarray:
    return np.zeros(count, np.uint8)


def refuse(path: Path) -> None:
    fail(path, "this", "that")


def write(path: Path, target: str) -> None:
    Path(target).write_text("written")


def open_another(path: Path, other: str) -> str:
    with hdf5_guard.opened(path, "an HDF5 file"):
        return Path(other).read_text()


def open_after_reading(path: Path, other: str) -> str:
    process.file_bytes(path, "a file", 2**20)
    return Path(other).read_text()


def start_a_program(path: Path) -> int:
    with hdf5_guard.opened(path, "an HDF5 file"):
        return subprocess.run(["true"], check=True).returncode
