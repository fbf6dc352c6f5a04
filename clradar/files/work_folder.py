"""Folders that long work is written into: one writer at a time, nothing left of a killed one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from clradar.errors import OutputError
from clradar.files.failures import shown

LOCK = ".lock"

SHOWN = 60
"""Characters of a setting's value in an error."""

LEAD = 20
"""Of these before the first that differs."""


TEMPORARY = ".*.tmp"
"""Names of what is being written (`clradar.files.atomic`)."""


def remove_temporaries(folder: Path) -> None:
    """Remove what a killed process was writing."""
    for path in folder.glob(TEMPORARY):
        with suppress(OSError):
            path.unlink()


@contextmanager
def held(folder: Path, work: str) -> Iterator[None]:
    """Make the folder, and keep other processes from working in it while the block runs.

    Parameters
    ----------
    folder : Path
    work : str
        What is going on in it, for the message: "sweep".

    Raises
    ------
    OutputError
        Another process holds it, it is a file, or it cannot be written.
    """
    import fcntl

    try:
        if os.path.lexists(folder) and not folder.is_dir():
            raise OutputError(f"{shown(folder)}: expected a folder's name, got a file")
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / LOCK, "ab")  # noqa: SIM115 - the block below closes it
    except OutputError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{shown(folder)}: cannot be written: {error}") from error
    with lock:
        try:
            # The system lets go of it when the process ends, however it ends.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise OutputError(f"{shown(folder)}: another {work} is writing into it") from error
        yield


def differences(before: Any, now: Any, name: str = "") -> list[str]:
    """Return in words how two values of JSON differ, one line per setting.

    Short lists are shown whole, of long ones the entries that differ.
    """
    if isinstance(before, dict) and isinstance(now, dict):
        found = []
        for key in {**now, **before}:
            found += differences(before.get(key), now.get(key), f"{name}.{key}" if name else key)
        return found
    if before == now:
        return []
    texts = str(before), str(now)
    if isinstance(before, list) and isinstance(now, list) and max(map(len, texts)) > SHOWN:
        found = []
        for i, (one, other) in enumerate(zip(before, now, strict=False)):
            found += differences(one, other, f"{name}[{i}]")
        if len(before) != len(now):
            found.insert(0, f"{name} of {len(before)}, now of {len(now)}")
        return found
    # Long texts from about where they differ.
    pairs = enumerate(zip(*texts, strict=False))
    common = next((i for i, (one, other) in pairs if one != other), min(map(len, texts)))
    start = common - LEAD if common > SHOWN - LEAD else 0
    return [f"{name} {_cut(texts[0], start)}, now {_cut(texts[1], start)}"]


def _cut(text: str, start: int) -> str:
    cut = ("…" if start else "") + text[start : start + SHOWN]
    return cut + "…" if len(text) > start + SHOWN else cut
