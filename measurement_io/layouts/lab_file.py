"""Another program's file as it came from the confined process: its keys, and values of some."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.failures import clean, fail, reading, regular_file_size, shown
from clradar.files.limits import MAX_ARRAY_BYTES, MAX_LISTS_BYTES
from measurement_io.confined.hdf5_guard import HDF5_MAGIC
from measurement_io.confined.reading import run
from measurement_io.layouts.contents import EXPECTED, Key, read as read_contents

_SHOWN_KEYS = 30
_HDF5_OFFSETS = (0, 512, 1024, 2048, 4096)
"""Where HDF5 may begin: a program can put a block of its own before it, as MATLAB does."""

_MODULES = {
    "hdf5": ("h5py",),
    "npz": ("numpy.lib.format", "zipfile", "zlib"),
    "npy": ("numpy.lib.format",),
    "mat5": ("scipy.io", "scipy.io.matlab", "scipy.sparse"),
}
"""Form -> the modules that what reads it needs."""


def form_of(path: Path, expected: str = "a capture, a volume or a recording") -> str | None:
    """Return the form of a file by its first bytes, a key of `_MODULES`; None for another one."""
    regular_file_size(path, expected)
    with reading(path, expected), open(path, "rb") as file:
        start = file.read(_HDF5_OFFSETS[-1] + len(HDF5_MAGIC))
    if any(start[at : at + len(HDF5_MAGIC)] == HDF5_MAGIC for at in _HDF5_OFFSETS):
        return "hdf5"
    if start.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return "npz"
    if start.startswith(b"\x93NUMPY"):
        return "npy"
    return "mat5" if start[124:128] in (b"\x00\x01IM", b"\x01\x00MI") else None


@dataclass(frozen=True, slots=True)
class LabFile:
    """What was read of a file; with `matlab` shapes are as MATLAB shows them: two axes or more."""

    path: Path
    kind: str
    matlab: bool
    keys: Mapping[str, Key]
    values: Mapping[str, np.ndarray]

    @classmethod
    def opened(cls, path: Path, wanted: Sequence[tuple[str, Mapping[int, int]]] = ()) -> LabFile:
        """Read the keys of a file, and the values of some: names, and an index on some axes."""
        form = form_of(path)
        if form is None:
            fail(path, EXPECTED, "something else")
        names = [(name.strip("/"), list(pick.items())) for name, pick in wanted]
        found = run(
            read_contents, path, form, names, copies=1,
            most_bytes=MAX_ARRAY_BYTES + MAX_LISTS_BYTES if wanted else None,
            expected=EXPECTED, modules=_MODULES[form],
            mapped_bytes=path.stat().st_size if form == "npy" else 0,
        )  # fmt: skip
        keys = {name: Key(name, tuple(shape), kind) for name, shape, kind in found["keys"]}
        return cls(path, found["kind"], found["matlab"], keys, found["values"])

    def find(self, name: str, purpose: str) -> Key:
        """Return the key of that name; the error lists those there are."""
        wanted = name.strip("/")
        wanted = wanted.replace(".", "/") if self.matlab else wanted
        if wanted not in self.keys:
            got = f"{self.kind} with the keys {self.listed()}"
            fail(self.path, f"the key {_place(name, purpose)}", got)
        return self.keys[wanted]

    def read(self, name: str, purpose: str) -> np.ndarray:
        """Return the numbers of a key that was wanted."""
        key = self.find(name, purpose)
        if key.name not in self.values:
            fail(self.path, f"{_place(name, purpose)} to hold numbers", key.kind)
        return self.values[key.name]

    def real_array(self, name: str, purpose: str) -> np.ndarray:
        """Return a key's real numbers as finite float64."""
        value = self.read(name, purpose)
        if value.dtype.kind not in "iuf" or value.size == 0:
            got = clean(value.dtype) if value.size else f"shape {value.shape}"
            fail(self.path, f"{_place(name, purpose)} to hold real numbers", got)
        result: np.ndarray = value.astype(np.float64)
        bad = int(result.size - np.count_nonzero(np.isfinite(result)))
        if bad:
            got = f"{bad} of {result.size} that are NaN or infinite"
            fail(self.path, f"finite numbers in {_place(name, purpose)}", got)
        return result

    def real_list(self, name: str, purpose: str) -> np.ndarray:
        """Return a key's numbers in one row; at most one of its axes may be longer than 1."""
        value = self.real_array(name, purpose)
        if sum(n > 1 for n in value.shape) > 1:
            fail(self.path, f"{_place(name, purpose)} to be a list", f"shape {value.shape}")
        return value.ravel()

    def real_number(self, value: str | float | None, purpose: str) -> float:
        """Return a number of the layout, or the one that a key of the file holds."""
        if not isinstance(value, str):
            return float(value or 0.0)
        found = self.real_array(value, purpose)
        if found.size != 1:
            fail(self.path, f"{_place(value, purpose)} to be a number", f"{found.shape}")
        return float(found.ravel()[0])

    def listed(self) -> str:
        """Return the keys as text, on one line."""
        texts = [str(key) for key in list(self.keys.values())[:_SHOWN_KEYS]]
        more = len(self.keys) - len(texts)
        return (", ".join(texts) or "none") + (f" and {more} more" if more > 0 else "")


def _place(name: str, purpose: str) -> str:
    return f"'{clean(name)[:80]}' ({purpose})"


def layout_needed(path: Path) -> MeasurementError:
    """Return the error of a file of another program that is opened without a layout."""
    found = LabFile.opened(path)
    return MeasurementError(
        f"{shown(path)}: expected a layout (layout=, --layout; `clradar inspect` prints a "
        f"template) for a file of another program, got {found.kind} with the keys {found.listed()}"
    )
