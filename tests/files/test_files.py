"""Texts that read back equal or are refused; watched folders; files whole or not at all."""

import errno
import json
import os
import subprocess
import sys
from functools import partial

import pytest
from systems import posix_only

from clradar.errors import MeasurementError, ModelError, OutputError, RigError
from clradar.files import atomic
from clradar.files.atomic import new_folder, swap_folder, write_file
from clradar.files.failures import clean, fail, read_bytes
from clradar.files.json_file import (
    differences,
    parse_object,
    read_json,
    read_json_object,
    to_json,
    write_json,
)
from clradar.files.limits import MAX_JSON_DEPTH, MAX_MESSAGE_CHARACTERS, MAX_TOML_LINE_CHARACTERS
from clradar.files.toml_file import parse_toml, read_toml, toml_brief, toml_document
from clradar.files.watched_folder import WatchedFolder
from measurement_io import read_alignment


def nested(depth):
    value: object = 1
    for _ in range(depth):
        value = [value]
    return value


def test_toml_reads_back():
    content = {
        "name": 'a "quoted"\\ name \x7f \u00e4\n',
        "size": 1.5,
        "joints": {"wrist": {"flexion_deg": -1e-30}, "odd key.": {}, "thumb": {"a": {"b": "c"}}},
        "none": {},
    }
    text = toml_document(content)
    assert parse_toml(text) == content
    assert "[joints]" not in text
    assert toml_document({"name": "x", "joints": {}}) == 'name = "x"\n\n[joints]\n'
    assert toml_brief([True, "x", 1.5, None, {"a": 1}]) == '[true, "x", 1.5, null, {"a": 1}]'
    assert len(toml_brief(["y" * 10_000] * 100)) < 1300
    assert toml_brief(10**5000) == "a huge number"


def test_json_reads_back(tmp_path):
    value = {"a": [1, 2.5, None, True, "\u00e4\n"], "b": {"c": {}}}
    write_json(tmp_path / "v.json", value, force=False)
    assert read_json_object(tmp_path / "v.json") == value
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "nan.json", float("nan"), force=False)
    assert not (tmp_path / "nan.json").exists()


def test_a_byte_order_mark_is_no_content(tmp_path):
    (tmp_path / "t").write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_toml(tmp_path / "t", "a plan") == {"a": 1}
    (tmp_path / "t").write_bytes(b"\xef\xbb\xbf[1, NaN]")
    assert read_json(tmp_path / "t", "a list", 20)[0] == 1


TOML = partial(read_toml, expected="a plan", limit=20_000)
JSON = read_json_object


@pytest.mark.parametrize(
    ("read", "content", "words"),
    [
        (TOML, b"a = ", "TOMLDecodeError"),
        (TOML, b"\xff", "bytes that are no UTF-8 text"),
        (TOML, b"a." * (MAX_TOML_LINE_CHARACTERS // 2) + b"b = 1", "a line of"),
        (TOML, b"#" * 12_000 + b"\n" + b"#" * 12_000, "of at most 20000 bytes"),
        (JSON, b'{"a": 1, "a": 2}', "the key 'a' twice"),
        (JSON, b"[1]", "list where a JSON object was expected"),
        (JSON, b"{", "JSONDecodeError"),
        (JSON, b'{"a":' * 100_000, "RecursionError"),
        (JSON, json.dumps({"a": nested(MAX_JSON_DEPTH + 1)}).encode(), "levels of nesting"),
        (read_alignment, b'{"kinect2radar": [["\\ud800"]]}', "valid number, got .*ud800"),
    ],
)
def test_files_that_are_refused(tmp_path, read, content, words):
    path = tmp_path / "name"
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=rf"name: .*expected a .*{words}"):
        read(path)


def test_meta_reads_back_equal_or_is_refused():
    meta = {"a": [1, 0.1, "\u00e4", None, False], "b": {"c": nested(MAX_JSON_DEPTH - 2)}}
    text = to_json("meta", meta)
    assert text.isascii()
    assert parse_object(text, strict=True) == meta
    for value in (float("inf"), (1, 2), b"x", nested(MAX_JSON_DEPTH + 1), {1: 2}):
        with pytest.raises(ModelError, match="meta"):
            to_json("meta", {"key": value})
    with pytest.raises(ValueError, match="NaN is not JSON"):
        parse_object('{"a": NaN}', strict=True)


def test_differences_of_long_lists_are_those_of_their_items():
    before, now = {"a": [*range(40)]}, {"a": [0, -1, *range(2, 41)]}
    assert differences(before, now) == ["a of 40, now of 41", "a[1] 1, now -1"]


# ---- messages, and files of a limited size


def test_messages_are_one_printable_line_of_bounded_length():
    assert clean("a\n b\t\x1b[31m\udcff") == "a b \\x1b[31m\\udcff"
    assert len(clean("x" * 10**6)) == MAX_MESSAGE_CHARACTERS + 3
    with pytest.raises(MeasurementError, match=r"^a b: expected this, got that$"):
        fail("a\nb", "this", "that")


@posix_only
def test_only_regular_files_of_the_allowed_size_are_read(tmp_path):
    (tmp_path / "f").write_bytes(b"12345")
    assert read_bytes(tmp_path / "f", "a thing", 5) == b"12345"
    os.mkfifo(tmp_path / "pipe")
    for name, limit, words in (
        ("f", 4, "a thing of at most 4 bytes, got 5 bytes"),
        ("none", 5, "a thing, got nothing there"),
        (".", 5, "a thing, got a folder"),
        ("pipe", 5, "a thing, got something that is no regular file"),
        ("nul\0", 5, "a thing, got ValueError"),
    ):
        with pytest.raises(RigError, match=f"expected {words}"):
            read_bytes(tmp_path / name, "a thing", limit, error=RigError)


def names(folder):
    return [path.name for path in folder.changes()]


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
