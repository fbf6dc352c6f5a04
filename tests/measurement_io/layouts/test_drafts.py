"""Drafts of layouts: positions are recognised whatever their name and unit, at a bounded cost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from layout_files import layout, random_capture, write
from test_layouts import draft

import clradar
from clradar.errors import MeasurementError
from measurement_io import open_capture
from measurement_io.confined import hdf5_process
from measurement_io.layouts import mat5_container

QAR50 = clradar.arrays.qar50()
GHZ = np.linspace(72, 82, 7)
PER_M = {"m": 1.0, "cm": 1e2, "mm": 1e3}


def recorded(tx_m: np.ndarray, rx_m: np.ndarray) -> clradar.Capture:
    return clradar.Capture(
        random_capture(len(tx_m), len(rx_m), len(GHZ)).data,
        clradar.AntennaArray(tx_m, rx_m),
        clradar.Waveform(GHZ * 1e9),
    )


def drafted(tmp_path: Path, tree: dict[str, Any], container: str = "hdf5") -> str:
    return draft(write(container, tmp_path / "lab", tree))


def read_back(tmp_path: Path, text: str) -> clradar.Capture:
    return open_capture(tmp_path / "lab", layout=layout(tmp_path, text))


def assert_positions(read: clradar.Capture, tx_m: np.ndarray, rx_m: np.ndarray) -> None:
    rounding_m = 1e-12
    assert np.abs(read.array.tx_m - tx_m).max() <= rounding_m
    assert np.abs(read.array.rx_m - rx_m).max() <= rounding_m


@pytest.mark.parametrize(
    ("tx", "rx"),
    [
        ("ant_send", "ant_recv"),
        ("sender", "receiver"),
        ("TransmitPos", "ReceivePos"),
        ("positionsTx", "positionsRx"),
        ("emitter_xyz", "rcv_xyz"),
        ("pos_t", "pos_r"),
        ("Sendeantennen", "Empfangsantennen"),
        ("array/transducer", "array/recv"),
    ],
)
@pytest.mark.parametrize("unit", PER_M)
def test_positions_are_found_by_many_names_in_any_unit(
    tmp_path: Path, tx: str, rx: str, unit: str
) -> None:
    capture = recorded(QAR50.tx_m, QAR50.rx_m)
    text = drafted(
        tmp_path,
        {
            "s": capture.data,
            "f": GHZ,
            tx: QAR50.tx_m * PER_M[unit],
            rx: QAR50.rx_m * PER_M[unit],
        },
    )
    assert "qar50" not in text
    assert f'unit = "{unit}"' in text
    assert "guess: the antennas span" in text  # the unit is not said by any name
    assert_positions(read_back(tmp_path, text), QAR50.tx_m, QAR50.rx_m)


@pytest.mark.parametrize(
    ("tx", "rx"),
    [("send_{}", "recv_{}"), ("{}t", "{}r"), ("ant/tx{}", "ant/rx{}"), ("{}Tx", "{}Rx")],
)
def test_coordinates_in_keys_of_their_own(tmp_path: Path, tx: str, rx: str) -> None:
    rng = np.random.default_rng(5)
    tx_m, rx_m = (rng.uniform(-0.05, 0.05, (n, 3)) for n in (9, 8))
    tree: dict[str, Any] = {"s": recorded(tx_m, rx_m).data, "f": GHZ}
    for name, table in ((tx, tx_m), (rx, rx_m)):
        letter = "XYZ" if "/" in name or name.startswith("{}T") else "xyz"
        tree |= {name.format(letter[i]): table[:, i] * 1e3 for i in range(3)}
    text = drafted(tmp_path, tree)
    assert_positions(read_back(tmp_path, text), tx_m, rx_m)


def test_tables_without_a_side_in_their_name_are_guessed_by_length(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    tx_m, rx_m = (rng.uniform(-0.05, 0.05, (n, 3)) for n in (12, 8))
    text = drafted(
        tmp_path,
        {"s": recorded(tx_m, rx_m).data, "f": GHZ, "set_a": rx_m.T * 1e2, "set_b": tx_m * 1e2},
    )
    assert 'key = "set_b"  # guess: by its length; which one transmits' in text
    assert_positions(read_back(tmp_path, text), tx_m, rx_m)


def test_one_table_left_is_the_other_side(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    tx_m, rx_m = (rng.uniform(-0.05, 0.05, (n, 3)) for n in (12, 8))
    tree = {"s": recorded(tx_m, rx_m).data, "f": GHZ, "tx": tx_m, "listeners": rx_m}
    text = drafted(tmp_path, tree)
    assert 'key = "listeners"  # guess: by its length' in text
    assert_positions(read_back(tmp_path, text), tx_m, rx_m)


def test_ambiguous_tables_are_named_and_not_chosen(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    tables = {name: rng.uniform(-50, 50, (94, 3)) for name in ("set_a", "set_b", "set_c")}
    data = recorded(QAR50.tx_m, QAR50.rx_m).data
    text = drafted(tmp_path, {"s": data, "f": GHZ, **tables})
    assert "qar50" not in text
    assert 'key = "?"  # positions: one of set_a, set_b, set_c?' in text
    with pytest.raises(MeasurementError, match=r"\?"):
        read_back(tmp_path, text)


def test_directions_and_matrices_are_no_positions(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    unit = rng.normal(size=(94, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    tree = {"s": recorded(QAR50.tx_m, QAR50.rx_m).data, "f": GHZ, "looks_at": unit}
    text = drafted(tmp_path, {**tree, "send_normals": unit, "pose": np.eye(3), "recv_angles": unit})
    assert text.count('array = "qar50"  # guess') == 2


def test_a_name_that_contradicts_the_wavelength_is_a_guess(tmp_path: Path) -> None:
    tree = {"tx_mm": QAR50.tx_m * 1e2, "rx_mm": QAR50.rx_m * 1e2}  # these are centimetres
    text = drafted(tmp_path, {"s": recorded(QAR50.tx_m, QAR50.rx_m).data, "f": GHZ, **tree})
    assert 'unit = "cm"  # guess: the antennas span 14.4, 0.3 apart: 0.77 wavelengths' in text


# ---- cost: many small keys


@pytest.mark.parametrize("container", ["hdf5", "mat v7.3"])
def test_a_file_of_many_small_datasets_takes_a_few_processes(
    tmp_path: Path, container: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []
    run = hdf5_process.run

    def counted(function: Any, *arguments: Any, **options: Any) -> Any:
        started.append(function.__name__)
        return run(function, *arguments, **options)

    monkeypatch.setattr(hdf5_process, "run", counted)
    few, many = (
        {f"value_{i:03}": np.arange(4.0) * i for i in range(n)}
        | {"s": recorded(QAR50.tx_m, QAR50.rx_m).data, "f": GHZ}
        | {"ant_send": QAR50.tx_m, "ant_recv": QAR50.rx_m}
        for n in (1, 300)
    )
    counts = []
    for tree in (few, many):
        started.clear()
        text = drafted(tmp_path, tree, container)
        assert 'key = "ant_send"' in text
        assert 'key = "f"' in text
        counts.append(len(started))
    assert counts[0] == counts[1] <= 3


@pytest.mark.parametrize("container", ["mat v5", "mat v5 deflated"])
def test_a_struct_of_many_fields_is_walked_a_few_times(
    tmp_path: Path, container: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    walks = []

    class Counted(mat5_container._Walk):
        def __init__(self, *arguments: Any) -> None:
            walks.append(arguments[1])
            super().__init__(*arguments)

    monkeypatch.setattr(mat5_container, "_Walk", Counted)
    fields = {f"value_{i:03}": np.arange(4.0) * i for i in range(300)}
    lab = fields | {"f": GHZ, "ant_send": QAR50.tx_m, "ant_recv": QAR50.rx_m}
    data = recorded(QAR50.tx_m, QAR50.rx_m).data
    text = drafted(tmp_path, {"s": data, "lab": lab}, container)
    assert 'key = "lab/ant_send"' in text
    assert 'key = "lab/f"' in text
    assert len(walks) == 3  # two variables are listed, and one is read


def test_a_damaged_dataset_does_not_hide_the_others(tmp_path: Path) -> None:
    import h5py

    tree = {"s": random_capture(5, 4, 7).data, "f": GHZ}
    path = write("hdf5", tmp_path / "lab", tree)
    with h5py.File(path, "a") as file:
        file.create_dataset("a_frequencies", (8,), float, chunks=(4,))  # none of its chunks stored
    text = draft(path)
    assert 'key = "f"' in text
