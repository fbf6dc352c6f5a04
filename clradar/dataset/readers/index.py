"""Index of stored samples: the shard and the row of each."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clradar.dataset.store.folder import Manifest, read_manifest
from clradar.dataset.store.shard_reader import opened_shard
from clradar.files.failures import fail
from clradar.model import checks


@dataclass(frozen=True, slots=True)
class Index:
    """The files of the closed shards of a data set, their SHA-256, and the samples in each."""

    folder: Path
    manifest: Manifest
    files: tuple[Path, ...]
    sha256: tuple[str, ...]
    counts: tuple[int, ...]

    def __len__(self) -> int:
        return sum(self.counts)

    def locate(self, position: int) -> tuple[Path, int]:
        """Return file and row of the sample at a position from 0 to ``len(self) - 1``."""
        ends = np.cumsum(self.counts)
        shard = int(np.searchsorted(ends, position, side="right"))
        return self.files[shard], position - int(ends[shard]) + self.counts[shard]

    def sequences(self, function: str) -> np.ndarray:
        """Return the positions of the samples of all whole sequences, shape (n, n_frames).

        Raises
        ------
        ModelError
            The data set has no sequences.
        """
        movement = self.manifest.plan.movement
        if movement is None:
            checks.fail(f"{function}: sequences", "a data set whose plan has [movement]", "none")
        samples: list[int] = []
        for path in self.files:
            with opened_shard(path) as file:
                samples += file["entry/labels/sample"][:].tolist()
        place = {sample: position for position, sample in enumerate(samples)}
        frames = movement.frames
        firsts = sorted(sample for sample in samples if sample % frames == 0)
        wanted = [range(first, first + frames) for first in firsts]
        whole = [[place[s] for s in own] for own in wanted if all(s in place for s in own)]
        return np.array(whole, dtype=np.int64).reshape(-1, frames)


def read_index(folder: str | os.PathLike[str]) -> Index:
    """Return the index of a data set.

    Raises
    ------
    MeasurementError
        It is no data set, it is damaged, or no shard of it is closed yet.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    entries = [manifest.shards[number] for number in sorted(manifest.shards)]
    there = [(e.file, e.sha256, e.samples) for e in entries if e.file is not None]
    if not there:
        fail(path, "a data set with at least one closed shard", "none")
    return Index(
        path,
        manifest,
        tuple(path / file for file, _, _ in there),
        tuple(str(digest) for _, digest, _ in there),
        tuple(count for _, _, count in there),
    )
