"""What is damaged in a data set that is gone on with is made again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from clradar.dataset.store.folder import SUMMARIES, DatasetFolder, ShardEntry, with_size
from clradar.dataset.store.parts import check_note, check_part
from clradar.errors import MeasurementError
from clradar.files.hashing import sha256_of


def mend(folder: DatasetFolder) -> list[str]:
    """Make the samples missing again whose files are missing or damaged.

    Of shards that the manifest names, the size is looked at; those of a manifest without sizes are
    read once. Parts and notes are read: they are those of a few shards at most.

    Returns
    -------
    list of str
        One line per file that is to be made again.
    """
    return list(_mended_shards(folder)) + list(_mended_parts(folder))


def _mended_shards(folder: DatasetFolder) -> Iterator[str]:
    manifest = folder.manifest
    for number, entry in sorted(manifest.shards.items()):
        if entry.file is None:
            continue
        path = folder.shard(number)
        fault = shard_fault(path, entry)
        if fault is None and entry.size_bytes is None:
            fault = _content_fault(path, entry)
            manifest.shards[number] = with_size(entry, path)
        if fault is None:
            continue
        _forget(folder, number)
        yield f"{path}: {fault}; its samples are made again"
    folder.write_manifest()


def shard_fault(path: Path, entry: ShardEntry) -> str | None:
    """Return what is seen to be wrong with a shard without reading it, or None."""
    if not path.is_file():
        return "is missing"
    size_bytes = path.stat().st_size
    if entry.size_bytes is not None and size_bytes != entry.size_bytes:
        return f"expected {entry.size_bytes} bytes, got {size_bytes}"
    return None


def _content_fault(path: Path, entry: ShardEntry) -> str | None:
    return None if sha256_of(path) == entry.sha256 else f"expected SHA-256 {entry.sha256}"


def _forget(folder: DatasetFolder, number: int) -> None:
    """Make the samples of a closed shard missing, but for those that were set aside."""
    manifest = folder.manifest
    asides = [manifest.aside[s] for s in folder.plan.shard_samples(number) if s in manifest.aside]
    for aside in asides:
        # First: whenever this is cut short, the sample stays set aside.
        folder.set_aside(aside)
    for name in SUMMARIES:
        (folder.path / name).unlink(missing_ok=True)
    del manifest.shards[number]
    for aside in asides:
        del manifest.aside[aside.sample]
    folder.write_manifest()
    path = folder.shard(number)
    if path.is_file() or path.is_symlink():
        path.unlink()


def _mended_parts(folder: DatasetFolder) -> Iterator[str]:
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
