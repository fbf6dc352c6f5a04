"""Files that hypothesis makes up: right in form, and with anything in the place of anything."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import maroon_files
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fuzz.mutate_pickle import DICTIONARY
from fuzz.oracle import judge
from fuzz.targets import TARGETS

SETTINGS = settings(
    max_examples=100,
    deadline=None,  # a hang is caught by the test's own time limit
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> dict[str, Path]:
    """Where each target wants its input, in a folder of its own."""
    return {name: t.place(tmp_path_factory.mktemp(name)) for name, t in TARGETS.items()}


def read(places: dict[str, Path], name: str, content: bytes) -> None:
    places[name].write_bytes(content)
    outcome, fault = judge(TARGETS[name], places[name])
    assert outcome != "fault", fault


# ---- recorded frames

_DTYPES = st.sampled_from(["c8", "c16", "<f8", ">f4", "i8", "u1", "b1", "S3", "U2", "f2"])
_SHAPES = st.lists(st.sampled_from([0, 1, 2, 3, 94, 96]), max_size=4).map(tuple)


@st.composite
def _arrays(draw: st.DrawFn) -> np.ndarray:
    shape = draw(_SHAPES)
    if np.prod(shape, dtype=float) > 96 * 96 * 3:
        shape = shape[:2]
    array = np.full(shape, draw(st.sampled_from([0, 1, 72])), draw(_DTYPES))
    return draw(st.sampled_from([np.ascontiguousarray, np.asfortranarray]))(array)


_LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats()
    | st.complex_numbers()
    | st.text(max_size=20)
    | st.binary(max_size=20)
    | _arrays()
    | st.sampled_from([np.float32(1), np.int64(-1), np.complex64(1j), np.str_("a"), np.bool_(1)])
)
_VALUES = st.recursive(
    _LEAVES,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.lists(inner, max_size=4).map(tuple)
        | st.dictionaries(st.text(max_size=3) | st.integers(), inner, max_size=4)
    ),
    max_leaves=8,
)
_KEYS = st.sampled_from(["xr", "fvec", "timestamp_us", "number_of_measurements", "source", "x"])


@SETTINGS
@given(
    changes=st.dictionaries(_KEYS, _VALUES, max_size=3),
    missing=st.sets(_KEYS, max_size=1),
    protocol=st.sampled_from(maroon_files.PROTOCOLS),
)
def test_frames_with_any_values(places, changes, missing, protocol):
    frame = maroon_files.random_frame(1, channels=94) | changes
    for key in missing:
        frame.pop(key, None)
    read(places, "frame", maroon_files.npy(maroon_files.pickled(frame, protocol)))


@SETTINGS
@given(
    operations=st.lists(st.sampled_from(DICTIONARY) | st.binary(max_size=6), max_size=40),
    head=st.sampled_from([b"\x80\x04", b"\x80\x02", b""]),
    tail=st.sampled_from([b".", b""]),
)
def test_pickles_of_any_operations(places, operations, head, tail):
    read(places, "frame", maroon_files.npy(head + b"".join(operations) + tail))


@SETTINGS
@given(
    header=st.fixed_dictionaries(
        {},
        optional={
            "descr": st.sampled_from(["|O", "O", "<f8", "", "V0"]) | _VALUES,
            "fortran_order": st.booleans() | st.none(),
            "shape": _SHAPES | st.lists(st.integers(), max_size=3),
        },
    ),
    version=st.sampled_from([(1, 0), (2, 0), (3, 0), (0, 0)]),
)
def test_headers_of_any_kind(places, header, version):
    raw = repr(header).encode("utf-8", "backslashreplace")
    size = struct.pack("<H" if version[0] == 1 else "<I", len(raw) & 0xFFFF)
    content = b"\x93NUMPY" + bytes(version) + size + raw
    read(places, "frame", content + maroon_files.pickled({}))


# ---- JSON and text

_JSON: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner),
    max_leaves=12,
)
_ENTRIES = st.sampled_from(
    ["frequency_low_ghz", "frequency_high_ghz", "frequency_points", "000000", "000001", "0"]
)


@SETTINGS
@given(tree=st.dictionaries(_ENTRIES, _JSON) | _JSON)
def test_calibration_of_any_values(places, tree):
    read(places, "calibration_json", json.dumps(tree).encode())


@SETTINGS
@given(
    rows=st.lists(st.lists(st.floats().map(str) | st.text(max_size=5), max_size=4), max_size=100),
    header=st.sampled_from(["x,y,z", "x,y", "", "x,y,z\n"]),
)
def test_antennas_of_any_rows(places, rows, header):
    lines = [header, *(",".join(row) for row in rows)]
    read(places, "antennas", "\n".join(lines).encode("utf-8", "surrogatepass"))
