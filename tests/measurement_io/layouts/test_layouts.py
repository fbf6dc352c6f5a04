"""Layouts: a capture written in strange ways comes back with the same bits, or one clear error."""

from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from comparisons import refusal, same_bits, same_capture
from layout_files import CONTAINERS, layout, random_capture, write

import clradar
from clradar.cli import main
from clradar.errors import MeasurementError, ModelError
from measurement_io import (
    check_file,
    describe,
    open_capture,
    open_with_layout,
    read_layout,
)

EXAMPLES = Path(__file__).resolve().parents[3] / "examples" / "layouts"

DATA = '[data]\nkey = "data"\naxes = ["tx", "rx", "freq"]\n'
SIDES = '[tx]\nkey = "tx"\n[rx]\nkey = "rx"\n'
METRES = '[antennas]\nunit = "m"\n'
FREQUENCY = '[frequency]\nkey = "f"\nunit = "Hz"\n'
PLAIN = DATA + SIDES + METRES + FREQUENCY


def tree_of(capture: clradar.Capture, **changes: Any) -> dict[str, Any]:
    return {
        "data": capture.data,
        "tx": capture.array.tx_m,
        "rx": capture.array.rx_m,
        "f": capture.waveform.frequencies_hz,
        **changes,
    }


def assert_same(read: clradar.Capture, capture: clradar.Capture) -> None:
    assert same_capture(read, capture)


refused = partial(refusal, open_with_layout)


# ---- every container


@pytest.mark.parametrize("container", CONTAINERS)
def test_every_container(tmp_path, container):
    capture = random_capture()
    path = write(container, tmp_path / "c.bin", tree_of(capture))
    read = open_capture(path, layout=layout(tmp_path, PLAIN))
    assert_same(read, capture)
    assert read.meta["format"] == "layout"
    assert read.meta["source"] == str(path)
    assert read.meta["layout"]["data"]["axes"] == ["tx", "rx", "freq"]
    with pytest.raises(MeasurementError, match=r"needs? a layout|a layout .*data"):
        open_capture(path)
    assert not check_file(path).ok
    assert describe(path).words["data"].endswith(("complex64", "imag', '<f4')]"))


@pytest.mark.parametrize("container", [c for c in CONTAINERS if "npz" not in c])
def test_nested_keys_text_and_single_numbers(tmp_path, container):
    capture = random_capture()
    inner = {**tree_of(capture), "note": "hällo", "t_c": 21.5, "run": np.int16([7])}
    path = write(container, tmp_path / "c", {"lab": {"rec": inner}, "x": 1.0})
    text = PLAIN.replace('key = "', 'key = "lab/rec/') + (
        '[meta]\nkeys = ["lab/rec/note", "lab/rec/t_c", "lab/rec/run"]\n'
    )
    read = open_with_layout(path, layout(tmp_path, text))
    assert_same(read, capture)
    assert list(read.meta["file"].values()) == ["hällo", 21.5, 7]
    dotted = layout(tmp_path, text.replace("lab/rec/", "lab.rec."))
    if container.startswith("mat"):
        assert_same(open_with_layout(path, dotted), capture)
    else:
        assert "'lab.rec.data'" in refused(path, dotted)


# ---- axes


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("at", [0, 1, 3])
def test_frames_and_picked_axes(tmp_path, container, at):
    frames = [random_capture(seed=i) for i in range(3)]
    first = frames[0]
    stack = np.stack([np.stack([c.data, 2 * c.data]) for c in frames])  # frame, channel, ...
    stack = np.moveaxis(stack, 0, at)
    names = ["polarisation", "tx", "rx", "freq"]
    names.insert(at, "frame")
    path = write(container, tmp_path / "c", tree_of(first, data=stack))
    text = PLAIN.replace('["tx", "rx", "freq"]', f"{names}\npick = {{ polarisation = 1 }}")
    toml = layout(tmp_path, text)
    for i, capture in enumerate(frames):
        read = open_capture(path, layout=toml, frame=i)
        assert same_bits(read.data, 2 * capture.data)
        assert (read.meta["frame"], read.meta["frames"]) == (i, 3)
    assert same_bits(open_capture(path, layout=toml).data, 2 * first.data)
    assert "frames 0 to 2" in refused(path, toml, frame=3)
    with pytest.raises(ModelError, match="whole number"):
        open_with_layout(path, toml, frame=-1)
    assert "index 5" in refused(path, layout(tmp_path, text.replace("= 1 }", "= 5 }")))


@pytest.mark.parametrize("order", ["tx_major", "rx_major"])
@pytest.mark.parametrize("container", ["hdf5", "mat v5", "mat v7.3"])
def test_pairs(tmp_path, container, order):
    capture = random_capture()
    data = capture.data if order == "tx_major" else capture.data.transpose(1, 0, 2)
    pairs = np.array(data).reshape(-1, 6).T
    path = write(container, tmp_path / "c", tree_of(capture, data=pairs))
    text = PLAIN.replace('["tx", "rx", "freq"]', f'["freq", "pair"]\npair_order = "{order}"')
    assert_same(open_with_layout(path, layout(tmp_path, text)), capture)
    wrong = write(container, tmp_path / "w", tree_of(capture, data=pairs[:, :-1]))
    assert "19 pairs" in refused(wrong, layout(tmp_path, text))


# ---- real and imaginary part


@pytest.mark.parametrize("container", CONTAINERS)
def test_parts_in_two_keys(tmp_path, container):
    capture = random_capture()
    tree = tree_of(capture, data=0.0, re=capture.data.real, im=capture.data.imag)
    path = write(container, tmp_path / "c", tree)
    text = PLAIN.replace('key = "data"', 'real = "re"\nimag = "im"')
    assert_same(open_with_layout(path, layout(tmp_path, text)), capture)
    swapped = PLAIN.replace('key = "data"', 'real = "im"\nimag = "re"')
    read = open_with_layout(path, layout(tmp_path, swapped))
    assert same_bits(read.data.real.copy(), capture.data.imag.copy())
    tree = tree_of(capture, re=capture.data.real, im=capture.data.imag[:-1])
    path = write(container, tmp_path / "w", tree)
    assert "the imaginary part" in refused(path, layout(tmp_path, text))


@pytest.mark.parametrize(
    "fields", [("r", "i"), ("Real", "Imag"), ("re", "im"), ("I", "Q"), ("imag", "real")]
)
@pytest.mark.parametrize("container", ["npz", "hdf5", "hdf5 gzip"])
@pytest.mark.parametrize("kind", ["<f4", ">f8"])
def test_compound_types(tmp_path, container, fields, kind):
    capture = random_capture()
    data = np.empty(capture.data.shape, [(name, kind) for name in fields])
    real, imag = fields[::-1] if fields[0] == "imag" else fields
    data[real], data[imag] = capture.data.real, capture.data.imag
    path = write(container, tmp_path / "c", tree_of(capture, data=data))
    assert_same(open_with_layout(path, layout(tmp_path, PLAIN)), capture)


# ---- channels


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
    chosen = clradar.Capture(
        capture.data[np.ix_(indices, indices)],
        clradar.AntennaArray(tx[indices], rx[indices]),
        capture.waveform,
    )
    # As many positions as channels are those of the channels; so a mere order needs all of them.
    tree = tree_of(capture if pairs or len(indices) == 6 else chosen, data=capture.data)
    text = PLAIN
    for side in ("tx", "rx"):
        text = text.replace(f'"{side}"\n', f'"{side}"\nchannels = 6\nselect = {select}\n')
    if pairs:
        tree["data"] = capture.data.reshape(36, 6)
        text = text.replace('["tx", "rx", "freq"]', '["pair", "freq"]\npair_order = "tx_major"')
    path = write("hdf5", tmp_path / "c", tree)
    assert_same(open_with_layout(path, layout(tmp_path, text)), chosen)


@pytest.mark.parametrize(
    ("tx", "expected"),
    [
        ("channels = 7", "channels = 7"),
        ('select = "9:"', "keep a channel"),
        ("select = [0, 6]", "channel 6"),
        ("select = [0, 1]", None),
        ('select = "0:0"', "keep a channel"),
    ],
)
def test_channels_that_do_not_fit(tmp_path, tx, expected):
    capture = random_capture()
    path = write("npz", tmp_path / "c", tree_of(capture))
    toml = layout(tmp_path, PLAIN.replace("[tx]", f"[tx]\n{tx}"))
    if expected is None:
        assert open_with_layout(path, toml).array.n_tx == 2
    else:
        assert expected in refused(path, toml)


# ---- positions


def test_forms_of_positions(tmp_path):
    capture = random_capture()
    tx, rx = capture.array.tx_m, np.array(capture.array.rx_m)
    rx[:, 2] = 0.0125
    expected = clradar.Capture(capture.data, clradar.AntennaArray(tx, rx), capture.waveform)
    tree = {
        **tree_of(capture, tx=tx.T, rx=rx[:, [1, 0]]),
        **{f"tx_{axis}": tx[:, i : i + 1] for i, axis in enumerate("xyz")},
        **{f"rx_{axis}": rx[np.newaxis, :, i] for i, axis in enumerate("xyz")},
    }
    path = write("hdf5", tmp_path / "c", tree)
    apart = '[tx]\nx = "tx_x"\ny = "tx_y"\nz = "tx_z"\n'
    turned = '[tx]\nkey = "tx"\norientation = "columns"\n'
    lines = "\n".join(",".join(map(repr, row)) for row in tx.tolist())
    (tmp_path / "Tx.dat").write_text("x,y,z\n" + lines + "\n")
    for one in (apart, turned, f"[tx]\nvalues = {tx.tolist()}\n", '[tx]\nfile = "Tx.dat"\n'):
        other = '[rx]\nx = "rx_x"\ny = "rx_y"\nz = 0.0125\n'
        text = DATA + one + other + METRES + FREQUENCY
        assert_same(open_with_layout(path, layout(tmp_path, text)), expected)
    flat = '[tx]\nx = "tx_x"\ny = "tx_y"\nz = "tx_z"\n[rx]\nkey = "rx"\nz = 0.0125\n'
    text = DATA + flat + METRES + 'columns = ["y", "x"]\n' + FREQUENCY
    assert_same(open_with_layout(path, layout(tmp_path, text)), expected)
    wrong = DATA + apart + '[rx]\nkey = "rx"\n' + METRES + FREQUENCY
    assert "x, y, z in the columns" in refused(path, layout(tmp_path, wrong))
    wrong = DATA + turned.replace("columns", "rows") + other + METRES + FREQUENCY
    assert 'orientation = "columns" would fit' in refused(path, layout(tmp_path, wrong))


def test_origin_and_mirror(tmp_path):
    capture = random_capture()
    shift = np.array([0.1, -0.2, 0.05])
    mirrored = [1, -1, -1] * capture.array.tx_m, [1, -1, -1] * capture.array.rx_m
    tree = tree_of(capture, tx=(mirrored[0] + shift) * 1e3, rx=(mirrored[1] + shift) * 1e3)
    path = write("npz", tmp_path / "c", tree)
    text = PLAIN.replace(
        'unit = "m"', 'unit = "mm"\norigin = [100, -200.0, 50]\nmirror = ["y", "z"]\nname = "A"'
    )
    read = open_with_layout(path, layout(tmp_path, text))
    assert read.array.name == "A"
    # Two roundings of numbers below 0.4 in double precision, here and in this test.
    tolerance_m = 4 * np.finfo(float).eps
    assert np.abs(read.array.tx_m - capture.array.tx_m).max() < tolerance_m
    assert np.abs(read.array.rx_m - capture.array.rx_m).max() < tolerance_m


# ---- frequencies


@pytest.mark.parametrize(
    "text",
    [
        '[frequency]\nkey = "f_ghz"\nunit = "GHz"',
        "[frequency]\nvalues = [72, 74, 76, 78, 80, 82]\nunit = 'GHz'",
        "[frequency]\nstart = 72\nstop = 82.0\npoints = 6\nunit = 'GHz'",
        "[frequency]\nstart = 72000\nstep = 2000\npoints = 6\nunit = 'MHz'",
        "[frequency]\nstart = 72e6\nstop = 82e6\npoints = 6\nunit = 'kHz'",
        "[frequency]\nstart = 'first'\nstep = 'step'\npoints = 'n'\nunit = 'Hz'",
        "[frequency]\nstart = 'first'\nstop = 82e9\npoints = 'n'\nunit = 'Hz'",
    ],
)
@pytest.mark.parametrize("container", ["hdf5", "mat v5", "mat v7.3"])
def test_forms_of_frequencies(tmp_path, container, text):
    capture = random_capture()
    f_ghz = np.arange(72, 83, 2)
    tree = tree_of(capture, f_ghz=f_ghz, first=72e9, step=np.array([2e9]), n=np.int16(6))
    path = write(container, tmp_path / "c", tree)
    read = open_with_layout(path, layout(tmp_path, DATA + SIDES + METRES + text + "\n"))
    # Whole gigahertz are exact in every unit.
    assert np.array_equal(read.waveform.frequencies_hz, f_ghz * 1e9)
    assert same_bits(read.data, capture.data)


@pytest.mark.parametrize("container", ["hdf5 gzip", "mat v5"])
def test_descending_frequencies_reverse_the_data(tmp_path, container):
    capture = random_capture()
    f = capture.waveform.frequencies_hz[::-1]
    path = write(container, tmp_path / "c", tree_of(capture, data=capture.data[..., ::-1], f=f))
    read = open_with_layout(path, layout(tmp_path, PLAIN))
    assert_same(read, capture)
    assert read.meta["frequencies_reversed"] is True
    f_ghz = "[frequency]\nstart = 82\nstop = 72\npoints = 6\nunit = 'GHz'\n"
    read = open_with_layout(path, layout(tmp_path, DATA + SIDES + METRES + f_ghz))
    assert same_bits(read.data, capture.data)


@pytest.mark.parametrize(
    ("f", "expected"),
    [
        ([72e9, 74e9, 73e9, 75e9, 76e9, 77e9], "74000000000, then 73000000000"),
        ([72e9] * 6, "72000000000, then 72000000000"),
        ([72.0, 74, 76, 78, 80, 82], "72 Hz, read in Hz"),
        ([72e9, 74e9, 76e9, 78e9, 80e9], "6 in the data"),
        ([72e9, 74e9, np.nan, 78e9, 80e9, 82e9], "NaN"),
        ([[72e9, 74e9, 76e9], [78e9, 80e9, 82e9]], "to be a list"),
        (np.array([72e9 + 1j] * 6), "real numbers"),
    ],
)
def test_frequencies_that_do_not_fit(tmp_path, f, expected):
    path = write("npz", tmp_path / "c", tree_of(random_capture(), f=np.array(f)))
    assert expected in refused(path, layout(tmp_path, PLAIN))


# ---- shapes and values that disagree


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda c: {"tx": c.array.tx_m[:-1]}, "4 positions and 5 channels"),
        (lambda c: {"data": c.data[:, :-1]}, "4 positions and 3 channels"),
        (lambda c: {"data": c.data[..., 0]}, "3 axes (tx, rx, freq)"),
        (lambda c: {"data": c.data.real}, "float32"),
        (lambda c: {"data": np.where(c.data == c.data[1, 2, 3], np.nan, c.data)}, "1 of 120"),
        (lambda c: {"data": np.where(c.data == c.data[1, 2, 3], np.inf, c.data)}, "1 of 120"),
        (lambda c: {"data": c.data.astype(complex) * 1e300}, "120 of 120"),
        (lambda c: {"data": c.data[:0]}, "length 0"),
        (lambda c: {"data": np.zeros((5, 4, 6), bool)}, "to hold numbers"),
        (lambda c: {"data": np.array("text")}, "3 axes"),
        (lambda c: {"tx": c.array.tx_m + np.nan}, "15 of 15"),
        (lambda c: {"tx": c.array.tx_m.astype(complex)}, "real numbers"),
        (lambda c: {"tx": c.array.tx_m[0]}, "x, y, z in the columns"),
        (lambda c: {"tx": np.array("text")}, "to hold numbers"),
        (lambda c: {"tx": np.zeros((0, 3))}, "at least one element"),
    ],
)
def test_contents_that_do_not_fit(tmp_path, change, expected):
    capture = random_capture()
    path = write("npz", tmp_path / "c", tree_of(capture, **change(capture)))
    message = refused(path, layout(tmp_path, PLAIN))
    assert expected in message
    assert str(path) in message


# ---- invalid layouts


BAD_LAYOUTS = [
    ("", "data: expected a table"),
    ("[data", "TOML"),
    (PLAIN + "[extra]\n", ": extra: unknown key; expected one of data, tx, rx"),
    (PLAIN + "typo = 1\n", ": frequency.typo: unknown key; expected one of key, values, start"),
    (PLAIN.replace("axes", "axis"), "data.axes: expected a list of axes"),
    (PLAIN.replace('"freq"]', '"frequency"]'), '"freq"'),
    (PLAIN.replace('"freq"]', '"rx"]'), "every axis once"),
    (PLAIN.replace('"freq"]', '"freq"]\npair_order = "tx_major"'), "pair_order"),
    (PLAIN.replace('["tx", "rx", "freq"]', '["pair", "freq"]'), "pair_order"),
    (PLAIN.replace('"freq"]', '"freq"]\nparts = ["real", "imag"]'), "parts"),
    (PLAIN.replace('"freq"]', '"freq"]\npick = { a = 1 }'), "pick"),
    (PLAIN.replace('"freq"]', '"freq"]\nreal = "a"'), "'real' and 'imag'"),
    (PLAIN.replace('key = "data"', 'real = "a"'), "'real' and 'imag'"),
    (PLAIN.replace('key = "data"', 'key = ""'), "a key of the file"),
    (PLAIN.replace('key = "data"', "key = 3"), "a key of the file"),
    (PLAIN.replace("[tx]", "phase_sign = true\n[tx]"), "phase_sign"),
    (PLAIN.replace("[tx]", '[tx]\nselect = "1-3"'), "slice"),
    (PLAIN.replace("[tx]", "[tx]\nselect = [-1]"), "from 0"),
    (PLAIN.replace("[tx]", "[tx]\nchannels = 0"), "channels"),
    (PLAIN.replace("[tx]", '[tx]\narray = "qar50"'), "one of 'key'"),
    (PLAIN.replace('key = "tx"', ""), "one of 'key'"),
    (PLAIN.replace('key = "tx"', 'x = "a"'), "one of 'key'"),
    (PLAIN.replace('key = "tx"', 'key = "tx"\nz = 0'), "columns"),
    (PLAIN.replace('unit = "m"', 'unit = "inch"'), '"m", "cm", "mm", "um"'),
    (PLAIN.replace('unit = "m"\n', ""), "unit of the positions"),
    (PLAIN.replace('unit = "m"', 'unit = "m"\nmirror = ["q"]'), "mirror"),
    (PLAIN.replace('unit = "Hz"', ""), "one of Hz, kHz, MHz, GHz"),
    (PLAIN.replace('key = "f"', "start = 1\npoints = 3"), "'stop' or 'step'"),
    (PLAIN.replace('key = "f"', 'key = "f"\npoints = 3'), "'key' and 'points'"),
    (PLAIN.replace('key = "f"', "values = []"), "list of numbers"),
    ("a = " + "[" * 5000, "TOML"),
    (".".join("a" * 9000) + " = 1", "characters"),
    (PLAIN + "#" * 2**18, "at most"),
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


# ---- the layouts that ship


@pytest.mark.parametrize("container", ["mat v5", "mat v5 deflated", "mat v7.3"])
def test_example_matlab_struct(tmp_path, container):
    rng = np.random.default_rng(0)
    full = rng.standard_normal((96, 96, 128, 2), dtype=np.float32).view(np.complex64)[..., 0]
    path = write(container, tmp_path / "c", {"rec": {"S": full, "comment": "plate at 30 cm"}})
    read = open_capture(path, layout=EXAMPLES / "matlab_struct.toml")
    assert same_bits(read.data, np.ascontiguousarray(full[1:95, 1:95].transpose(1, 0, 2).conj()))
    assert read.array.name == "qar50"
    assert read.array.same_positions(clradar.arrays.qar50(), 0.0)
    assert read.waveform.same_frequencies(clradar.Waveform.sfcw(72e9, 82e9, 128), 0.0)
    assert read.meta["file"] == {"rec.comment": "plate at 30 cm"}


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
    assert np.array_equal(read.waveform.frequencies_hz, np.arange(72, 83, 2) * 1e9)
    assert np.allclose(read.array.tx_m[:, 0], -tx[0] / 100, rtol=0, atol=1e-15)
    assert np.allclose(read.array.rx_m[:, 1], (rx[1] - 7.5) / 100, rtol=0, atol=1e-15)
    assert not read.array.tx_m[:, 2].any()
    assert read.meta["file"] == {"radar/temperature_c": 23.5, "operator": "M. Muster"}
    assert read.meta["frequencies_reversed"]


# ---- the command line


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    code = caught.value.code
    return code if isinstance(code, int) else 0


def test_convert_with_a_layout(tmp_path, capsys):
    capture = random_capture()
    rows = "\n".join(",".join(map(repr, row)) for row in capture.array.tx_m.tolist())
    (tmp_path / "Tx.dat").write_text("x,y,z\n" + rows)
    path = write("mat v7.3", tmp_path / "c.mat", tree_of(capture))
    toml = layout(tmp_path, PLAIN.replace('[tx]\nkey = "tx"', '[tx]\nfile = "Tx.dat"'))
    output = tmp_path / "c.h5"
    assert run("convert", path, "--layout", toml, "-o", output) == 0
    assert "5 x 4 x 6" in capsys.readouterr().out
    read = open_capture(output)
    assert_same(read, capture)
    assert read.meta["layout"]["tx"]["file"] == str(tmp_path / "Tx.dat")
    assert [i["file"] for i in read.meta["inputs"]] == ["c.mat", toml.name, "Tx.dat"]
    assert run("convert", path, "--layout", toml, "-o", toml, "--force") == 1
    for other in (("--to", "maroon"), ("--all-frames",)):
        assert run("convert", path, "--layout", toml, "-o", tmp_path / "d", *other) == 2
        assert "--layout" in capsys.readouterr().err


def test_inspect_prints_a_template_to_fill_in(tmp_path, capsys):
    capture = random_capture()
    path = write("npz", tmp_path / "c", tree_of(capture) | {"a\nb": np.zeros(3)})
    assert run("inspect", path) == 0
    text = capsys.readouterr().out.split("\n\n", 1)[1]
    assert "#   data (5, 4, 6) complex64" in text
    with pytest.raises(MeasurementError, match=r"\?"):
        open_capture(path, layout=layout(tmp_path, text))
    for key, value in (("[data]\nkey", "data"), ("[tx]  # and the same under [rx]\nkey", "tx"),
                       ("[rx]\nkey", "rx"), ("z away from it\nunit", "m"),
                       ("[frequency]\nkey", "f"), ("keys of them\nunit", "Hz")):  # fmt: skip
        assert f'{key} = "?"' in text
        text = text.replace(f'{key} = "?"', f'{key} = "{value}"')
    assert_same(open_capture(path, layout=layout(tmp_path, text)), capture)
