"""Pickles as plain data: what is read, what is refused, and that nothing of them is run."""

import contextlib
import pickle

import numpy as np
import pytest

from clradar.files.pickles import ARRAYS, UnsafePickle, load


def read(content):
    return load(content, ARRAYS, "frame")


@pytest.mark.parametrize("protocol", range(6))
def test_plain_data_of_every_protocol(protocol):
    value = {
        "text": "\u00e4\n'\"",
        "numbers": [0, -1, 255, 65536, 2**31, -(2**70), 1.5, 1j],
        "rest": (None, True, False, (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)),
        "deep": {"a": [{"b": []}]},
        7: "x" * 300,
    }
    shared = [value, value]
    found = read(pickle.dumps(shared, protocol))
    assert found == shared
    assert found[0] is found[1]
    assert read(pickle.dumps(b"\x00\xff" * 200, max(protocol, 2))) == b"\x00\xff" * 200


@pytest.mark.parametrize("protocol", range(2, 6))
def test_arrays_keep_their_bits(protocol):
    for code in ("?", "<i2", ">u8", "<f4", ">f8", "<c8", ">c16", "<U3", "S2"):
        whole = np.arange(24).reshape(2, 3, 4).astype(code)
        for array in (whole, np.asfortranarray(whole), whole.transpose(1, 0, 2), whole[0, 0, 0]):
            value = read(pickle.dumps(array, protocol)).value
            assert (value.dtype, value.shape) == (array.dtype, array.shape)
            assert value.tobytes() == array.tobytes()


WHOLE = pickle.dumps(np.arange(6.0), 2)
PYTHON_2 = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
PYTHON_2 += b"(K\x01K\x01\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R\x89U\x00tb."


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no end: it is cut short"),
        (b"K\x01.K\x01.", "3 bytes after the end"),
        (b"\xff\xff", "no operation"),
        (b"\x82\x01.", "the operation EXT1, which no frame needs"),
        (b"Pname\n.", "the operation PERSID"),
        (b"\x97.", "the operation NEXT_BUFFER"),
        (b"K\x01r\xff\xff\xff\x7f.", "memo entry 2147483647, which is too many"),
        (b"cos\nsystem\n.", "the name os.system, which no frame needs; nothing was run"),
        (b"(cposix\nsystem\nU\x01ao.", r"the name posix.system \(os.system\)"),
        (b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93.", "the name builtins.eval"),
        (b"\x80\x04\x8c\x05numpy\x8c\x0fndarray.__new__\x93.", "the name numpy.ndarray.__new__"),
        (b"cnumpy\ndtype\nK\x01\x85R.", "a data type that is not given by its code"),
        (b"cnumpy\nndarray\n)R.", "a call of numpy.ndarray"),
        (b"c_codecs\nencode\nX\x01\0\0\0aX\x05\0\0\0utf-8\x86R.", "something else than latin1"),
        (WHOLE.replace(b"K\x06\x85", b"K\x07\x85"), "56 bytes with 48 bytes of data"),
        (WHOLE.replace(b"K\x06\x85", b"K\xff\x88"), "no tuple of sizes|unknown kind"),
        (WHOLE.replace(b"K\x06\x85", b"J\xff\xff\xff\xff\x85"), "no tuple of sizes"),
        (PYTHON_2, "8 bytes with 0 bytes of data"),
    ],
)
def test_what_is_refused(content, message):
    with pytest.raises(UnsafePickle, match=rf"a pickle with .*({message})") as info:
        read(content)
    assert str(info.value).isprintable()


def test_states_cannot_change_the_classes():
    """BUILD with attributes for a name: not one of them is set."""
    for (module, name), made in ARRAYS.items():
        before = dict(vars(made))
        for state in (b"}U\x08__init__K\x01s", b"N}U\x0c__setstate__K\x01s\x86"):
            with contextlib.suppress(Exception):  # whatever the unpickler raises
                read(f"c{module}\n{name}\n".encode() + state + b"b.")
        assert dict(vars(made)) == before
