"""Files and folders that are there whole or not at all."""

import errno
import os
import subprocess
import sys

import pytest
from systems import posix_only

from clradar.errors import OutputError
from clradar.files import atomic
from clradar.files.atomic import new_folder, replacing, swap_folder, write_file


def test_a_target_is_replaced_only_with_force(tmp_path):
    target = tmp_path / "a"
    write_file(target, b"1")
    with pytest.raises(OutputError, match="a: exists already"):
        write_file(target, b"2")
    assert target.read_bytes() == b"1"
    write_file(target, b"3", force=True)
    assert target.read_bytes() == b"3"
    (tmp_path / "dangling").symlink_to("nothing")
    with pytest.raises(OutputError, match="exists already"):
        write_file(tmp_path / "dangling", b"4")
    assert sorted(os.listdir(tmp_path)) == ["a", "dangling"]


def test_a_target_that_appears_while_it_is_written(tmp_path):
    target = tmp_path / "a"
    with pytest.raises(OutputError, match="exists"), replacing(target) as temporary:  # noqa: PT012
        temporary.write_bytes(b"ours")
        target.write_bytes(b"somebody else's")
    assert target.read_bytes() == b"somebody else's"
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.parametrize("links", [True, False])
def test_of_two_that_find_a_name_free_one_has_it(tmp_path, monkeypatch, links):
    """Both have looked for the target before either gives its file the name."""
    target, looked_for = tmp_path / "a", atomic.refuse_existing

    def late(path, *, force):
        looked_for(path, force=force)
        if list(tmp_path.iterdir()):  # the temporary file: at the end
            monkeypatch.setattr(atomic, "refuse_existing", looked_for)
            write_file(target, b"the other's")

    def link(*_):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(atomic, "refuse_existing", late)
    if not links:  # such as of FAT
        monkeypatch.setattr(os, "link", link)
    with pytest.raises(OutputError, match="a: exists already"):
        write_file(target, b"ours")
    assert target.read_bytes() == b"the other's"
    write_file(tmp_path / "b", b"ours")
    assert sorted(os.listdir(tmp_path)) == ["a", "b"]


@pytest.mark.parametrize("name", ["missing/a", "folder", "nul\0byte"])
def test_names_that_cannot_be_written(tmp_path, name):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError) as info:
        write_file(tmp_path / name, b"", force=True)
    assert str(info.value).isprintable()
    assert os.listdir(tmp_path) == ["folder"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch, error):
    target = tmp_path / "a"
    target.write_bytes(b"precious")

    def full(_):
        raise error

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises((OutputError, KeyboardInterrupt)) as info:
        write_file(target, b"new", force=True)
    if isinstance(error, OSError):
        assert str(info.value).endswith("a: cannot be written: No space left")
    assert target.read_bytes() == b"precious"
    assert os.listdir(tmp_path) == ["a"]


def test_folders_are_swapped_and_come_back_after_a_failure(tmp_path, monkeypatch):
    target = tmp_path / "deep" / "out"
    for content in ("1", "2"):
        with new_folder(target) as temporary:
            (temporary / "new").mkdir()
            (temporary / "new" / "file").write_text(content)
            swap_folder(temporary / "new", target, temporary / "old")
        assert (target / "file").read_text() == content

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(atomic, "move_folder", interrupted)
    with pytest.raises(KeyboardInterrupt), new_folder(target) as temporary:  # noqa: PT012
        (temporary / "new").mkdir()
        swap_folder(temporary / "new", target, temporary / "old")
    assert (target / "file").read_text() == "2"
    assert os.listdir(target.parent) == ["out"]


@posix_only
def test_what_killed_processes_left_of_a_name_is_removed_and_nothing_else(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    gone = process.pid
    mine = atomic._temporary(tmp_path / "a.h5")
    left = mine.with_name(mine.name.replace(f"-{os.getpid()}-", f"-{gone}-"))
    other = left.with_name(left.name.replace("a.h5", "b.h5"))
    elsewhere = left.with_name(left.name.replace(atomic._MACHINE, "0" * 6))
    for path in (mine, left, other, elsewhere):
        path.touch()
    folder = left.with_name(left.name.replace("a.h5", "c"))
    (folder / "made").mkdir(parents=True)
    atomic.remove_left([tmp_path / "a.h5", tmp_path / "c"])
    assert set(tmp_path.iterdir()) == {mine, other, elsewhere}
