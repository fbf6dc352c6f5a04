"""Messages about files, and files of a limited size."""

import os

import pytest
from systems import posix_only

from clradar.errors import MeasurementError, ModelError, RigError
from clradar.files.failures import clean, fail, read_bytes, reading
from clradar.files.limits import MAX_MESSAGE_CHARACTERS


def test_messages_are_one_printable_line_of_bounded_length():
    assert clean("a\n b\t\x1b[31m\udcff") == "a b \\x1b[31m\\udcff"
    assert len(clean("x" * 10**6)) == MAX_MESSAGE_CHARACTERS + 3
    with pytest.raises(MeasurementError, match=r"^a b: expected this, got that$"):
        fail("a\nb", "this", "that")


@pytest.mark.parametrize("kind", [MeasurementError, RigError])
@pytest.mark.parametrize(
    ("error", "words"),
    [
        (KeyError("k"), "f: expected a thing, got KeyError: 'k'"),
        (OSError(5, "Input/output error"), "f: expected a thing, got Input/output error"),
        (ModelError("x: expected y, got z"), "f: x: expected y, got z"),
    ],
)
def test_what_a_parser_raises_becomes_one_class(kind, error, words):
    with pytest.raises(kind) as info, reading("f", "a thing", error=kind):
        raise error
    assert type(info.value) is kind
    assert str(info.value) == words
    assert info.value.__cause__ is error


@posix_only
def test_only_regular_files_of_the_allowed_size_are_read(tmp_path):
    path = tmp_path / "f"
    path.write_bytes(b"12345")
    assert read_bytes(path, "a thing", 5) == b"12345"
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
