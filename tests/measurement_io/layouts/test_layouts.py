"""Layouts: a capture written in strange ways comes back with the same bits, or one clear error."""

import io
import zipfile
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import Cli
from comparisons import refusal, same_bits, same_capture
from layout_files import CONTAINERS, layout, random_capture, write

import clradar
from clradar.errors import MeasurementError, ModelError
from measurement_io import check_file, describe, open_capture, read_layout
from measurement_io.layouts.lab_file import LabFile

EXAMPLES = Path(__file__).resolve().parents[3] / "examples" / "layouts"

DATA = '[data]\nkey = "data"\naxes = ["tx", "rx", "freq"]\n'
SIDES = '[tx]\nkey = "tx"\n[rx]\nkey = "rx"\n'
METRES = '[antennas]\nunit = "m"\n'
FREQUENCY = '[frequency]\nkey = "f"\nunit = "Hz"\n'
PLAIN = DATA + SIDES + METRES + FREQUENCY


def edited(*edits):
    """The plain layout with other words in place of some."""
    text = PLAIN
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return text


def tree_of(capture, **changes):
    sides = {"tx": capture.array.tx_m, "rx": capture.array.rx_m}
    return {"data": capture.data, **sides, "f": capture.waveform.frequencies_hz, **changes}


CAPTURE = random_capture()
SAMPLES, TX_M, RX_M = CAPTURE.data, CAPTURE.array.tx_m, CAPTURE.array.rx_m
F_GHZ = np.arange(72, 83, 2)


def open_with_layout(path, toml, **chosen):
    return open_capture(path, layout=toml, **chosen)


refused = partial(refusal, open_with_layout)


@pytest.mark.parametrize("container", CONTAINERS)
def test_every_container(tmp_path, container):
    path = write(container, tmp_path / "c.bin", tree_of(CAPTURE))
    read = open_capture(path, layout=layout(tmp_path, PLAIN))
    assert same_capture(read, CAPTURE)
    assert (read.meta["format"], read.meta["source"]) == ("layout", str(path))
    assert read.meta["layout"]["data"]["axes"] == ["tx", "rx", "freq"]
    with pytest.raises(MeasurementError, match=r"needs? a layout|a layout .*data"):
        open_capture(path)
    assert not check_file(path).ok
    assert describe(path).words["data"].endswith(("complex64", "imag', '<f4')]"))
    if "npz" in container:
        return
    inner = {**tree_of(CAPTURE), "note": "hällo", "t_c": 21.5, "run": np.int16([7])}
    path = write(container, tmp_path / "nested", {"lab": {"rec": inner}, "x": 1.0})
    text = PLAIN.replace('key = "', 'key = "lab/rec/')
    read = open_with_layout(path, layout(tmp_path, text))
    assert same_capture(read, CAPTURE)
    assert describe(path).words["lab/rec/note"] == "text"
    dotted = layout(tmp_path, text.replace("lab/rec/", "lab.rec."))
    if container.startswith("mat"):
        assert same_capture(open_with_layout(path, dotted), CAPTURE)
    else:
        assert "'lab.rec.data'" in refused(path, dotted)


# ---- what a layout describes


def compound(real, imag, kind):
    """Samples as pairs, the field that is first in the alphabet of "IQ" and "imag" first."""
    names = (imag, real) if real == "real" else (real, imag)
    data = np.empty(SAMPLES.shape, [(name, kind) for name in names])
    data[real], data[imag] = SAMPLES.real, SAMPLES.imag
    return data


PAIRED = ('["tx", "rx", "freq"]', '["freq", "pair"]\npair_order = "{}"')
COLUMNS = {
    **{f"tx_{axis}": TX_M[:, i : i + 1] for i, axis in enumerate("xyz")},
    **{f"rx_{axis}": RX_M[np.newaxis, :, i] for i, axis in enumerate("xyz")},
    "turned": TX_M.T,
    "yx": RX_M[:, [1, 0]],
}
APART = '[tx]\nx = "tx_x"\ny = "tx_y"\nz = "tx_z"\n'
FLAT = '[rx]\nx = "rx_x"\ny = "rx_y"\nz = 0.0125\n'
TURNED = '[tx]\nkey = "turned"\norientation = "columns"\n'
AT_12_MM = clradar.Capture(
    SAMPLES, clradar.AntennaArray(TX_M, RX_M * [1, 1, 0] + [0, 0, 0.0125]), CAPTURE.waveform
)
STEPS = {"first": 72e9, "step": np.array([2e9]), "n": np.int16(6), "f_ghz": F_GHZ}


def cases():
    """Layouts by name, what the file then holds, and the capture that it stands for."""
    for order, data in (("tx_major", SAMPLES), ("rx_major", SAMPLES.transpose(1, 0, 2))):
        pairs = np.array(data).reshape(-1, 6).T
        text = edited((PAIRED[0], PAIRED[1].format(order)))
        yield f"pairs {order}", (text, {"data": pairs}, CAPTURE)
    parts = {"data": 0.0, "re": SAMPLES.real, "im": SAMPLES.imag}
    yield "parts", (edited(('key = "data"', 'real = "re"\nimag = "im"')), parts, CAPTURE)
    for sides in (f"{APART}{FLAT}", f"{TURNED}{FLAT}"):
        yield f"positions {sides[:12]}", (DATA + sides + METRES + FREQUENCY, COLUMNS, AT_12_MM)
    text = DATA + f'{APART}[rx]\nkey = "yx"\nz = 0.0125\n{METRES}columns = ["y", "x"]\n' + FREQUENCY
    yield "positions by two columns", (text, COLUMNS, AT_12_MM)
    for form in (
        'key = "f_ghz"\nunit = "GHz"',
        "values = [72, 74, 76, 78, 80, 82]\nunit = 'GHz'",
        "start = 72\nstop = 82.0\npoints = 6\nunit = 'GHz'",
        "start = 72000\nstep = 2000\npoints = 6\nunit = 'MHz'",
        "start = 'first'\nstep = 'step'\npoints = 'n'\nunit = 'Hz'",
        "start = 'first'\nstop = 82e9\npoints = 'n'\nunit = 'Hz'",
    ):
        yield form, (DATA + SIDES + METRES + f"[frequency]\n{form}\n", STEPS, CAPTURE)
    falling = {"data": SAMPLES[..., ::-1], "f": F_GHZ[::-1] * 1e9}
    yield "descending", (PLAIN, falling, CAPTURE)
    text = "[frequency]\nstart = 82\nstop = 72\npoints = 6\nunit = 'GHz'\n"
    yield "descending by steps", (DATA + SIDES + METRES + text, falling, CAPTURE)
    text = f"{DATA}{SIDES}{METRES}[frequency]\nvalues = [72]\nunit = 'GHz'\n"
    one = clradar.Capture(SAMPLES[..., :1], CAPTURE.array, clradar.Waveform([72e9]))
    yield "one frequency", (text.replace(', "freq"]', "]"), {"data": SAMPLES[..., 0]}, one)


@pytest.mark.parametrize(("text", "changes", "want"), dict(cases()).values(), ids=dict(cases()))
def test_the_capture_is_what_the_layout_describes(tmp_path, text, changes, want):
    for container in ("npz", "hdf5 gzip", "mat v5", "mat v7.3"):
        path = write(container, tmp_path / container, tree_of(CAPTURE, **changes))
        read = open_with_layout(path, layout(tmp_path, text))
        assert same_capture(read, want), container
        reversed_ = "data" in changes and "f" in changes
        assert read.meta["frequencies_reversed"] is reversed_


@pytest.mark.parametrize("fields", ["r i <f4", "Real Imag >f8", "I Q >f4", "real imag <f8"])
def test_compound_types(tmp_path, fields):
    tree = tree_of(CAPTURE, data=compound(*fields.split()))
    for container in ("npz", "hdf5 gzip"):
        path = write(container, tmp_path / container, tree)
        assert same_capture(open_with_layout(path, layout(tmp_path, PLAIN)), CAPTURE)


@pytest.mark.parametrize(
    ("at", "container"), [(0, "npz"), (3, "hdf5 gzip"), (0, "mat v5"), (3, "mat v7.3")]
)
def test_frames_and_picked_axes(tmp_path, container, at):
    stack = np.stack([np.stack([k * SAMPLES, -k * SAMPLES]) for k in (1, 2, 3)])
    names = ["polarisation", "tx", "rx", "freq"]
    names.insert(at, "frame")
    tree = tree_of(CAPTURE, data=np.moveaxis(stack, 0, at))  # frame, polarisation, ...
    path = write(container, tmp_path / "c", tree)
    text = edited(('["tx", "rx", "freq"]', f"{names}\npick = {{ polarisation = 1 }}"))
    toml = layout(tmp_path, text)
    for i in range(3):
        read = open_capture(path, layout=toml, frame=i)
        assert same_bits(read.data, -(i + 1) * SAMPLES)
        assert (read.meta["frame"], read.meta["frames"]) == (i, 3)
    assert same_bits(open_capture(path, layout=toml).data, -SAMPLES)
    assert "frames 0 to 2" in refused(path, toml, frame=3)
    with pytest.raises(ModelError, match="whole number"):
        open_with_layout(path, toml, frame=-1)
    assert "index 5" in refused(path, layout(tmp_path, text.replace("= 1 }", "= 5 }")))


@pytest.mark.parametrize(
    ("select", "indices"),
    [
        ('"1:4"', [1, 2, 3]),
        ('":3"', [0, 1, 2]),
        ('"1:-1"', [1, 2, 3, 4]),
        ('"::2"', [0, 2, 4]),
        ('"::-1"', [5, 4, 3, 2, 1, 0]),
        ("[5, 0, 2]", [5, 0, 2]),
    ],
)
@pytest.mark.parametrize("pairs", [True, False])
def test_selected_channels(tmp_path, select, indices, pairs):
    capture = random_capture(n_tx=6, n_rx=6)
    tx, rx = capture.array.tx_m, capture.array.rx_m
    array = clradar.AntennaArray(tx[indices], rx[indices])
    chosen = clradar.Capture(capture.data[np.ix_(indices, indices)], array, capture.waveform)
    # As many positions as channels are those of the channels; so a mere order needs all of them.
    tree = tree_of(capture if pairs or len(indices) == 6 else chosen, data=capture.data)
    chosen_channels = f"channels = 6\nselect = {select}\n"
    text = edited(*((f'"{side}"\n', f'"{side}"\n{chosen_channels}') for side in ("tx", "rx")))
    if pairs:
        tree["data"] = capture.data.reshape(36, 6)
        text = text.replace('["tx", "rx", "freq"]', '["pair", "freq"]\npair_order = "tx_major"')
    path = write("hdf5", tmp_path / "c", tree)
    assert same_capture(open_with_layout(path, layout(tmp_path, text)), chosen)


def test_origin_and_mirror(tmp_path):
    shift = np.array([0.1, -0.2, 0.05])
    sides = {
        side: ([1, -1, -1] * at_m + shift) * 1e3 for side, at_m in (("tx", TX_M), ("rx", RX_M))
    }
    path = write("npz", tmp_path / "c", tree_of(CAPTURE, **sides))
    moved = 'unit = "mm"\norigin = [100, -200.0, 50]\nmirror = ["y", "z"]\nname = "A"'
    read = open_with_layout(path, layout(tmp_path, edited(('unit = "m"', moved))))
    assert read.array.name == "A"
    # Two roundings of numbers below 0.4 in double precision, here and in this test.
    tolerance_m = 4 * np.finfo(float).eps
    np.testing.assert_allclose(read.array.tx_m, TX_M, rtol=0, atol=tolerance_m)
    np.testing.assert_allclose(read.array.rx_m, RX_M, rtol=0, atol=tolerance_m)


# ---- what does not fit

LAST = np.arange(120).reshape(5, 4, 6) == 119
HERTZ = F_GHZ * 1e9
UNFIT = [
    ({"f": [72e9, 74e9, 73e9, 75e9, 76e9, 77e9]}, "74000000000, then 73000000000"),
    ({"f": [72.0, 74, 76, 78, 80, 82]}, "72 Hz, read in Hz"),
    ({"f": HERTZ[:-1]}, "6 in the data"),
    ({"f": HERTZ.reshape(2, 3)}, "to be a list"),
    ({"tx": TX_M[:-1]}, "4 positions and 5 channels"),
    ({"data": SAMPLES[:, :-1]}, "4 positions and 3 channels"),
    ({"data": SAMPLES.real}, "float32"),
    ({"data": np.where(LAST, np.nan, SAMPLES)}, "1 of 120"),
    ({"data": SAMPLES.astype(complex) * 1e300}, "120 of 120"),
    ({"data": SAMPLES[:0]}, "at least one element"),
    ({"data": np.array("text")}, "3 axes"),
    ({"tx": TX_M[0]}, "x, y, z in the columns"),
]
UNFIT_LAYOUTS = [
    (edited(("[tx]", "[tx]\nchannels = 7")), {}, "channels = 7"),
    (edited(("[tx]", '[tx]\nselect = "9:"')), {}, "keep a channel"),
    (edited(("[tx]", "[tx]\nselect = [0, 6]")), {}, "channel 6"),
    (
        edited((PAIRED[0], PAIRED[1].format("tx_major"))),
        {"data": SAMPLES.reshape(-1, 6).T[:, :-1]},
        "19 pairs",
    ),
    (
        edited(('key = "data"', 'real = "re"\nimag = "im"')),
        {"re": SAMPLES.real, "im": SAMPLES.imag[:-1]},
        "the imaginary part",
    ),
    (edited(('key = "tx"', 'key = "turned"')), COLUMNS, 'orientation = "columns" would fit'),
]


@pytest.mark.parametrize(
    ("text", "changes", "expected"), [*((PLAIN, *row) for row in UNFIT), *UNFIT_LAYOUTS]
)
def test_contents_that_do_not_fit(tmp_path, text, changes, expected):
    values = {key: np.array(value) for key, value in changes.items()}
    path = write("npz", tmp_path / "c", tree_of(CAPTURE, **values))
    assert expected in refused(path, layout(tmp_path, text))


EDITED = [
    ("axes", "axis", "data.axes: expected a list of axes"),
    ('"freq"]', '"frequency"]', '"freq"'),
    ('"freq"]', '"rx"]', "every axis once"),
    ('["tx", "rx", "freq"]', '["pair", "freq"]', "pair_order"),
    ('"freq"]', '"freq"]\nparts = ["real", "imag"]', "parts"),
    ('"freq"]', '"freq"]\nreal = "a"', "'real' and 'imag'"),
    ('key = "data"', "key = 3", "a key of the file"),
    ("[tx]", "phase_sign = true\n[tx]", "phase_sign"),
    ("[tx]", '[tx]\nselect = "1-3"', "slice"),
    ("[tx]", "[tx]\nselect = [-1]", "from 0"),
    ("[tx]", "[tx]\nchannels = 0", "channels"),
    ("[tx]", '[tx]\narray = "qar50"', "one of 'key'"),
    ('key = "tx"', 'key = "tx"\nz = 0', "columns"),
    ('unit = "m"', 'unit = "inch"', '"m", "cm", "mm", "um"'),
    ('unit = "m"\n', "", "unit of the positions"),
    ('unit = "Hz"', "", "one of Hz, kHz, MHz, GHz"),
    ('key = "f"', "start = 1\npoints = 3", "'stop' or 'step'"),
]
BAD_LAYOUTS = [
    ("", "data: expected a table"),
    (PLAIN + "typo = 1\n", ": frequency.typo: unknown key; expected one of key, values, start"),
    *((edited((old, new)), expected) for old, new, expected in EDITED),
]


@pytest.mark.parametrize(("text", "expected"), BAD_LAYOUTS, ids=range(len(BAD_LAYOUTS)))
def test_bad_layouts(tmp_path, text, expected):
    toml = layout(tmp_path, text)
    with pytest.raises(MeasurementError) as caught:
        read_layout(toml)
    message = str(caught.value)
    assert toml.name in message
    assert expected in message
    assert all(line.isprintable() for line in message.split("\n"))


# ---- damaged and hostile containers: one error, whatever they claim


def archive_of(path, *names):
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, file.getvalue())


def twice(path):
    with pytest.warns(UserWarning, match="Duplicate"):
        archive_of(path, "data.npy", "data.npy")


def encrypted(path):
    archive_of(path, "data.npy")
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(raw)


@contextmanager
def without_data(path):
    write("hdf5", path, tree_of(CAPTURE))
    with h5py.File(path, "r+") as file:
        del file["data"]
        yield file


def dataset(*arguments, **options):
    def make(path):
        with without_data(path) as file:
            file.create_dataset("data", *arguments, **options)

    return make


def nested(path):
    write("hdf5", path, tree_of(CAPTURE))
    with h5py.File(path, "r+") as file:
        file.create_group("/".join("abcdefghijklmnopqrstuvwxyz"))


HOSTILE = {
    "twice": (twice, "every key once"),
    "no arrays": (lambda path: archive_of(path, "data.txt", "data"), "no .npy array"),
    "encrypted": (encrypted, "encrypted"),
    "filter": (dataset(data=SAMPLES.real.astype("i4"), scaleoffset=4), "filter"),
    "chunks": (
        dataset((5, 4, 6), "c8", chunks=(2**9,) * 3, maxshape=(None,) * 3),
        "in chunks of at most",
    ),
    "references": (dataset((5, 4, 6), h5py.ref_dtype), "object"),
    "text": (dataset((5, 4, 6), [("r", "f4"), ("i", "S9")]), "hold numbers"),
    "nested": (nested, "nested"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_containers(tmp_path, name):
    make, expected = HOSTILE[name]
    make(tmp_path / "c")
    assert expected in refused(tmp_path / "c", layout(tmp_path, PLAIN))


def test_groups_that_hold_each_other(tmp_path):
    path = write("hdf5", tmp_path / "c", tree_of(CAPTURE))
    with h5py.File(path, "r+") as file:
        file["again"] = file["/"]
        inner = file.create_group("a/b/c")
        inner["back"] = file["a"]
    assert same_capture(open_with_layout(path, layout(tmp_path, PLAIN)), CAPTURE)


def test_matlab_classes_of_v73(tmp_path):
    path = write("mat v7.3", tmp_path / "c", tree_of(CAPTURE, word="hällo"))
    with h5py.File(path, "r+") as file:
        file["#refs#/a"] = [[1.0]]
        values = {
            "cell": np.array([[file["#refs#/a"].ref]], h5py.ref_dtype),
            "logical": np.uint8([[1]]),
            "double": np.uint64([0, 0]),
        }
        for name, value in values.items():
            file[name] = value
            file[name].attrs["MATLAB_class"] = np.bytes_(name)
        file["double"].attrs["MATLAB_empty"] = np.uint8(1)
        file["odd"] = [[1.0]]
        file["odd"].attrs["MATLAB_class"] = "text of variable length"
    assert same_capture(open_with_layout(path, layout(tmp_path, PLAIN)), CAPTURE)
    found = LabFile.opened(path, [(name, {}) for name in ("word", "odd", *values)])
    assert not any(name.startswith("#") for name in found.keys)
    for name, kind in (
        ("word", "text"),
        ("cell", "cell"),
        ("logical", "logical"),
        ("odd", "unknown form"),
        ("double", "hold numbers"),
    ):
        with pytest.raises(MeasurementError, match=kind):
            found.read(name, "a test")


# ---- the layouts that ship


def test_example_matlab_struct(tmp_path):
    rng = np.random.default_rng(0)
    full = rng.standard_normal((96, 96, 128, 2), dtype=np.float32).view(np.complex64)[..., 0]
    path = write("mat v7.3", tmp_path / "c", {"rec": {"S": full, "comment": "plate at 30 cm"}})
    read = open_capture(path, layout=EXAMPLES / "matlab_struct.toml")
    assert same_bits(read.data, np.ascontiguousarray(full[1:95, 1:95].transpose(1, 0, 2).conj()))
    assert read.array.name == "qar50"
    assert read.array.same_positions(clradar.arrays.qar50(), 0.0)
    assert read.waveform.same_frequencies(clradar.Waveform.sfcw(72e9, 82e9, 128), 0.0)


def test_example_pairs_and_frames(tmp_path):
    rng = np.random.default_rng(0)
    raw = rng.integers(-32768, 32767, (3, 4 * 5, 6, 2)).astype(np.int16)
    iq = np.empty(raw.shape[:-1], [("I", "<i2"), ("Q", "<i2")])
    iq["I"], iq["Q"] = raw[..., 0], raw[..., 1]
    tx, rx = rng.integers(-70, 70, (2, 5)) / 10, rng.integers(-70, 70, (2, 4)) / 10
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file.create_dataset("radar/iq", data=iq, chunks=(1, 20, 6), compression="gzip")
        file["radar/f0_mhz"], file["radar/step_mhz"] = 82_000.0, -2_000
        file["radar/points"], file["radar/temperature_c"] = 6, 23.5
        file["array/tx_xy"], file["array/rx_xy"], file["operator"] = tx, rx, "M. Muster"
    read = open_capture(tmp_path / "c.h5", layout=EXAMPLES / "pairs_and_frames.toml", frame=2)
    expected = (raw[2, ..., 0] + 1j * raw[2, ..., 1]).reshape(4, 5, 6).transpose(1, 0, 2)
    assert np.array_equal(read.data, expected[..., ::-1])
    assert np.array_equal(read.waveform.frequencies_hz, HERTZ)
    assert np.allclose(read.array.tx_m[:, 0], -tx[0] / 100, rtol=0, atol=1e-15)
    assert np.allclose(read.array.rx_m[:, 1], (rx[1] - 7.5) / 100, rtol=0, atol=1e-15)
    assert not read.array.tx_m[:, 2].any()
    assert read.meta["frequencies_reversed"]


# ---- the command line


def test_convert_with_a_layout(tmp_path, capsys):
    rows = "\n".join(",".join(map(repr, row)) for row in TX_M.tolist())
    (tmp_path / "Tx.dat").write_text("x,y,z\n" + rows)
    path = write("mat v7.3", tmp_path / "c.mat", tree_of(CAPTURE))
    toml = layout(tmp_path, edited(('[tx]\nkey = "tx"', '[tx]\nfile = "Tx.dat"')))
    cli, line = Cli(capsys), f"convert {path} --layout {toml} -o"
    assert "5 x 4 x 6" in cli.ok(f"{line} {tmp_path}/c.h5").out
    read = open_capture(tmp_path / "c.h5")
    assert same_capture(read, CAPTURE)
    assert read.meta["layout"]["tx"]["file"] == str(tmp_path / "Tx.dat")
    assert [i["file"] for i in read.meta["inputs"]] == ["c.mat", toml.name, "Tx.dat"]
    cli.fails(f"{line} {tmp_path}/d --to maroon", "--layout", status=2)
    cli.fails(f"{line} {tmp_path}/d --all-frames", "--layout", status=2)


def test_inspect_prints_a_template_to_fill_in(tmp_path, capsys):
    path = write("npz", tmp_path / "c", tree_of(CAPTURE) | {"a\nb": np.zeros(3)})
    text = Cli(capsys).ok(f"inspect {path}").out.split("\n\n", 1)[1]
    assert "#   data (5, 4, 6) complex64" in text
    with pytest.raises(MeasurementError, match=r"\?"):
        open_capture(path, layout=layout(tmp_path, text))
    for key, value in (
        ("[data]\nkey", "data"),
        ("[tx]  # and the same under [rx]\nkey", "tx"),
        ("[rx]\nkey", "rx"),
        ("z away from it\nunit", "m"),
        ("[frequency]\nkey", "f"),
        ("keys of them\nunit", "Hz"),
    ):
        assert f'{key} = "?"' in text
        text = text.replace(f'{key} = "?"', f'{key} = "{value}"')
    assert same_capture(open_capture(path, layout=layout(tmp_path, text)), CAPTURE)
