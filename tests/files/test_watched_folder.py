"""A folder that is written while it is watched: complete files alone, and no long looks."""

import os
from pathlib import Path

from clradar.files import watched_folder
from clradar.files.watched_folder import RECHECKED, WatchedFolder


def names(folder):
    return [path.name for path in folder.changes()]


def test_files_count_once_they_no_longer_grow(tmp_path):
    folder = WatchedFolder(tmp_path, lambda name: name.endswith(".h5"))
    (tmp_path / "10.h5").write_bytes(b"ab")
    (tmp_path / "9.h5").write_bytes(b"ab")
    (tmp_path / "notes.txt").write_bytes(b"ab")
    (tmp_path / "folder.h5").mkdir()
    (tmp_path / "begun.h5").touch()
    assert names(folder) == []
    assert names(folder) == ["9.h5", "10.h5"]
    assert names(folder) == []
    for content in (b"a", b"ab"):
        (tmp_path / "begun.h5").write_bytes(content)
        assert names(folder) == []
    assert folder.is_there("begun.h5")
    assert names(folder) == ["begun.h5"]


def test_rewritten_files_come_again_and_removed_ones_go(tmp_path):
    folder = WatchedFolder(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(b"ab")
    assert (names(folder), names(folder)) == ([], ["a", "b"])
    (tmp_path / "new").write_bytes(b"ab")  # of the same size, later
    os.utime(tmp_path / "new", ns=(1, 1))
    os.replace(tmp_path / "new", tmp_path / "a")
    (tmp_path / "b").unlink()
    assert names(folder) == []
    assert names(folder) == ["a"]
    assert not folder.is_there("b")
    (tmp_path / "b").write_bytes(b"ab")
    assert (names(folder), names(folder)) == ([], ["b"])


def test_a_look_at_many_files_looks_at_few_of_them(tmp_path, monkeypatch):
    count = 3 * RECHECKED + 1
    for i in range(count):
        (tmp_path / f"{i}.npy").write_bytes(b"a")
    folder = WatchedFolder(tmp_path)
    assert (len(folder.changes()), len(folder.changes())) == (0, count)
    (tmp_path / "0.npy").write_bytes(b"ab")
    looked: list[Path] = []
    stamp = watched_folder._stamp
    monkeypatch.setattr(watched_folder, "_stamp", lambda path: looked.append(path) or stamp(path))
    found = []
    for _ in range(5):
        looked.clear()
        found += names(folder)
        assert len(looked) <= RECHECKED + 1
    assert found == ["0.npy"]  # each comes up in turn
