"""Pickles as plain data: what is read, what is refused, and that nothing of them is run."""

from __future__ import annotations

import pickle
import struct
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clradar.files.safe_pickle import ARRAYS, PickledArray, UnsafePickle, load


def read(content: bytes) -> Any:
    return load(content, ARRAYS, "frame")


@pytest.mark.parametrize("protocol", range(6))
def test_plain_data_of_every_protocol(protocol: int) -> None:
    value = {
        "text": "\u00e4\n'\"", "numbers": [0, -1, 255, 65536, 2**31, -(2**70), 1.5, 1j],
        "rest": (None, True, False, (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)),
        "deep": {"a": [{"b": []}]}, 7: "x" * 300,
    }  # fmt: skip
    shared = [value, value]
    found = read(pickle.dumps(shared, protocol))
    assert found == shared
    assert found[0] is found[1]
    assert read(pickle.dumps(b"\x00\xff" * 200, max(protocol, 2))) == b"\x00\xff" * 200
    assert sorted(read(pickle.dumps({1, 2}, max(protocol, 4)))) == [1, 2]


@pytest.mark.parametrize("protocol", range(2, 6))
@pytest.mark.parametrize("code", ["?", "<i2", ">u8", "<f4", ">f8", "<c8", ">c16", "<U3", "S2"])
@pytest.mark.parametrize(
    "layout",
    [np.ascontiguousarray, np.asfortranarray, lambda a: a.transpose(1, 0, 2), lambda a: a[0, 0, 0]],
    ids=["c", "fortran", "permuted", "scalar"],
)
def test_arrays_keep_their_bits(
    protocol: int, code: str, layout: Callable[[np.ndarray], Any]
) -> None:
    array = layout(np.arange(24).reshape(2, 3, 4).astype(code))
    found = read(pickle.dumps(array, protocol))
    value = found.value if isinstance(found, PickledArray) else found
    assert isinstance(value, np.ndarray | np.generic)
    assert (value.dtype, value.shape) == (array.dtype, array.shape)
    assert value.tobytes() == array.tobytes()


def test_arrays_of_other_types_have_no_numbers() -> None:
    objects = np.array([{}, None], dtype=object)
    assert read(pickle.dumps(objects)).value == [{}, None]
    assert read(pickle.dumps(np.zeros(2, "datetime64[D]"))).value is None
    assert read(pickle.dumps(np.zeros(2, [("a", "f4")]))).value is None


def test_keys_that_are_slow_to_hash_are_left_out() -> None:
    given = {"a": 1, 2: 3, 2.5: 4, 2**70: 5, (1, 2): 6, None: 7}
    assert read(pickle.dumps(given)) == {"a": 1, 2: 3, 2.5: 4}


WHOLE = pickle.dumps(np.arange(6.0), 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no end: it is cut short"),
        (b"\x80\x02K\x01", "cut short"),
        (b"K\x01K\x02.", "an end in the middle"),
        (b"(K\x01.", "an end in the middle"),
        (b"K\x01.K\x01.", "3 bytes after the end"),
        (b"\x80\x06K\x01.", "protocol 6"),
        (b"\xff\xff", "no operation"),
        (b"\x82\x01.", "the operation EXT1, which no frame needs"),
        (b"Pname\n.", "the operation PERSID"),
        (b"\x97.", "the operation NEXT_BUFFER"),
        (b"h\x07.", "memo entry 7, which was never stored"),
        (b"0.", "take more than there is"),
        (b"]e.", "no mark"),
        (b"}(K\x01u.", "no dictionary"),
        (b"]K\x01}s.", "take more than there is|no dictionary"),
        (b"}K\x01a.", "no list"),
        (b"cos\nsystem\n.", "the name os.system, which no frame needs; nothing was run"),
        (b"(cposix\nsystem\nU\x01ao.", r"the name posix.system \(os.system\)"),
        (b"(int\nsystem\n.", r"the name nt.system \(os.system\)|the name nt.system"),
        (b"K\x01K\x02\x93.", "a name that is no string"),
        (b"K\x01K\x02\x86R.", "take more|no name"),
        (b"cnumpy\ndtype\nK\x01\x85R.", "a data type that is not given by its code"),
        (b"cnumpy\ndtype\n(ttR.", "no mark|a call of something"),
        (b"cnumpy\nndarray\n)\x81.", "a call of numpy.ndarray"),
        (b"]}b.", "a state for something that has none"),
        (b"S1\n.", "a string without quotes"),
        (b"c_codecs\nencode\nX\x01\0\0\0aX\x05\0\0\0utf-8\x86R.", "something else than latin1"),
        (WHOLE.replace(b"K\x06\x85", b"K\x07\x85"), "56 bytes with 48 bytes of data"),
        (WHOLE.replace(b"K\x06\x85", b"K\xff\x88"), "take more|no tuple of sizes|unknown kind"),
    ],
)
def test_what_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(UnsafePickle, match=rf"a pickle with .*({message})") as info:
        read(content)
    assert str(info.value).isprintable()


def test_one_string_encoded_again_and_again_is_refused() -> None:
    text = b"X" + struct.pack("<I", 2**20) + b"x" * 2**20
    again = b"c_codecs\nencode\nh\x00X\x06\0\0\0latin1\x86R"
    content = b"\x80\x02(" + text + b"q\x00" + again * 1000 + b"t."
    tracemalloc.start()
    try:
        with pytest.raises(UnsafePickle, match=r"_codecs\.encode"):
            read(content)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 10 * len(content)
