"""Damaged and hostile containers: one error, whatever they claim; bombs cost no memory."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from layout_files import CONTAINERS, layout, random_capture, write
from systems import linux_only
from test_layouts import PLAIN, assert_same, refused, tree_of

from clradar.errors import MeasurementError
from measurement_io import describe, open_capture, open_with_layout
from measurement_io.layouts.lab_file import LabFile

MEMORY_BYTES = 2 * 2**30
"""What docs/layouts.md promises: no file of a few tens of megabytes leads to more."""


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    return layout(tmp_path, PLAIN)


# ---- any container


@pytest.mark.parametrize("container", CONTAINERS)
def test_files_that_are_cut_short(tmp_path: Path, container: str, toml: Path) -> None:
    whole = write(container, tmp_path / "c", tree_of(random_capture())).read_bytes()
    for size in sorted(
        {*range(0, len(whole), len(whole) // 40), len(whole) - 1, 1, 8, 127, 128, 136, 512}
    ):
        if container.startswith("hdf5") and size == len(whole) - 1:
            continue  # nothing of importance is there
        (tmp_path / "cut").write_bytes(whole[:size])
        refused(tmp_path / "cut", toml)
        with pytest.raises(MeasurementError):
            open_capture(tmp_path / "cut")


@pytest.mark.parametrize("container", ["npz", "npz deflated", "mat v5 deflated", "hdf5 gzip"])
def test_checksums_are_compared(tmp_path: Path, container: str, toml: Path) -> None:
    """A flipped bit among the numbers is noticed wherever the container has a checksum."""
    tree = tree_of(random_capture(), data=random_capture(32, 16, 64).data)
    whole = bytearray(write(container, tmp_path / "c", tree).read_bytes())
    whole[len(whole) // 2] ^= 1  # the data fills nearly all of the file
    (tmp_path / "c").write_bytes(whole)
    with pytest.raises(MeasurementError):
        LabFile.opened(tmp_path / "c", [("data", {})]).read("data", "the data")


# ---- .npy and .npz


def npy(header: str, content: bytes = b"", version: bytes = b"\1\0") -> bytes:
    text = header.encode("latin1")
    size = struct.pack("<H" if version == b"\1\0" else "<I", len(text))
    return b"\x93NUMPY" + version + size + text + content


def header(shape: str, descr: str = "'<c8'", order: str = "False") -> str:
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n"


BAD_NPY = [
    npy(header("(5, 4, 6)"), bytes(5 * 4 * 6 * 8 - 1)),
    npy(header("(5, 4, 6)"), bytes(5 * 4 * 6 * 8 + 1)),
    npy(header("(99999999999, 4, 6)")),
    npy(header("(-5, -4, 6)"), bytes(960)),
    npy(header("(True, 4, 6)"), bytes(192)),
    npy(header("(5.0, 4, 6)"), bytes(960)),
    npy(header("5"), bytes(40)),
    npy(header(str((1,) * 40)), bytes(8)),
    npy(header("(5,)", "'|O'"), bytes(40)),
    npy(header("(5,)", "[('a', '<f4'), ('b', '|O')]"), bytes(60)),
    npy(header("(5, 4, 6)", "'<M8[s]'"), bytes(960)),
    npy(header("(5, 4, 6)", "'V8'"), bytes(960)),
    npy(header("(5, 4, 6)", "('<f4', (2,))"), bytes(960)),
    npy(header("(5, 4, 6)", "__import__('os').system('true')"), bytes(960)),
    npy(header("(5, 4, 6)"), bytes(960), b"\3\0"),
    npy("-" * 9000),
    npy("(" * 9000),
    npy(header("(5, 4, 6)")[:-20]),
    b"\x93NUMPY\2\0\xff\xff\xff\xff{",
    b"\x93NUMPY",
]


@pytest.mark.parametrize("content", BAD_NPY, ids=range(len(BAD_NPY)))
def test_bad_npy(tmp_path: Path, content: bytes) -> None:
    text = PLAIN.replace('"data"', '"array"')
    for side in ("tx", "rx"):
        text = text.replace(f'key = "{side}"', 'array = "qar50"')
    toml = layout(tmp_path, text.replace('key = "f"', "values = [72e9]"))
    (tmp_path / "c.npy").write_bytes(content)
    refused(tmp_path / "c.npy", toml)
    with pytest.raises(MeasurementError):
        open_capture(tmp_path / "c.npy")
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("array.npy", content)
    refused(tmp_path / "c.npz", toml)


def test_no_pickle_is_read(tmp_path: Path, toml: Path) -> None:
    class Evil:
        def __reduce__(self) -> Any:
            return (open, (str(tmp_path / "owned"), "w"))

    tree = tree_of(random_capture())
    np.savez(tmp_path / "c.npz", **{**tree, "f": np.array([Evil()], dtype=object)})
    assert "never read" in refused(tmp_path / "c.npz", toml)
    assert "never read" in str(describe(tmp_path / "c.npz"))
    np.savez(tmp_path / "d.npz", **tree, other=np.array([Evil()], dtype=object))
    assert_same(open_with_layout(tmp_path / "d.npz", toml), random_capture())
    assert not (tmp_path / "owned").exists()


def test_unusual_archives(tmp_path: Path, toml: Path) -> None:
    good = io.BytesIO()
    np.save(good, np.zeros(3))
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("data.npy", good.getvalue())
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("data.npy", good.getvalue())
    assert "every key once" in refused(tmp_path / "c.npz", toml)
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("data.txt", "text")
        archive.writestr("data", "text")
    assert "no .npy array" in refused(tmp_path / "c.npz", toml)
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("data.npy", good.getvalue())
    raw = bytearray((tmp_path / "c.npz").read_bytes())
    raw[raw.index(b"PK\1\2") + 8] |= 1
    (tmp_path / "c.npz").write_bytes(raw)
    assert "encrypted" in refused(tmp_path / "c.npz", toml)


# ---- HDF5


def remade(change: Callable[[h5py.File, np.ndarray], None]) -> Callable[[Path], None]:
    """Return a writer of files whose dataset "data" is replaced by `change`."""

    def make(path: Path) -> None:
        tree = tree_of(random_capture())
        write("hdf5", path, tree)
        with h5py.File(path, "r+") as file:
            del file["data"]
            change(file, tree["data"])

    return make


def missing_chunk(file: h5py.File, data: np.ndarray) -> None:
    made = file.create_dataset("data", data.shape, "c8", chunks=(1, 4, 6))
    made[:-1] = data[:-1]


def virtual(file: h5py.File, data: np.ndarray) -> None:
    file["other"] = data
    made = h5py.VirtualLayout(data.shape, data.dtype)
    made[:] = h5py.VirtualSource(file["other"])
    file.create_virtual_dataset("data", made)


def external_storage(file: h5py.File, data: np.ndarray) -> None:
    secret = Path(file.filename).with_name("secret")
    secret.write_bytes(data.tobytes())
    file.create_dataset("data", data.shape, "c8", external=[(str(secret), 0, 960)])


def external_link(file: h5py.File, data: np.ndarray) -> None:
    with h5py.File(Path(file.filename).with_name("other.h5"), "w") as other:
        other["data"] = data
    file["data"] = h5py.ExternalLink("other.h5", "/data")


def soft_link(file: h5py.File, data: np.ndarray) -> None:
    file["other"] = data
    file["data"] = h5py.SoftLink("/other")


HOSTILE_HDF5 = [
    (missing_chunk, "5 chunks stored"),
    (lambda f, d: f.create_dataset("data", d.shape, "c8"), "bytes stored"),
    (virtual, "virtual"),
    (external_storage, "external storage"),
    (external_link, "ExternalLink"),
    (soft_link, "SoftLink"),
    (lambda f, d: f.create_dataset("data", data=d.real.astype("i4"), scaleoffset=4), "filter"),
    (lambda f, d: f.create_dataset("data", (2**20, 2**20, 6), "c8", chunks=(1, 1, 6)), "channels"),
    (lambda f, d: f.create_dataset("data", d.shape, "c8", chunks=(2**9,) * 3,
                                   maxshape=(None,) * 3), "in chunks of at most"),
    (lambda f, d: f.create_group("data"), "the key 'data'"),
    (lambda f, d: f.create_dataset("data", data=h5py.Empty("c8")), "empty"),
    (lambda f, d: f.create_dataset("data", (5, 4, 6), h5py.ref_dtype), "object"),
    (lambda f, d: f.create_dataset("data", (5, 4, 6), h5py.vlen_dtype("f4")), "object"),
    (lambda f, d: f.create_dataset("data", (5, 4, 6), [("r", "f4"), ("i", "S9")]), "hold numbers"),
    (lambda f, d: f.create_dataset("data", (5, 4, 6), ("f4", (2,))), "hold numbers"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), HOSTILE_HDF5, ids=range(len(HOSTILE_HDF5)))
def test_hostile_hdf5(
    tmp_path: Path,
    toml: Path,
    change: Callable[[h5py.File, np.ndarray], None],
    expected: str,
) -> None:
    remade(change)(tmp_path / "c.h5")
    assert expected in refused(tmp_path / "c.h5", toml)


def test_groups_that_hold_each_other(tmp_path: Path, toml: Path) -> None:
    capture = random_capture()
    path = write("hdf5", tmp_path / "c", tree_of(capture))
    with h5py.File(path, "r+") as file:
        file["again"] = file["/"]
        inner = file.create_group("a/b/c")
        inner["back"] = file["a"]
    assert_same(open_with_layout(path, toml), capture)
    with h5py.File(path, "r+") as file:
        file.create_group("/".join("abcdefghijklmnopqrstuvwxyz"))
    assert "nested" in refused(path, toml)


def test_text_that_claims_gigabytes(tmp_path: Path) -> None:
    path = write("hdf5", tmp_path / "c", {**tree_of(random_capture()), "note": "a note"})
    toml = layout(tmp_path, PLAIN + '[meta]\nkeys = ["note"]\n')
    with h5py.File(path) as file:
        offset = file["note"].id.get_offset()
    assert open_with_layout(path, toml).meta["file"] == {"note": "a note"}
    raw = bytearray(path.read_bytes())
    raw[offset : offset + 4] = b"\xff\xff\xff\xff"
    path.write_bytes(raw)
    refused(path, toml)


@pytest.mark.parametrize("block", [512, 1024, 2048])
def test_other_user_blocks(tmp_path: Path, toml: Path, block: int) -> None:
    capture = random_capture()
    with h5py.File(tmp_path / "c", "w", userblock_size=block) as file:
        for key, value in tree_of(capture).items():
            file[key] = value
    assert_same(open_with_layout(tmp_path / "c", toml), capture)


def test_matlab_classes_of_v73(tmp_path: Path, toml: Path) -> None:
    capture = random_capture()
    path = write("mat v7.3", tmp_path / "c", {**tree_of(capture), "word": "hällo"})
    with h5py.File(path, "r+") as file:
        file["#refs#/a"] = [[1.0]]
        cell = file.create_dataset("cell", data=[[file["#refs#/a"].ref]], dtype=h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        file["flag"] = np.uint8([[1]])
        file["flag"].attrs["MATLAB_class"] = np.bytes_("logical")
        file["nothing"] = np.uint64([0, 0])
        file["nothing"].attrs["MATLAB_class"] = np.bytes_("double")
        file["nothing"].attrs["MATLAB_empty"] = np.uint8(1)
        file["odd"] = [[1.0]]
        file["odd"].attrs["MATLAB_class"] = "text of variable length"
    assert_same(open_with_layout(path, toml), capture)
    found = LabFile.opened(
        path, [(name, {}) for name in ("word", "cell", "flag", "odd", "nothing")]
    )
    assert found.text("word", "a test") == "hällo"
    assert not any(name.startswith("#") for name in found.keys)
    for name, kind in (("cell", "cell"), ("flag", "logical"), ("odd", "unknown form")):
        with pytest.raises(MeasurementError, match=kind):
            found.read(name, "a test")
    with pytest.raises(MeasurementError, match="hold numbers"):
        found.read("nothing", "a test")


# ---- MATLAB v5


def element(kind: int, content: bytes) -> bytes:
    padding = bytes(-len(content) % 8) if kind != 15 else b""
    return struct.pack("<II", kind, len(content)) + content + padding


def matrix(
    array_class: int, shape: tuple[int, ...], name: str, rest: bytes, flags: int = 0
) -> bytes:
    inner = element(6, struct.pack("<II", array_class | flags, 0))
    inner += element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, inner + element(1, name.encode()) + rest)


def mat5(*elements: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements)


def struct_of(name: str, fields: bytes, *members: bytes) -> bytes:
    return matrix(2, (1, 1), name, element(5, struct.pack("<i", 8)) + element(1, fields) +
                  b"".join(members))  # fmt: skip


DOUBLE = matrix(6, (1, 2), "", element(9, bytes(16)))


def nested(depth: int) -> bytes:
    inner = DOUBLE
    for i in range(depth):
        inner = struct_of("data" if i == depth - 1 else "", b"a".ljust(8, b"\0"), inner)
    return inner


BAD_MAT5 = [
    mat5(),
    mat5(element(9, bytes(8))),
    mat5(element(14, b"")),
    mat5(matrix(6, (5, 4, 6), "data", element(9, bytes(8)))),
    mat5(matrix(6, (2**31 - 1,) * 3, "data", element(9, bytes(8)))),
    mat5(matrix(6, (-1, -960), "data", element(9, bytes(960 * 8)))),
    mat5(matrix(6, (960,), "data", element(9, bytes(960 * 8)))),
    mat5(matrix(6, (1,) * 40, "data", element(9, bytes(8)))),
    mat5(matrix(7, (5, 4, 6), "data", element(7, bytes(480)), 0x0800)),
    mat5(matrix(1, (1, 1), "data", DOUBLE)),
    mat5(matrix(3, (1, 1), "data", DOUBLE)),
    mat5(matrix(5, (5, 4), "data", element(5, bytes(8)))),
    mat5(matrix(16, (1, 1), "data", DOUBLE)),
    mat5(matrix(99, (1, 1), "data", DOUBLE)),
    mat5(matrix(2, (1, 3), "data", element(5, struct.pack("<i", 8)))),
    mat5(struct_of("data", b"a".ljust(8, b"\0"))),
    mat5(struct_of("data", b"a".ljust(9, b"\0"), DOUBLE)),
    mat5(struct_of("data", b"a".ljust(8, b"\0"), element(9, bytes(8)))),
    mat5(nested(40)),
    mat5(DOUBLE, DOUBLE, b"\0\0\0"),
    mat5(
        matrix(6, (1, 1), "f", element(9, bytes(8))), matrix(6, (1, 1), "f", element(9, bytes(8)))
    ),
    mat5(element(15, zlib.compress(DOUBLE)[:-4])),
    mat5(element(15, zlib.compress(element(15, zlib.compress(DOUBLE))))),
    mat5(element(15, zlib.compress(struct.pack("<II", 14, 2**32 - 1)))),
    mat5(element(15, b"no zlib")),
    mat5(struct.pack("<II", 14, 2**32 - 1)),
    mat5(struct.pack("<II", 14 | 5 << 16, 0)),
]


@pytest.mark.parametrize("content", BAD_MAT5, ids=range(len(BAD_MAT5)))
def test_bad_mat5(tmp_path: Path, toml: Path, content: bytes) -> None:
    (tmp_path / "c.mat").write_bytes(content)
    refused(tmp_path / "c.mat", toml)
    with pytest.raises(MeasurementError):
        open_capture(tmp_path / "c.mat")


def test_mat5_types(tmp_path: Path) -> None:
    """Numbers of every class, in structs too; what is none is listed and not read."""
    rng = np.random.default_rng(0)
    tree: dict[str, Any] = {
        dtype: (100 * rng.standard_normal((3, 2, 4))).astype(dtype)
        for dtype in ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "c8", "c16")
    }
    tree |= {"one": 1.0, "whole": np.arange(300.0)}
    tree["rec"] = {"deep": {"a": tree["f8"], "text": "abc"}, "c": tree["c16"]}
    tree |= {"cell": np.array([[1, "a"]], object), "flag": np.array([[True]]), "empty": []}
    scipy.io.savemat(tmp_path / "c.mat", tree)
    found = LabFile.opened(tmp_path / "c.mat")
    numbers = [name for name, key in found.keys.items() if key.content == "numbers"]
    assert {"f8", "rec/deep/a", "rec/c", "one", "whole", "flag"} <= set(numbers)
    found = LabFile.opened(tmp_path / "c.mat", [(name, {}) for name in (*found.keys, "rec.deep.a")])
    for name in ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "c8", "c16"):
        assert found.read(name, "a test").tobytes() == tree[name].tobytes()
        assert found.read(name, "a test").dtype == tree[name].dtype
    assert found.read("whole", "a test").dtype == np.float64
    assert found.read("rec.deep.a", "a test").tobytes() == tree["f8"].tobytes()
    assert found.text("rec.deep.text", "a test") == "abc"
    for name in ("cell", "empty"):
        with pytest.raises(MeasurementError, match=r"cell|hold numbers|at least one"):
            found.read(name, "a test")


def test_mat5_of_a_big_endian_machine(tmp_path: Path) -> None:
    inner = struct.pack(">IIII", 6, 8, 6 | 0x0800, 0) + struct.pack(">IIii", 5, 8, 1, 2)
    inner += struct.pack(">HH4s", 1, 1, b"z") + struct.pack(">IIdd", 9, 16, 1.5, -2)
    inner += struct.pack(">HH4B", 2, 2, 3, 4, 0, 0)  # whole numbers are stored as bytes
    content = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI" + struct.pack(">II", 14, len(inner))
    (tmp_path / "c.mat").write_bytes(content + inner)
    read = LabFile.opened(tmp_path / "c.mat", [("z", {})]).read("z", "a test")
    assert np.array_equal(read, [[1.5 + 3j, -2 + 4j]])


# ---- memory

FRAMES = 127
"""Frames of 32 MiB: together 4 GiB."""


def npz_bomb(path: Path) -> None:
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("data.npy", "w", force_zip64=True) as member,
    ):
        member.write(npy(header(f"({FRAMES}, 4096, 1024)")))
        for _ in range(FRAMES):
            member.write(bytes(2**25))


def mat5_bomb(path: Path, field: bool = False) -> None:
    nbytes = FRAMES * 2**25
    sizes = element(5, struct.pack("<3i", 4096, 1024, FRAMES))
    inner = element(6, struct.pack("<II", 6, 0)) + sizes + element(1, b"" if field else b"data")
    inner += struct.pack("<II", 9, nbytes)
    whole = struct.pack("<II", 14, len(inner) + nbytes) + inner
    if field:
        outer = element(6, struct.pack("<II", 2, 0)) + element(5, struct.pack("<ii", 1, 1))
        outer += element(1, b"rec") + element(5, struct.pack("<i", 8))
        outer += element(1, b"data".ljust(8, b"\0")) + whole
        whole = struct.pack("<II", 14, len(outer) + nbytes) + outer
    deflate = zlib.compressobj(9)
    content = deflate.compress(whole)
    content += b"".join(deflate.compress(bytes(2**25)) for _ in range(FRAMES))
    content += deflate.flush()
    path.write_bytes(mat5(struct.pack("<II", 15, len(content)) + content))


def hdf5_bomb(path: Path, compression: str) -> None:
    with h5py.File(path, "w") as file:
        chunks = (1, 4096, 1024)
        made = file.create_dataset(
            "data", (FRAMES, 4096, 1024), "f8", chunks=chunks, compression=compression
        )
        for i in range(FRAMES):
            made[i] = 0


def peak_bytes(program: str, *arguments: object) -> int:
    """Run a program in a process of its own and return its peak of memory."""
    measured = "import resource, sys\n" + program
    # HDF5 files are read in another process: the sum of both peaks.
    measured += "peaks = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)\n"
    measured += "print(sum(resource.getrusage(who).ru_maxrss for who in peaks))\n"
    done = subprocess.run(
        [sys.executable, "-c", measured, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout.split()[-1]) * 1024


@linux_only
@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "frames"),
    [
        (npz_bomb, False),
        (mat5_bomb, False),
        (lambda path: mat5_bomb(path, field=True), False),
        (lambda path: hdf5_bomb(path, "gzip"), True),
        (lambda path: hdf5_bomb(path, "lzf"), True),
    ],
    ids=["npz", "mat v5", "mat v5 field", "hdf5 gzip", "hdf5 lzf"],
)
def test_files_that_inflate(tmp_path: Path, make: Callable[[Path], None], frames: bool) -> None:
    """Four gigabytes are refused as a whole; of HDF5 single frames are read."""
    make(tmp_path / "bomb")
    assert (tmp_path / "bomb").stat().st_size < 64 * 2**20
    program = (
        "from pathlib import Path\n"
        "from clradar.errors import MeasurementError\n"
        "from measurement_io.layouts.lab_file import LabFile\n"
        "try:\n"
        "    LabFile.opened(Path(sys.argv[1]), [('data', {})]).read('data', 'a test')\n"
        "    sys.exit(3)\n"
        "except MeasurementError as error:\n"
        "    print(error)\n"
        "if sys.argv[2] == 'True':\n"
        "    found = LabFile.opened(Path(sys.argv[1]), [('data', {0: 100})])\n"
        "    frame = found.read('data', 'a test')\n"
        "    assert frame.shape == (4096, 1024) and not frame.any()\n"
    )
    began = time.monotonic()
    assert peak_bytes(program, tmp_path / "bomb", frames) < MEMORY_BYTES
    assert time.monotonic() - began < 20


@linux_only
@pytest.mark.slow
def test_a_chunk_that_inflates_to_gigabytes(tmp_path: Path, toml: Path) -> None:
    deflate = zlib.compressobj(9)
    bomb = b"".join(deflate.compress(bytes(2**25)) for _ in range(256)) + deflate.flush()
    write("hdf5", tmp_path / "c.h5", tree_of(random_capture()))
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        shape = file["data"].shape
        del file["data"]
        made = file.create_dataset("data", shape, "c8", chunks=shape, compression="gzip")
        made.id.write_direct_chunk((0, 0, 0), bomb)
    began = time.monotonic()
    refused(tmp_path / "c.h5", toml)
    assert time.monotonic() - began < 20


@linux_only
@pytest.mark.slow
@pytest.mark.parametrize("container", ["npz deflated", "hdf5 gzip", "mat v5 deflated", "mat v7.3"])
@pytest.mark.parametrize("form", ["complex128", "int16 parts"])
def test_the_largest_data_that_is_read(tmp_path: Path, container: str, form: str) -> None:
    count = 2**20 if form == "int16 parts" else 2**19
    shape = (8, 8, count)
    text = PLAIN.replace('key = "tx"', "values = VALUES").replace('key = "rx"', "values = VALUES")
    text = text.replace("VALUES", str([[0.01 * i, 0.0, 0.0] for i in range(8)]))
    text = text.replace('key = "f"', f"start = 72e9\nstop = 82e9\npoints = {count}")
    if "parts" in form:
        text = text.replace('key = "data"', 'real = "re"\nimag = "im"')
        part = np.zeros(shape, form.split()[0])
        tree = {"re": part, "im": part}
    else:
        tree = {"data": np.zeros(shape, form)}
    if container == "hdf5 gzip":
        with h5py.File(tmp_path / "c", "w") as file:
            for key, value in tree.items():
                chunks = (1, 8, count)
                file.create_dataset(key, data=value, chunks=chunks, compression="gzip")
    else:
        write(container, tmp_path / "c", tree)
    del tree
    program = (
        "from measurement_io import open_capture\n"
        "capture = open_capture(sys.argv[1], layout=sys.argv[2])\n"
        "assert capture.data.size == int(sys.argv[3])\n"
    )
    assert peak_bytes(program, tmp_path / "c", layout(tmp_path, text), 64 * count) < MEMORY_BYTES
