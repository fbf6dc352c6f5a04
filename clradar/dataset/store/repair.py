"""Samples that are queued again: corrupt ones on every resume, set-aside ones on request."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from clradar.dataset.store.content_check import check_note, check_part
from clradar.dataset.store.folder import SUMMARIES, DatasetFolder, ShardEntry
from clradar.dataset.store.shard_reader import made_with_of, opened_shard, row_of, sample_of
from clradar.dataset.store.shard_writer import write_sample
from clradar.errors import MeasurementError
from clradar.files.hashing import sha256_of


def queue_corrupt(folder: DatasetFolder) -> list[str]:
    """Queue the samples again whose files are missing or corrupt, and return a line per file.

    The shards of the manifest are compared by size; those of a manifest without sizes are hashed
    once. Parts and notes are read whole: they belong to a few shards at most.
    """
    return [*_corrupt_shards(folder), *_corrupt_parts(folder)]


def _corrupt_shards(folder: DatasetFolder) -> Iterator[str]:
    manifest = folder.manifest
    for number, entry in sorted(manifest.shards.items()):
        if entry.file is None:
            continue
        path = folder.shard(number)
        fault = shard_fault(path, entry)
        if fault is None and entry.size_bytes is None:
            if sha256_of(path) != entry.sha256:
                fault = f"expected SHA-256 {entry.sha256}"
            manifest.shards[number] = replace(entry, size_bytes=path.stat().st_size)
        if fault is None:
            continue
        _forget(folder, number)
        yield f"{path}: {fault}; its samples are made again"
    folder.write_manifest()


def shard_fault(path: Path, entry: ShardEntry) -> str | None:
    """Return why a shard is missing or of another size, or None; it is not read."""
    if not path.is_file():
        return "is missing"
    size_bytes = path.stat().st_size
    if entry.size_bytes is not None and size_bytes != entry.size_bytes:
        return f"expected {entry.size_bytes} bytes, got {size_bytes}"
    return None


def _forget(folder: DatasetFolder, number: int) -> None:
    """Queue the samples of a closed shard, except those that were set aside."""
    manifest = folder.manifest
    asides = [manifest.aside[s] for s in folder.plan.shard_samples(number) if s in manifest.aside]
    for aside in asides:
        # First: if the process is killed after any later step, the sample stays set aside.
        folder.set_aside(aside)
    _reopen(folder, number)


def _reopen(folder: DatasetFolder, number: int) -> None:
    """Remove a closed shard from the manifest and the disk, and the summaries that count it."""
    manifest = folder.manifest
    for name in SUMMARIES:
        (folder.path / name).unlink(missing_ok=True)
    del manifest.shards[number]
    for sample in folder.plan.shard_samples(number):
        manifest.aside.pop(sample, None)
    folder.write_manifest()
    path = folder.shard(number)
    if path.is_file() or path.is_symlink():
        path.unlink()


def _corrupt_parts(folder: DatasetFolder) -> Iterator[str]:
    for path in sorted(folder.own_parts()):
        sample = int(path.stem)
        try:
            if path == folder.part(sample):
                check_part(path, folder.plan, sample)
            else:
                check_note(path, sample)
        except MeasurementError as error:
            path.unlink(missing_ok=True)
            yield f"{error}; sample {sample} is made again"


def queue_set_aside(folder: DatasetFolder) -> None:
    """Queue every sample again that was set aside.

    The other samples of a closed shard are written as parts first, then the manifest forgets the
    shard. A kill in between leaves parts of a closed shard, which the next run removes.
    """
    manifest = folder.manifest
    for number in sorted({s // folder.plan.output.shard_size for s in manifest.aside}):
        if manifest.shards[number].file is not None:
            path = folder.shard(number)
            with opened_shard(path) as file:
                for sample in folder.plan.shard_samples(number):
                    if sample not in manifest.aside:
                        row = row_of(file, path, sample)
                        write_sample(
                            folder.part(sample),
                            sample_of(file, row),
                            made_with_of(file, row),
                            compression=folder.plan.output.compression,
                            force=True,
                        )
        _reopen(folder, number)
    for path in folder.own_parts():
        if path.suffix == ".json":
            path.unlink(missing_ok=True)
