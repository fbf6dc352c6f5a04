"""Take shards apart whose samples were set aside, so that these can be tried again."""

from __future__ import annotations

from clradar.dataset.store.folder import SUMMARIES, DatasetFolder
from clradar.dataset.store.shard import write_sample
from clradar.dataset.store.stored import made_with_of, opened, row_of, sample_of


def reopen(folder: DatasetFolder) -> None:
    """Make every sample that was set aside a missing one, of the data set that is being written.

    A closed shard becomes parts again: first they are written, then the manifest forgets the shard.
    A process that is killed between leaves parts of a closed shard, which the next run removes.
    """
    manifest = folder.manifest
    for number in sorted({s // folder.plan.output.shard_size for s in manifest.aside}):
        entry = manifest.shards[number]
        samples = folder.plan.shard_samples(number)
        if entry.file is not None:
            path = folder.path / entry.file
            with opened(path) as file:
                for sample in samples:
                    if sample not in manifest.aside:
                        row = row_of(file, path, sample)
                        write_sample(
                            folder.part(sample),
                            sample_of(file, row),
                            made_with_of(file, row),
                            compression=folder.plan.output.compression,
                            force=True,
                        )
        for name in SUMMARIES:
            (folder.path / name).unlink(missing_ok=True)
        del manifest.shards[number]
        for sample in samples:
            manifest.aside.pop(sample, None)
        folder.write_manifest()
        # What was in it is in parts; the file would count as none of the data set's.
        folder.shard(number).unlink(missing_ok=True)
    folder.forget_notes()
