"""HDF5 files of any program, and MATLAB v7.3 files, which are HDF5 with MATLAB's conventions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from clradar.files.limits import MAX_ARRAY_BYTES
from measurement_io.confined import hdf5_process
from measurement_io.layouts import hdf5_contents
from measurement_io.layouts.byte_source import kept_shape
from measurement_io.layouts.container import Container, Key

_LARGEST_NUMBER_BYTES = 16


class Hdf5Container(Container):
    """Datasets by their path, "group/dataset"; read by a process of their own.

    Of a MATLAB file the axes are in MATLAB's order, which is the reverse of the stored one.
    """

    def __init__(self, path: Path) -> None:
        found = hdf5_process.run(hdf5_contents.list_keys, path)
        kind = "a MATLAB v7.3 file" if found["matlab"] else "an HDF5 file"
        super().__init__(path, kind, matlab=found["matlab"])
        for name, shape, of_kind, content in found["keys"]:
            self.add(Key(name, tuple(shape), of_kind, content))

    def _read(self, key: Key, pick: Mapping[int, int]) -> np.ndarray:
        chosen = [[axis, index] for axis, index in pick.items()]
        most = min(MAX_ARRAY_BYTES, math.prod(kept_shape(key.shape, pick)) * _LARGEST_NUMBER_BYTES)
        return hdf5_process.run(
            hdf5_contents.read_key, self.path, key.name, chosen, most_bytes=most
        )

    def read_several(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the numbers of some small keys, all read by one process.

        What cannot be read is left out; all of it, if the process dies.
        """
        places = {name: place for place, name in enumerate(self.keys)}
        numbers = sum(math.prod(self.keys[name].shape) for name in names)
        with suppress(MeasurementError):
            return hdf5_process.run(
                hdf5_contents.read_small_keys,
                self.path,
                [places[name] for name in names],
                most_bytes=numbers * _LARGEST_NUMBER_BYTES,
            )
        return {}

    def _text(self, key: Key) -> str:
        return hdf5_process.run(hdf5_contents.read_text, self.path, key.name)


@contextmanager
def opened_hdf5(path: Path) -> Iterator[Hdf5Container]:
    yield Hdf5Container(path)
