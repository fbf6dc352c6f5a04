"""TOML: what is refused, and that what is written reads back equal."""

import pytest

from clradar.errors import MeasurementError
from clradar.files.limits import MAX_TOML_LINE_CHARACTERS
from clradar.files.toml_file import parse_toml, read_toml, toml_brief, toml_document


def test_documents_read_back():
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


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a = ", "TOMLDecodeError"),
        (b"a = 1\na = 2", "TOMLDecodeError"),
        (b"\xff", "UnicodeDecodeError"),
        (b"a." * (MAX_TOML_LINE_CHARACTERS // 2) + b"b = 1", "a line of"),
        (b"a = " + b"[" * 5000, "RecursionError"),
        (b"#" * 12_000 + b"\n" + b"#" * 12_000, "of at most 20000 bytes"),
    ],
)
def test_files_that_are_refused(tmp_path, content, words):
    path = tmp_path / "t.toml"
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=rf"t\.toml: expected a plan.*{words}"):
        read_toml(path, "a plan", limit=20_000)


def test_a_byte_order_mark_is_no_content(tmp_path):
    (tmp_path / "t.toml").write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_toml(tmp_path / "t.toml", "a plan") == {"a": 1}


def test_values_in_messages_are_short():
    assert toml_brief([True, "x", 1.5, None, {"a": 1}]) == '[true, "x", 1.5, nothing, { a = 1 }]'
    assert len(toml_brief(["y" * 10_000] * 100)) < 1300
    assert toml_brief(10**5000) == "a huge number"
