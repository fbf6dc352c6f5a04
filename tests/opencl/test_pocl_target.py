"""Old versions of PoCL on processors that they do not know, by writing "generic" over the name.

PoCL's own name is on the heap of the process that loads it, so that runs in processes of its own.
"""

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from clradar.opencl import pocl_target
from clradar.opencl.pocl_target import named_target

LINUX = sys.platform == "linux"
pytestmark = pytest.mark.skipif(not LINUX, reason="the wheel of an old PoCL is for Linux")

TRIPLE = b"x86_64-unknown-linux-gnu"

# Before clradar is imported: the name that PoCL knows the processor by becomes "generic". Prints an
# image's error, what it was made for, and the log.
RUN = """
import ctypes, json, logging, sys
import numpy as np
import pyopencl as cl

(device,) = [d for p in cl.get_platforms() if "Portable" in p.name for d in p.get_devices()]
name = device.version.rsplit("-linux-gnu-", 1)[1].encode() + b"\\0"
words = np.ctypeslib.as_array((ctypes.c_uint64 * 128).from_address(device.int_ptr))
maps = [line.split() for line in open("/proc/self/maps")]
heap = [[int(at, 16) for at in m[0].split("-")] for m in maps if m[1].startswith("rw")]
found = [
    int(w) for w in words
    if any(low <= w < high - 16 for low, high in heap)
    and ctypes.string_at(int(w), len(name)) == name
]
assert len(found) == 1, found
ctypes.memmove(found[0], b"generic\\0", 8)

said = []
handler = logging.Handler()
handler.emit = lambda record: said.append(record.getMessage())
logging.getLogger("clradar").addHandler(handler)
logging.getLogger("clradar").setLevel(logging.INFO)

import clradar, clradar.reference
from clradar.opencl.choice import fault

opened = clradar.open_device("pocl")
q = clradar.arrays.qar50()
array = clradar.AntennaArray(q.tx_m[::8], q.rx_m[::8])
noise = np.random.default_rng(1).normal(size=(array.n_tx, array.n_rx, 4, 2)) @ [1, 1j]
capture = clradar.Capture(noise, array, clradar.Waveform.sfcw(72e9, 82e9, 4))
grid = clradar.VoxelGrid.from_extent((-0.01, 0.01), (-0.01, 0.01), (0.3, 0.302), 2e-3)
image = clradar.backproject(capture, grid, method="exact", device=opened, check_grid=False)
z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
at_m = np.stack([x, y, z], axis=-1).reshape(-1, 3)
wanted = clradar.reference.backproject(capture, at_m)
print(json.dumps({
    "target": opened.info.target, "fault": fault(opened.info.selector), "said": said,
    "error": float(abs(image.data.ravel() - wanted).max() / abs(wanted).max()),
}))
"""


def test_a_processor_that_pocl_does_not_know_gets_a_name_and_works():
    done = subprocess.run(
        [sys.executable, "-W", "ignore::UserWarning", "-c", RUN],
        capture_output=True, text=True, env={**os.environ, "CLRADAR_DEVICE": "pocl"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    unknown = SimpleNamespace(**json.loads(done.stdout))
    assert unknown.fault is None
    flags = Path("/proc/cpuinfo").read_text()
    by_features = "skylake-avx512" if "avx512vl" in flags else "haswell"
    assert unknown.target in (by_features, "x86-64")
    assert len(unknown.said) == 1
    assert f"it compiles for {unknown.target}" in unknown.said[0]
    # Phases are exact to 2^-22 cycles, 1.5e-6 of a term each; the peak of 576 random terms is some
    # 70 of them: at worst 1.2e-5 of it.
    assert unknown.error < 2e-5


# A structure like PoCL's -------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def nothing_named_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Structures of other tests may have been at the same address."""
    monkeypatch.setattr(pocl_target, "_named", {})


class Structure:
    """128 words, two of which point to the triple and to a name on the heap."""

    def __init__(self, name: bytes, triple: bytes = TRIPLE, names: int = 1) -> None:
        self._libc = ctypes.CDLL(None)
        self._libc.strdup.restype = ctypes.c_void_p
        self._words = (ctypes.c_uint64 * 128)()
        self._triple = ctypes.create_string_buffer(triple)
        self.names = [self._libc.strdup(name) for _ in range(names)]
        for i, address in enumerate(self.names):
            self._words[40 + 8 * i] = ctypes.addressof(self._triple)
            self._words[41 + 8 * i] = address
        self._words[100] = 8  # nothing is mapped there
        self.platform = SimpleNamespace(
            name="Portable Computing Language",
            version="OpenCL 3.0 PoCL 3.0-rc2  Linux, LLVM 14.0.6",
        )
        self.name = "pthread-New CPU"
        self.int_ptr = ctypes.addressof(self._words)

    @property
    def written(self) -> bytes:
        return ctypes.string_at(self.names[0])


FEATURES = {
    "skylake-avx512": "avx avx2 cx16 popcnt abm f16c fma bmi1 bmi2 "
    "avx512f avx512bw avx512cd avx512dq avx512vl",
    "haswell": "avx avx2 cx16 popcnt abm f16c fma bmi1 bmi2 avx512f",  # Knights Landing
    "x86-64": "sse2 avx",
}


def pretend_features(folder: Path, monkeypatch: pytest.MonkeyPatch, flags: str) -> None:
    file = folder / "cpuinfo"
    file.write_text(f"processor\t: 0\nflags\t\t: fpu {flags} sse\nbugs\t\t:\n")
    monkeypatch.setattr(pocl_target, "PROCESSORS", file)


@pytest.mark.parametrize("target", FEATURES)
def test_the_name_is_chosen_by_features(target, tmp_path, monkeypatch):
    pretend_features(tmp_path, monkeypatch, FEATURES[target])
    device = Structure(b"generic")
    assert named_target(device) == target
    assert device.written == target.encode()
    assert named_target(device) == target  # what was written is known


def test_a_name_that_has_no_room_is_not_written(tmp_path, monkeypatch):
    pretend_features(tmp_path, monkeypatch, FEATURES["skylake-avx512"])
    assert pocl_target._room(Structure(b"generic").names[0]) >= len(b"skylake-avx512\0")
    # Both at once: the second one is not to lie where the first one was, which has a name by then.
    narrow, device = Structure(b"generic"), Structure(b"generic")
    monkeypatch.setattr(pocl_target, "_room", lambda address: 14)
    assert named_target(narrow) == "haswell"
    monkeypatch.setattr(pocl_target, "_room", lambda address: 6)
    assert named_target(device) is None
    assert device.written == b"generic"


@pytest.mark.parametrize(
    ("structure", "version"),
    [
        ({"name": b"znver3"}, "3.0-rc2"),
        ({"name": b"generic2"}, "3.0-rc2"),
        ({"name": b"generic", "triple": b"aarch64-linux-gnu"}, "3.0-rc2"),
        ({"name": b"generic", "names": 2}, "3.0-rc2"),
        ({"name": b"generic"}, "5.0"),
        ({"name": b"generic"}, "7.1"),
    ],
)
def test_nothing_else_is_written_over(structure, version):
    device = Structure(**structure)
    device.platform.version = f"OpenCL 3.0 PoCL {version}  Linux"
    assert named_target(device) is None
    assert device.written == structure["name"]
