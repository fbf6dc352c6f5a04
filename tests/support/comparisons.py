"""What many tests of files compare."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clradar import Capture
from clradar.errors import MeasurementError


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def same_capture(a: Capture, b: Capture) -> bool:
    """Samples, positions and frequencies to the bit."""
    return same_bits(a.data, b.data) and all(
        same_bits(getattr(one, name), getattr(other, name))
        for one, other, names in (
            (a.array, b.array, ("tx_m", "rx_m")),
            (a.waveform, b.waveform, ("frequencies_hz",)),
        )
        for name in names
    )


def tree(folder: str | Path, *ignored: str) -> dict[str, bytes | int]:
    """What is in a folder: the bytes of its files, the kind of all else."""
    return {
        str(path.relative_to(folder)): path.lstat().st_mode
        if path.is_symlink() or not path.is_file()
        else path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.name not in ignored
    }


def refusal(read: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """What is said of a file that must not be read: one line, which names it."""
    with pytest.raises(MeasurementError) as caught:
        read(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert any(Path(a).name in message for a in arguments if isinstance(a, str | Path)), message
    return message
