"""What many tests compare: records, files, and what is said."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clradar import Capture
from clradar.errors import MeasurementError, handled_warnings


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def same_record(a: Any, b: Any) -> bool:
    """Whether two records have the same fields, arrays to the bit."""
    if is_dataclass(a):
        named = (field.name for field in fields(a))
        return type(a) is type(b) and all(same_record(getattr(a, n), getattr(b, n)) for n in named)
    return same_bits(a, b) if isinstance(a, np.ndarray) else a == b


def same_capture(a: Capture, b: Capture) -> bool:
    """Samples, positions and frequencies to the bit."""

    def numbers(of: Capture) -> tuple[np.ndarray, ...]:
        return of.data, of.array.tx_m, of.array.rx_m, of.waveform.frequencies_hz

    return all(map(same_bits, numbers(a), numbers(b)))


def tree(folder: str | Path, *ignored: str) -> dict[str, bytes | int]:
    """What is in a folder: the bytes of its files, the kind of all else."""
    return {
        str(path.relative_to(folder)): path.lstat().st_mode
        if path.is_symlink() or not path.is_file()
        else path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.name not in ignored
    }


def warnings_of(call: Callable[..., Any], *arguments: Any, **options: Any) -> list[str]:
    """What a call warns of, each once."""
    found: list[str] = []
    with handled_warnings(found.append):
        call(*arguments, **options)
    return found


def refusal(read: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """What is said of a file that must not be read: one line, which names it."""
    with pytest.raises(MeasurementError) as caught:
        read(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert any(Path(a).name in message for a in arguments if isinstance(a, str | Path)), message
    return message
