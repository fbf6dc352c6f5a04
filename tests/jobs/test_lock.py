"""A folder of work belongs to one process at a time."""

import hashlib
import os
from pathlib import Path
from typing import IO

import pytest
from systems import posix_only

from clradar.errors import MeasurementError, OutputError
from clradar.files import hashing
from clradar.files.hashing import content_record, holds_still, sha256_of
from clradar.jobs.lock import held, remove_temporaries


def test_one_holder_at_a_time(tmp_path):
    folder = tmp_path / "a" / "b"
    with held(folder, "sweep"):
        with pytest.raises(OutputError, match="another sweep is writing"), held(folder, "sweep"):
            pass
        (folder / "image").touch()
    assert [path.name for path in folder.iterdir()] == ["image"]
    with pytest.raises(OutputError, match="got a file"), held(folder / "image", "sweep"):
        pass


@posix_only
def test_a_lock_that_its_holder_removes_locks_nobody(tmp_path, monkeypatch):
    """Between opening the file and locking it the other process may have ended."""
    import fcntl

    real, opened = fcntl.flock, []

    def late(lock: IO[bytes], how: int) -> None:
        if not opened:
            (tmp_path / ".lock").unlink()
        opened.append(lock)
        real(lock, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with held(tmp_path, "sweep"):
        assert len(opened) > 1  # filelock looked, and locked anew
        with pytest.raises(OutputError, match="another sweep"), held(tmp_path, "sweep"):
            pass


def test_remains_are_removed_and_nothing_else(tmp_path):
    for name in (".a.npz.012.tmp", "b.tmp", ".c"):
        (tmp_path / name).write_text("")
    remove_temporaries(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".c", "b.tmp"]


def test_hash_of_a_file_longer_than_a_block(tmp_path):
    for content in (b"abc", b"a" * 10**6 + b"b" * 10**6):
        (tmp_path / "a").write_bytes(content)
        assert sha256_of(tmp_path / "a") == hashlib.sha256(content).hexdigest()


@posix_only
def test_a_file_is_read_again_only_where_the_system_cannot_tell(tmp_path, monkeypatch):
    path = tmp_path / "frame"
    path.write_bytes(b"one")
    # Written to just now: its times would not tell whether it is written to again.
    assert content_record(path)["system"] is None
    monkeypatch.setattr(hashing, "SETTLED_NS", 0)
    record = content_record(path)
    reads: list[Path] = []
    monkeypatch.setattr(hashing, "sha256_of", lambda p: reads.append(p) or sha256_of(p))
    assert holds_still(path, record)
    assert reads == []
    os.utime(path, (0, 0))
    assert holds_still(path, record)
    assert reads == [path]
    path.write_bytes(b"two")
    os.utime(path, ns=tuple(record["system"][3:4]) * 2)
    assert not holds_still(path, record)
    path.unlink()
    os.mkfifo(path)  # which would be read for ever
    with pytest.raises(MeasurementError, match="frame: expected a readable file, got something"):
        holds_still(path, record)
