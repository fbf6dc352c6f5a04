"""JSON: what is refused, and that what is written reads back equal."""

import json

import pytest

from clradar.errors import MeasurementError, ModelError
from clradar.files.json_differences import differences
from clradar.files.json_file import read_json, read_json_object, write_json
from clradar.files.json_text import parse_object, to_json
from clradar.files.limits import MAX_JSON_DEPTH
from measurement_io import read_alignment


def nested(depth: int) -> object:
    value: object = 1
    for _ in range(depth):
        value = [value]
    return value


def test_files_read_back(tmp_path):
    value = {"a": [1, 2.5, None, True, "\u00e4\n"], "b": {"c": {}}}
    write_json(tmp_path / "v.json", value, force=False)
    assert read_json_object(tmp_path / "v.json") == value
    (tmp_path / "list.json").write_bytes(b"\xef\xbb\xbf[1, NaN]")
    assert read_json(tmp_path / "list.json", "a list", 20)[0] == 1
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "nan.json", float("nan"), force=False)
    assert not (tmp_path / "nan.json").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"a": 1, "a": 2}', "the key 'a' twice"),
        (b"[1]", "list where a JSON object was expected"),
        (b"{", "JSONDecodeError"),
        (b"\xff{}", "UnicodeDecodeError"),
        (b'{"a":' * 100_000, "RecursionError"),
        (json.dumps({"a": nested(MAX_JSON_DEPTH + 1)}).encode(), "levels of nesting"),
    ],
)
def test_files_that_are_refused(tmp_path, content, words):
    path = tmp_path / "v.json"
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=rf"v\.json: expected a JSON object.*{words}"):
        read_json_object(path)


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


def test_differences_in_words():
    before = {"a": 1, "b": {"c": list(range(40))}, "d": "x" * 100 + "1"}
    now = {"a": 1, "b": {"c": [0, -1, *range(2, 41)]}, "d": "x" * 100 + "2", "e": 3}
    assert differences(before, before) == []
    assert differences(before, now) == [
        "b.c of 40, now of 41",
        "b.c[1] 1, now -1",
        f"d …{'x' * 20}1, now …{'x' * 20}2",
        "e None, now 3",
    ]


def test_half_of_a_surrogate_pair_is_named(tmp_path):
    path = tmp_path / "alignment.json"
    path.write_text('{"kinect2radar": [["\\ud800"]]}')
    with pytest.raises(MeasurementError, match=r"kinect2radar.*finite number, got .*ud800"):
        read_alignment(path)
