"""Files made to do harm: each ends in one line, quickly, with little memory; plain pickles."""

import contextlib
import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import maroon_files
import numpy as np
import pytest
from layout_files import layout
from mesh_files import glb, tetrahedron
from systems import linux_only

import clradar
import measurement_io
from clradar.errors import ClradarError
from clradar.files.hashing import content_record
from clradar.files.pickles import ARRAYS, UnsafePickle, load
from clradar.rigs import read_rig

CPU_LIMIT_S = 20.0
"""Of this process and of those that it started: on a loaded machine the clock says nothing."""

LIMIT_BYTES = 2 * 2**30
"""Of this process; that which reads has a limit of its own (tests/files/confined)."""

LAYOUT = """
[data]
key = "data"
axes = ["tx", "rx", "freq"]
[tx]
array = "qar50"
[rx]
array = "qar50"
[frequency]
values = [72e9, 73e9, 74e9, 75e9]
unit = "Hz"
"""


class Evil:
    def __init__(self, call, *arguments):
        self._reduced = call, arguments

    def __reduce__(self):
        return self._reduced


def frame(content):
    return maroon_files.npy(content)


def header(shape, descr="<c8"):
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text


def sparse(path, start, size=2**40):
    path.write_bytes(start)
    os.truncate(path, size)


PICKLED = np.array([Evil(os.system, "touch owned")], object)


def zip_of(path, content, count=1):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for i in range(count):
            archive.writestr(f"data{i or ''}.npy", content)


def unbacked(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("data", (94, 94, 2**40), np.complex64, chunks=(1, 1, 2**20))


def mat5(shape, content, *, deflated=False):
    def element(kind, body):
        return struct.pack("<II", kind, len(body)) + body + bytes(-len(body) % 8)

    inner = element(6, struct.pack("<II", 6, 0))
    inner += element(5, struct.pack(f"<{len(shape)}i", *shape))
    inner += element(1, b"data") + content
    whole = element(14, inner)
    if deflated:
        packed = zlib.compress(whole, 9)
        whole = struct.pack("<II", 15, len(packed)) + packed
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + whole


ENDLESS = [
    {"bufferView": at, "componentType": 5126, "count": 2**40, "type": "VEC3"} for at in (0, 1)
]


def with_buffer(uri):
    tree = tetrahedron(buffers=[{"uri": uri, "byteLength": 72}])
    return json.dumps(tree).encode()


def png(width, height, size):
    def chunk(name, body):
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    start = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    data = chunk(b"IDAT", zlib.compress(bytes(size), 9))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", start) + data + chunk(b"IEND", b"")


FLOAT64 = b"cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNN"
FLOAT64 += 2 * b"J\xff\xff\xff\xff" + b"K\x00tb"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
STATE = EMPTY + b"(K\x01" + 2 * b"J\x40\x42\x0f\x00" + b"\x86" + FLOAT64 + b"\x89U\x00tb."
BUFFER = b"cnumpy.core.numeric\n_frombuffer\n(C\x01x" + FLOAT64 + b"J\0\0\0\x40\x85X\x01\0\0\0CtR."


def nested_tuples(depth):
    return b"\x80\x02}" + b")" + b"\x85" * depth + b"K\x01s."


CRAFTED: dict[str, tuple[str, Callable[[Path], None] | bytes]] = {
    "os.system": ("frame.npy", frame(pickle.dumps(Evil(os.system, "touch owned")))),
    "bytes of 2^62": ("frame.npy", frame(b"\x80\x04\x8e" + b"\xff" * 7 + b"\x3f.")),
    "8 TB by a state": ("frame.npy", frame(b"\x80\x05" + STATE)),
    "8 GB by a buffer": ("frame.npy", frame(b"\x80\x05" + BUFFER)),
    "deep keys": ("frame.npy", frame(nested_tuples(10**6))),
    "keys that take for ever": ("frame.npy", frame(b"\x80\x02}K\x01" + b"".join(
        b"q%ch%c\x86" % (i, i) for i in range(60)) + b"K\x01s.")),
    "deep lists": ("frame.npy", frame(b"\x80\x02" + b"]" * 10**6 + b"a" * (10**6 - 1) + b".")),
    "a sparse frame": ("frame.npy", lambda path: sparse(path, frame(b"\x80\x02}."))),
    "a shape of 2^62": ("lab.npy", header((2**31, 2**31)) + bytes(64)),
    "a zip bomb": ("lab.npz", lambda path: zip_of(
        path, header((94, 94, 2**14)) + bytes(2**26))),
    "members": ("lab.npz", lambda path: zip_of(path, header((1,)) + bytes(8), 11_000)),
    "a pickle in an archive": ("lab.npz", lambda path: np.savez(path, data=PICKLED)),
    "MATLAB of 2^62": ("lab.mat", mat5((2**31 - 1,) * 2, struct.pack("<II", 9, 8) + bytes(8))),
    "a MATLAB bomb": ("lab.mat", mat5(
        (94, 94, 2**14), struct.pack("<II", 9, 94 * 94 * 2**17), deflated=True)),
    "an unbacked dataset": ("lab.h5", unbacked),
    "vertices of 2^40": ("mesh.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex "
                         b"1099511627776\nproperty float x\nproperty float y\nproperty float z\n"
                         b"element face 0\nproperty list uchar int vertex_indices\nend_header\n"),
    "deep JSON": ("mesh.gltf", b'{"asset": ' + b"[" * 10**6 + b"]" * 10**6 + b"}"),
    "numbers of 2^40": ("mesh.glb", glb(tetrahedron(accessors=ENDLESS))),
    "a buffer elsewhere": ("mesh.gltf", with_buffer("../../../../../../../../etc/passwd")),
    "a buffer by address": ("mesh.gltf", with_buffer("file:///etc/passwd")),
    "an OBJ of one line": ("mesh.obj", b"f " + b"1 " * 10**6),
    "a PNG bomb": ("depth.png", png(4000, 4000, 10**8)),
    "a PNG of 2^62": ("depth.png", png(2**31 - 1, 2**31 - 1, 10**3)),
    "any sparse file": ("input.h5", lambda path: sparse(path, b"", 2**29)),
    "a huge number": ("layout.toml", LAYOUT.replace("72e9", "9" * 5000).encode()),
}  # fmt: skip
CRAFTED |= {
    f"a pipe for {name}": (name, lambda path: os.mkfifo(path))
    for name in ("frame.npy", "mesh.ply", "hand.pkl", "depth.png", "input.h5")
}
CRAFTED |= {
    f"a device for {name}": (name, lambda path: os.symlink("/dev/zero", path))
    for name in ("frame.npy", "lab.h5", "transform.json")
}


def read(path):
    kind = path.stem
    if kind == "mesh":
        return clradar.Scene.from_mesh(path)
    if kind == "hand":
        return read_rig(path, handedness="right", unit="m")
    if kind == "depth":
        radar = path.parent / "radar_72.0_82.0_2"
        (radar / "depth").mkdir(parents=True)
        os.rename(path, radar / "depth" / "000000.png")
        grid = {"volume": {"bb_min": [0, 0, 0], "bb_max": [1, 1, 1], "grid_size": [2, 2, 2]}}
        (radar / "calibration.json").write_text(json.dumps({"000000": grid}))
        return measurement_io.read_depth_map(radar, 0)
    if kind == "layout":
        return measurement_io.read_layout(path)
    if kind == "input":
        return content_record(path)
    if kind == "transform":
        return measurement_io.read_transform(path)
    if kind == "lab":
        return measurement_io.open_capture(path, layout=layout(path.parent, LAYOUT))
    return measurement_io.open_capture(path)


def processor_s():
    return sum(os.times()[:4])


@linux_only
@pytest.mark.parametrize("name", CRAFTED)
def test_crafted_files(name, tmp_path, monkeypatch):
    import resource  # which Windows has not

    file, content = CRAFTED[name]
    monkeypatch.chdir(tmp_path)
    path = tmp_path / file
    if callable(content):
        content(path)
    else:
        path.write_bytes(content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = processor_s()
    with pytest.raises(ClradarError) as caught:
        read(path)
    message = str(caught.value)
    assert all(line.isprintable() and len(line) < 1000 for line in message.split("\n")), message
    assert processor_s() - began < CPU_LIMIT_S
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown * 1024 < LIMIT_BYTES
    assert not (tmp_path / "owned").exists()
    assert "root:" not in message


def loaded(content):
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
    found = loaded(pickle.dumps(shared, protocol))
    assert found == shared
    assert found[0] is found[1]
    assert loaded(pickle.dumps(b"\x00\xff" * 200, max(protocol, 2))) == b"\x00\xff" * 200


@pytest.mark.parametrize("protocol", range(2, 6))
def test_arrays_keep_their_bits(protocol):
    for code in ("?", "<i2", ">u8", "<f4", ">f8", "<c8", ">c16", "<U3", "S2"):
        whole = np.arange(24).reshape(2, 3, 4).astype(code)
        for array in (whole, np.asfortranarray(whole), whole.transpose(1, 0, 2), whole[0, 0, 0]):
            value = loaded(pickle.dumps(array, protocol)).value
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
        loaded(content)
    assert str(info.value).isprintable()


def test_states_cannot_change_the_classes():
    """BUILD with attributes for a name: not one of them is set."""
    for (module, name), made in ARRAYS.items():
        before = dict(vars(made))
        for state in (b"}U\x08__init__K\x01s", b"N}U\x0c__setstate__K\x01s\x86"):
            with contextlib.suppress(Exception):  # whatever the unpickler raises
                loaded(f"c{module}\n{name}\n".encode() + state + b"b.")
        assert dict(vars(made)) == before
