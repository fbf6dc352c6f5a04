"""The records: refused values, messages and immutability."""

import pickle
import re
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest

import clradar
from clradar import AntennaArray, Capture, DepthMap, Paths, Scene, Volume, VoxelGrid, Waveform
from clradar.errors import ModelError
from clradar.model import checks
from clradar.model.range_profile import coupling_path_m
from clradar.model.resolution import lateral_resolution_m

# Positions of some 0.1 m, each made of two or three float64 operations: a few units in the last
# place of 1.4e-17 m.
ROUNDING_M = 1e-16
# Grids are 0.2 m wide and hold their step, so the far end is off by the rounding of one product.
GRID_ROUNDING_M = 1e-15

TRIANGLE = np.array([[0.0, 0.0, 0.3], [0.1, 0.0, 0.3], [0.0, 0.1, 0.3]])
NAN, INF = float("nan"), float("inf")


def make_array(**fields: Any) -> AntennaArray:
    return AntennaArray(**{"tx_m": np.zeros((2, 3)), "rx_m": np.ones((3, 3)), **fields})


def make_waveform(frequencies_hz: Any = (1e9, 2e9, 4e9, 5e9)) -> Waveform:
    return Waveform(frequencies_hz)


def make_capture(**fields: Any) -> Capture:
    values = {"data": np.ones((2, 3, 4)), "array": make_array(), "waveform": make_waveform()}
    return Capture(**{**values, **fields})


def make_grid(**fields: Any) -> VoxelGrid:
    values = {"origin_m": np.zeros(3), "spacing_m": np.full(3, 1e-3), "counts": (4, 3, 2)}
    return VoxelGrid(**{**values, **fields})


def make_volume(**fields: Any) -> Volume:
    return Volume(**{"data": np.ones((2, 3, 4)), "grid": make_grid(), **fields})


def make_depth_map(**fields: Any) -> DepthMap:
    values = {
        "depth_m": np.full((3, 4), 0.3),
        "amplitude": np.ones((3, 4)),
        "x_m": np.arange(4.0),
        "y_m": np.arange(3.0),
    }
    return DepthMap(**{**values, **fields})


def make_paths(**fields: Any) -> Paths:
    values = {
        "tx": [0, 1],
        "rx": [2, 0],
        "length_m": [0.6, 0.7],
        "amplitude": [1.0, 0.5],
        "bounces": [1, 2],
        "n_tx": 2,
        "n_rx": 3,
    }
    return Paths(**{**values, **fields})


def make_scene(**fields: Any) -> Scene:
    return Scene(**{"vertices_m": TRIANGLE, "faces": [[0, 1, 2]], **fields})


MAKERS: list[Callable[..., Any]] = [
    make_array, make_capture, make_grid, make_volume, make_depth_map, make_paths, make_scene,
    make_waveform,
]  # fmt: skip

# What every field that holds real numbers refuses, whatever its shape.
NO_REAL_NUMBERS = [
    (np.array([object()]), "numbers", "dtype object"),
    (None, "numbers", "dtype object"),
    ("72e9", "numbers", "dtype <U"),
    (np.array([1 + 0j, 2 + 0j]), "real numbers", "dtype complex128"),
    (np.array(["2020-01-01"], dtype="M8[D]"), "numbers", "dtype datetime64"),
    ([[1.0, 2.0], [3.0]], "shape", "ragged"),
]


def refuse(make: Callable[[], Any], field: str, expected: str, got: str) -> None:
    """`make` fails with the `ModelError` "<field>: expected <expected>, got <got>"."""
    with pytest.raises(ModelError) as caught:
        make()
    message = str(caught.value)
    assert message.startswith(field), message
    pattern = f": expected .*{re.escape(expected)}.*, got .*{re.escape(got)}"
    assert re.search(pattern, message, re.DOTALL), message


@pytest.mark.parametrize(("value", "expected", "got"), NO_REAL_NUMBERS)
def test_fields_of_real_numbers_refuse_other_things(value, expected, got):
    refuse(lambda: make_array(tx_m=value), "AntennaArray.tx_m", expected, got)


@pytest.mark.parametrize("make", MAKERS)
def test_every_array_is_checked_and_named(make):
    record = make()
    for name in arrays_of(record):
        field = "alpha" if name == "alpha" else f"{type(record).__name__}.{name}"
        refuse(lambda name=name: make(**{name: [object()]}), field, "numbers", "dtype object")


WRONG = [
    # field, expected, got, maker, arguments
    ("AntennaArray.rx_m", "at least one element", "empty", make_array, {"rx_m": np.zeros((0, 3))}),
    ("AntennaArray.tx_m", "finite", "3 of 3 that are NaN", make_array, {"tx_m": [[INF] * 3]}),
    ("AntennaArray.name", "a string", "7", make_array, {"name": 7}),
    ("AntennaArray.tx_pattern", "an AntennaPattern", "float", make_array, {"tx_pattern": 1.0}),
    ("Waveform.frequencies_hz", "shape (N,)", "shape ()", make_waveform, {"frequencies_hz": 1e9}),
    ("Waveform.frequencies_hz", "strictly ascending", "descending values 3000000000, 2000000000",
     make_waveform, {"frequencies_hz": [1e9, 3e9, 2e9]}),
    ("Waveform.frequencies_hz", "strictly ascending", "repeated values 2000000000, 2000000000",
     make_waveform, {"frequencies_hz": [1e9, 2e9, 2e9]}),
    ("Waveform.frequencies_hz", "positive", "0 Hz", make_waveform, {"frequencies_hz": [0.0, 1e9]}),
    ("Waveform.sfcw", "stop_hz above start_hz", "in 1 steps", Waveform.sfcw,
     {"start_hz": 1e9, "stop_hz": 2e9, "steps": 1}),
    ("Waveform.sfcw", "or equal, for one step", "in 4 steps", Waveform.sfcw,
     {"start_hz": 1e9, "stop_hz": 1e9, "steps": 4}),
    ("Waveform.sfcw: steps", "a whole number in [1, 10000000]", "1" + 20 * "0", Waveform.sfcw,
     {"start_hz": 1e9, "stop_hz": 2e9, "steps": 10**20}),
    ("Waveform.sfcw: stop_hz", "finite", "inf", Waveform.sfcw,
     {"start_hz": 1e9, "stop_hz": INF, "steps": 2}),
    ("Capture.data", "shape (2, 3, 4)", "shape (2, 3)", make_capture, {"data": np.ones((2, 3))}),
    ("Capture.data", "finite", "24 of 24 that are NaN", make_capture,
     {"data": np.full((2, 3, 4), complex(0, NAN))}),
    ("Capture.data", "within the range of complex64", "an overflow", make_capture,
     {"data": np.full((2, 3, 4), 1e39)}),
    ("Capture.waveform", "a Waveform", "list", make_capture, {"waveform": [1e9]}),
    ("Capture.meta", "a mapping", "list", make_capture, {"meta": [1]}),
    ("Capture.meta", "string keys", "3", make_capture, {"meta": {3: 4}}),
    ("VoxelGrid.spacing_m", "positive", "-0.001", make_grid, {"spacing_m": [1e-3, -1e-3, 1e-3]}),
    ("VoxelGrid.counts", "three counts", "(4, 3)", make_grid, {"counts": (4, 3)}),
    ("VoxelGrid.counts", "three counts", "'432'", make_grid, {"counts": "432"}),
    ("VoxelGrid.counts", "a whole number >= 1", "2.5", make_grid, {"counts": (4, 2.5, 2)}),
    ("VoxelGrid.counts", "at most 2147483647", "2000 x 2000", make_grid, {"counts": [2000] * 3}),
    ("Volume.data", "shape (2, 3, 4)", "(4, 3, 2)", make_volume, {"data": np.ones((4, 3, 2))}),
    ("DepthMap.depth_m", "finite depths or NaN", "infinite", make_depth_map,
     {"depth_m": np.full((3, 4), INF)}),
    ("DepthMap.amplitude", ">= 0", "-1", make_depth_map, {"amplitude": np.full((3, 4), -1.0)}),
    ("DepthMap.dynamic_range_db", "positive", "0", make_depth_map, {"dynamic_range_db": 0}),
    ("Paths.rx", "[0, 3)", "[-1, 0]", make_paths, {"rx": [-1, 0]}),
    ("Paths.tx", "values in [-2147483648, 2147483647]", "4294967296", make_paths,
     {"tx": [0, 2**32]}),
    ("Paths.length_m", "positive", "0", make_paths, {"length_m": [0.6, 0.0]}),
    ("Paths.bounces", "at least one", "0", make_paths, {"bounces": [0, 1]}),
    ("Scene.faces", "indices in [0, 3)", "[-1, 1]", make_scene, {"faces": [[0, 1, -1]]}),
    ("alpha", "values in [0, 1]", "1.1", make_scene, {"alpha": 1.1}),
    ("alpha", "a number", "True", make_scene, {"alpha": True}),
    ("alpha", "shape (1,)", "shape (2,)", make_scene, {"alpha": [0.1, 0.2]}),
    ("Scene.part", "indices in [0, 1)", "[1, 1]", make_scene, {"part": 1}),
    ("Scene.part", "a whole number >= 0", "'mesh'", make_scene, {"part": "mesh"}),
    ("Scene.part_names", "unique names", "('a', 'a')", make_scene, {"part_names": ("a", "a")}),
    ("Scene.part_names", "a tuple of strings", "'hand'", make_scene, {"part_names": "hand"}),
    ("Scene.normals", "unit length, or 0", "1.1", make_scene, {"normals": [[0, 0, 1.1]] * 3}),
    ("Scene.materials", "a tuple of materials", "()", make_scene, {"materials": ()}),
    ("Scene.materials", "a Material", "str", make_scene, {"materials": ("palm",)}),
    ("Scene.texture_m", "shape (3, 3)", "(2, 3)", make_scene, {"texture_m": np.zeros((2, 3))}),
]  # fmt: skip


@pytest.mark.parametrize(("field", "expected", "got", "make", "arguments"), WRONG)
def test_invalid_fields_are_refused(field, expected, got, make, arguments):
    refuse(lambda: make(**arguments), field, expected, got)


def arrays_of(record: Any) -> dict[str, np.ndarray]:
    values = {f.name: getattr(record, f.name) for f in fields(record)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("make", MAKERS)
def test_records_are_frozen_and_their_arrays_read_only(make):
    record = make()
    arrays = arrays_of(record)
    assert arrays
    for name, array in arrays.items():
        assert array.flags.c_contiguous, name
        assert not array.flags.writeable, name
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        with pytest.raises(FrozenInstanceError):
            setattr(record, name, array)
    # Slots: a misspelt field is an error (a TypeError on Python 3.10 and 3.11).
    with pytest.raises((AttributeError, TypeError)):
        record.no_such_field = 1


@pytest.mark.parametrize("make", MAKERS)
def test_the_callers_later_changes_do_not_reach_the_record(make):
    for name, value in arrays_of(make()).items():
        mine = np.array(value)
        frozen_view = mine.view()
        frozen_view.flags.writeable = False
        records = [make(**{name: given}) for given in (mine, frozen_view)]
        mine[...] = 0
        for record in records:
            np.testing.assert_array_equal(getattr(record, name), value, err_msg=name)


@pytest.mark.parametrize("make", [make_capture, make_volume])
def test_meta_is_a_copy_and_cannot_be_written(make):
    meta = {"seed": 1, "nested": {"deep": [1, {"deeper": 2}]}}
    record = make(meta=meta)
    meta["seed"] = 2
    meta["nested"]["deep"][1]["deeper"] = 3
    meta["nested"]["deep"].append(4)
    assert dict(record.meta) == {"seed": 1, "nested": {"deep": [1, {"deeper": 2}]}}
    with pytest.raises(TypeError):
        record.meta["seed"] = 3
    meta["nested"]["self"] = meta
    refuse(lambda: make(meta=meta), f"{type(record).__name__}.meta", "limited depth", "itself")


def test_records_take_what_numpy_takes():
    assert make_array(tx_m=[(0, 0, 0)]).tx_m.dtype == np.float64
    assert make_paths(tx=np.array([0.0, 1.0])).tx.dtype == np.int32
    fortran = np.asfortranarray(np.arange(24).reshape(2, 3, 4))
    np.testing.assert_array_equal(make_capture(data=fortran).data, fortran)
    assert make_grid(counts=np.array([4, 3, 2])).counts == (4, 3, 2)
    for alpha in (1, np.float32(1), np.array(1.0)):
        assert make_scene(alpha=alpha).alpha.tolist() == [1.0]


def test_pair_counts_rx_fastest_beyond_32_bits():
    assert Paths([], [], [], [], [], 2, 3).pair.shape == (0,)
    paths = make_paths(tx=[0, 2**20], rx=[2, 7], n_tx=2**21, n_rx=2**13)
    assert paths.pair.tolist() == [2, 2**33 + 7]


def test_qar50_has_the_published_positions():
    array = clradar.arrays.qar50()
    assert (array.name, array.n_tx, array.n_rx) == ("qar50", 94, 94)
    steps = [-0.069 + 0.003 * i for i in range(47)]
    rx = [(x, y, 0.0) for y in (-0.0705, 0.0705) for x in steps]
    tx = []
    for sign in (-1, 1):
        for i, y in enumerate(steps):
            tx.append((sign * (0.072 if i in (0, 46) else 0.0705), y, 0.0))
    np.testing.assert_allclose(array.rx_m, rx, rtol=0, atol=ROUNDING_M)
    np.testing.assert_allclose(array.tx_m, tx, rtol=0, atol=ROUNDING_M)


def test_same_antennas():
    array = clradar.arrays.qar50()
    ones = np.ones(94)
    assert array.same_antennas(replace(array, tx_gain=ones, rx_boresight=[[0, 0, 2.0]] * 94))
    for change in (
        {"rx_gain": np.where(np.arange(94) == 7, 1.1, ones)},
        {"tx_boresight": [[0, 0.1, 1.0]] * 94},
        {"tx_pattern": clradar.AntennaPattern(exponent=1.0)},
        {"tx_m": array.tx_m + 1e-3},
    ):
        assert not array.same_antennas(replace(array, **change))
        assert not replace(array, **change).same_antennas(array)


def test_sfcw_includes_both_ends():
    waveform = Waveform.sfcw(72e9, 82e9, 128)
    f = waveform.frequencies_hz
    assert (f[0], f[-1], waveform.n_freq) == (72e9, 82e9, 128)
    # Frequencies are near 2^36 Hz, where float64 has steps of 2^-16 Hz.
    np.testing.assert_allclose(np.diff(f), 10e9 / 127, rtol=0, atol=2**-15)
    assert (waveform.center_hz, waveform.span_hz) == (77e9, 10e9)
    assert Waveform.sfcw(72e9, 72e9, 1).frequencies_hz.tolist() == [72e9]
    assert Waveform.sfcw(72e9, 82e9, 2).frequencies_hz.tolist() == [72e9, 82e9]


def test_ranges_repeat_after_half_a_cycle_of_the_step():
    waveform = Waveform([70e9, 71e9, 72e9, 74e9])
    metre_hz = clradar.constants.SPEED_OF_LIGHT_M_PER_S / 2
    assert waveform.unambiguous_range_m == pytest.approx(metre_hz / 1e9)  # of the median step
    assert waveform.range_resolution_m == pytest.approx(metre_hz / 4e9)


def test_lateral_resolution_is_the_wavelength_over_the_sines_that_both_apertures_span():
    """Of clusters those that all of them span together."""
    middle_m = np.array([[-0.05, 0, 0], [0.07, 0, 0]])
    sine = 0.07 / np.hypot(0.07, 0.1) + 0.05 / np.hypot(0.05, 0.1)
    one = Capture(np.ones((2, 2, 1)), AntennaArray(middle_m, middle_m), Waveform([60e9]))
    wavelength_m = clradar.constants.SPEED_OF_LIGHT_M_PER_S / 60e9
    assert lateral_resolution_m(one, 0, 0.1) == pytest.approx(wavelength_m / (2 * sine))
    assert lateral_resolution_m(one, 1, 0.1) == np.inf
    halves = [
        replace(one, array=AntennaArray(at, at), data=[[[1]]]) for at in np.split(middle_m, 2)
    ]
    assert lateral_resolution_m(halves, 0, 0.1) == pytest.approx(wavelength_m / (2 * sine))


def test_coupling_reaches_two_cells_beyond_the_farthest_pair():
    array = AntennaArray([[0, 0, 0], [0.03, 0, 0]], [[0, 0.04, 0]])
    capture = Capture(np.ones((2, 1, 3)), array, Waveform([70e9, 71e9, 74e9]))
    cell_m = clradar.constants.SPEED_OF_LIGHT_M_PER_S / 4e9
    assert coupling_path_m(capture) == pytest.approx(0.05 + 2 * cell_m)


def test_grid_from_extent_has_both_ends():
    grid = VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
    assert grid.counts == (201, 201, 81)
    assert not grid.same_voxels(make_grid())
    assert grid.shape == (81, 201, 201)
    for axis, (first, last) in zip(
        (grid.x_m, grid.y_m, grid.z_m), ((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34)), strict=True
    ):
        assert axis[0] == first
        assert abs(axis[-1] - last) < GRID_ROUNDING_M
        np.testing.assert_allclose(np.diff(axis), 1e-3, rtol=0, atol=GRID_ROUNDING_M)


@pytest.mark.parametrize(
    ("name", "value", "expected", "got"),
    [
        ("x_m", (0.1, 0.0), "first <= last", "(0.1, 0)"),
        ("y_m", (0.0, 0.1, 0.2), "shape (2,)", "shape (3,)"),
        ("x_m", (0.0, 0.105), "(such as (0, 0.1))", "(0, 0.105)"),
        ("spacing_m", (0.01, -0.01, 0.01), "a positive number", "-0.01"),
        ("spacing_m", (0.01, 0.01), "one number or three", "(0.01, 0.01)"),
    ],
)
def test_grid_from_extent_refuses(name, value, expected, got):
    given = {"x_m": (0, 0.1), "y_m": (0, 0.1), "z_m": (0.2, 0.3), "spacing_m": 0.01, name: value}
    refuse(lambda: VoxelGrid.from_extent(**given), f"VoxelGrid.from_extent: {name}", expected, got)


@pytest.mark.parametrize("value", [10**400, "5", b"5", True, np.True_, [5.0], None, 5j, object()])
def test_other_types_are_not_numbers(value):
    with pytest.raises(ModelError, match=r"^field: expected a (real )?number, got "):
        checks.real("field", value)
    with pytest.raises(ModelError, match=r"^field: expected a whole number in \[1, 9\], got "):
        checks.whole("field", value, 1, 9)


def test_response_is_the_gain_times_the_phase_of_the_delay():
    gain = np.array([2.0 + 1.0j, 0.0])
    response = clradar.ChannelResponse(gain, [1.0], [20e-12, 0.0], [0.0], 77e9)
    found = response.tx_response(np.array([77e9, 77e9 + 12.5e9]))
    # A quarter turn back after 1 / (4 * 20 ps) = 12.5 GHz.
    np.testing.assert_allclose(found, [[2 + 1j, (2 + 1j) * -1j], [0, 0]], atol=1e-12)
    np.testing.assert_array_equal(response.rx_response(np.array([72e9, 82e9])), [[1, 1]])


def test_records_survive_pickling_and_print_on_one_short_line():
    array = clradar.arrays.qar50()
    meta = {"a": list(range(1000)), "b": {}}
    capture = Capture(np.ones((94, 94, 2)), array, Waveform([72e9, 82e9]), meta)
    again = pickle.loads(pickle.dumps(capture))
    np.testing.assert_array_equal(again.data, capture.data)
    np.testing.assert_array_equal(again.array.tx_m, array.tx_m)
    assert again.meta == meta
    assert not again.data.flags.writeable
    text = repr(again)
    assert len(text) < 300
    for part in ("data=<complex64 (94, 94, 2)>", "name='qar50'", "meta=<2 entries>"):
        assert part in text
    grid = VoxelGrid([0, 0, 0.3], [1e-3] * 3, (2, 3, 4))
    volume = pickle.loads(pickle.dumps(Volume(np.ones(grid.shape), grid, {"m": 1})))
    np.testing.assert_array_equal(volume.data, 1)
    assert volume.grid.same_voxels(grid)
    assert volume.depth_map().depth_m.shape == (3, 2)
