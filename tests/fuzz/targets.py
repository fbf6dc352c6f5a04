"""The readers that are tried, and what each of them may return. A new reader is one entry here."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from clradar.errors import MeasurementError
from clradar.model import Capture, Volume
from fuzz import mutate_bytes, mutate_hdf5, mutate_json, mutate_pickle, mutate_text, seeds
from measurement_io import Description, check_file, describe, open_capture, open_volume
from measurement_io.antenna_file import read_antenna_file

Mutator = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True, slots=True)
class Target:
    """One reader under trial.

    Attributes
    ----------
    name : str
    seeds : callable
        Makes valid files, small ones, always the same. Reading each has to give a result.
    read : callable
        Reads the file at a path.
    results : tuple of type
        What reading may return.
    structured : tuple of callable
        Mutators that know the format: `(data, random) -> data`. Those of `mutate_bytes` apply too.
    dictionary : tuple of bytes
        Tokens of the format, for the byte mutators.
    file_name : str
        Where the file lies, relative to an empty folder; a reader may look at its name.
    around : callable, optional
        Called once with that empty folder, to put there what has to lie around the file.
    repair : callable, optional
        Applied last to most inputs: makes checksums right again, so that mutants get past them.
    errors : tuple of type
        What reading may raise.
    """

    name: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], object]
    results: tuple[type, ...]
    structured: tuple[Mutator, ...] = ()
    dictionary: tuple[bytes, ...] = ()
    file_name: str = "input"
    around: Callable[[Path], None] | None = None
    repair: Callable[[bytes], bytes] | None = None
    errors: tuple[type[Exception], ...] = (MeasurementError,)

    def place(self, folder: Path) -> Path:
        """Make what lies around the input and return where the input goes."""
        path = folder / self.file_name
        path.parent.mkdir(parents=True, exist_ok=True)
        if self.around is not None:
            self.around(folder)
        return path

    def mutated(self, seed: int, index: int) -> bytes:
        """Return input number `index` of the run `seed`: the same bytes every time."""
        rng = random.Random(f"{self.name}/{seed}/{index}")
        return self.mutate(rng.choice(_corpus(self)), rng)

    def mutate(self, data: bytes, rng: random.Random) -> bytes:
        """Return `data` with one to a few changes, at times spliced with another seed."""
        others = _corpus(self)
        for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 5, 8))):
            if self.structured and rng.random() < 0.6:
                data = rng.choice(self.structured)(data, rng)
            else:
                data = mutate_bytes.mutate(data, rng, self.dictionary, others)
        if self.repair is not None and rng.random() < 0.8:
            data = self.repair(data)
        return data


@cache
def _corpus(target: Target) -> tuple[bytes, ...]:
    return tuple(target.seeds())


def _open_and_check(opener: Callable[[Path], object]) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        found = opener(path)
        check_file(path)  # looks at more than opening does
        return found

    return read


def _describe_folder(path: Path) -> object:
    return describe(path.parent)


TARGETS = {
    target.name: target
    for target in (
        Target(
            "frame",
            seeds.frames,
            open_capture,
            (Capture,),
            (mutate_pickle.mutate_npy, mutate_pickle.mutate_operations),
            mutate_pickle.DICTIONARY,
            file_name="000000.npy",
        ),
        Target(
            "native_capture",
            seeds.native_captures,
            _open_and_check(open_capture),
            (Capture,),
            mutate_hdf5.MUTATORS,
            mutate_hdf5.DICTIONARY,
            file_name="capture.h5",
            repair=mutate_hdf5.with_right_checksums,
        ),
        Target(
            "native_volume",
            seeds.native_volumes,
            _open_and_check(open_volume),
            (Volume,),
            mutate_hdf5.MUTATORS,
            mutate_hdf5.DICTIONARY,
            file_name="volume.h5",
            repair=mutate_hdf5.with_right_checksums,
        ),
        Target(
            "calibration_json",
            seeds.calibrations,
            _describe_folder,
            (Description,),
            (mutate_json.mutate,),
            mutate_json.DICTIONARY,
            file_name="radar_72.0_82.0_2/calibration.json",
            around=seeds.radar_folder,
        ),
        Target(
            "antennas",
            seeds.antenna_files,
            read_antenna_file,
            (np.ndarray,),
            (mutate_text.mutate_lines,),
            mutate_text.DICTIONARY,
            file_name="Rx.dat",
        ),
    )
}
