"""Files of materials: what they say, that they read back equal, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clradar import Coating, ColeCole, Material, PermittivityTable, PowerLaw
from clradar.errors import MeasurementError, ModelError, OutputError
from clradar.files.limits import MAX_TOML_BYTES
from clradar.model.known_materials import KNOWN
from clradar.model.material_file import (
    material_of,
    material_record,
    read_materials,
    write_materials,
)
from clradar.model.permittivity import MAX_TABLE_ROWS

ALL_KINDS = """
[phantom]
permittivity = "6.5 - 8.9j"
coating = { thickness_m = 140e-6, permittivity = { eps_inf = 2.96, poles = [[1.5, 6.9e-12]] } }
roughness_rms_m = 0.15e-3
correlation_length_m = 3e-3
micro_roughness_rms_m = 1e-5
source = "measured"

["painted metal"]
conductor = true
coating = { thickness_m = 1e-4, permittivity = 3 }

[board]
permittivity = { a = 1.99, c = 0.0047, d = 1.0718 }

[resin]
permittivity.frequency_hz = [70e9, 85e9]
permittivity.permittivity = ["2.9-0.04j", 2.8]
"""

HORNY = ColeCole(2.96, [(1.5, 6.9e-12)])
EXPECTED = [
    Material("phantom", 6.5 - 8.9j, coating=Coating(140e-6, HORNY), roughness_rms_m=0.15e-3,
             correlation_length_m=3e-3, micro_roughness_rms_m=1e-5),
    Material("painted metal", conductor=True, coating=Coating(1e-4, 3.0)),
    Material("board", PowerLaw(1.99, 0.0, 0.0047, 1.0718)),
    Material("resin", PermittivityTable([70e9, 85e9], [2.9 - 0.04j, 2.8])),
]  # fmt: skip


def test_all_that_a_file_can_say(tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text(ALL_KINDS, encoding="utf-8")
    found = read_materials(path)
    assert list(found.values()) == EXPECTED
    assert list(found) == [own.name for own in EXPECTED]
    assert found["phantom"].source == "measured"


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_files_read_back_to_the_last_bit(tmp_path, suffix):
    rng = np.random.default_rng(1)
    odd = [
        Material(
            'odd "name".\n\u00e4',
            PermittivityTable(
                np.sort(rng.uniform(1e9, 9e11, MAX_TABLE_ROWS)),
                rng.uniform(1, 9, MAX_TABLE_ROWS) - 1j * rng.random(MAX_TABLE_ROWS),
            ),
            coating=Coating(1 / 3e4, ColeCole(1 / 3, rng.uniform(0, 0.9, (16, 3)) + 1e-30, 1 / 7)),
            roughness_rms_m=1e-4 / 3,
            correlation_length_m=1e-3 / 7,
            source="a\tb \\ '",
        ),
        Material("tiny loss", complex(3.0, -5e-324)),
    ]
    path = tmp_path / f"all{suffix}"
    write_materials(path, [*KNOWN.values(), *odd])
    assert path.stat().st_size < MAX_TOML_BYTES
    found = list(read_materials(path).values())
    assert found == [*KNOWN.values(), *odd]
    assert [own.source for own in found] == [own.source for own in [*KNOWN.values(), *odd]]
    with pytest.raises(OutputError, match="exists"):
        write_materials(path, odd)
    with pytest.raises(ModelError, match="expected different names, got 'palm' twice"):
        write_materials(tmp_path / f"two{suffix}", [KNOWN["palm"], KNOWN["palm"]])
    with pytest.raises(OutputError, match=r"ends in \.toml or \.json, got '\.txt'"):
        write_materials(tmp_path / "x.txt", odd)


def test_the_page_of_materials_is_right(tmp_path):
    page = (Path(__file__).resolve().parents[2] / "docs" / "materials.md").read_text("utf-8")
    path = tmp_path / "page.toml"
    path.write_text(page.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    assert len(read_materials(path)) == 4
    lines = page.replace("\N{MINUS SIGN}", "-").splitlines()
    rows = [[cell.strip() for cell in line.split("|")[1:6]] for line in lines if " dB |" in line]
    rows = [[row[0].strip("`"), *row[1:]] for row in rows]
    assert [row[0] for row in rows] == list(KNOWN)
    for name, eps, level_db, *lengths_mm in rows:
        own = KNOWN[name]
        level = 20 * np.log10(abs(own.reflection(77e9, 1.0)[0, 0]))
        assert level == pytest.approx(float(level_db.removesuffix(" dB")), abs=0.051)
        if not own.conductor:
            real, loss = map(float, eps.removesuffix("j").split(" - "))
            (found,) = own.permittivity_at(77e9)
            assert found.real == pytest.approx(real, abs=0.0051)
            assert -found.imag == pytest.approx(loss, rel=0.05)
        lengths_m = (own.roughness_rms_m, own.correlation_length_m)
        assert [float(text or 0) / 1e3 for text in lengths_mm] == [m or 0 for m in lengths_m]


def test_records_for_other_files():
    for own in KNOWN.values():
        again = material_of(json.loads(json.dumps(material_record(own))))
        assert again == own
        assert again.source == own.source
    assert material_record(replace(KNOWN["skin"], source="")).keys() == {
        "name", "permittivity", "roughness_rms_m", "correlation_length_m",
    }  # fmt: skip
    with pytest.raises(MeasurementError, match="plan: material: roughness_rms_m: expected an RMS"):
        material_of({"name": "x", "permittivity": 2.0, "roughness_rms_m": 3}, "plan: material")


REFUSED = {
    "": "expected a table for each material, got nothing",
    "permittivity = 3": "permittivity: expected a table or object, got 3",
    "[x]": "x: expected either a permittivity or conductor=True, got neither",
    "[x]\npermittivity = 3\nroughnes_rms_m = 1": "x.roughnes_rms_m: unknown key; expected one of "
    "permittivity, conductor",
    "[x]\nname = 'y'": "x.name: expected no such key: a table's name is the material's, got y",
    "[x]\npermittivity = 'three'": 'x.permittivity: expected a number, text such as "2.9 - 0.04j"',
    "[x]\npermittivity = true": "x.permittivity: expected a complex number",
    "[x]\npermittivity = [3, 1]": "x.permittivity: expected a complex number, a ColeCole",
    "[x]\npermittivity = 2024-01-01": "x.permittivity: expected a number, got",
    f"[x]\npermittivity = 1{'0' * 400}": "x.permittivity: expected a number",
    "[x]\npermittivity = { real = 3 }": "a table with eps_inf, with a, or with frequency_hz",
    "[x]\npermittivity = { eps_inf = 3, pole = 1 }": "x.permittivity.pole: unknown key; expected "
    "one of eps_inf, poles, sigma_s_per_m (did you mean 'poles'?)",
    "[x]\npermittivity = { eps_inf = 3, poles = 1 }": "x.permittivity.poles: expected a list of",
    "[x]\npermittivity = { eps_inf = 3, poles = ['ab'] }": "x.permittivity.poles[0]: expected (del",
    "[x]\npermittivity = { frequency_hz = [7e10, 8e10], permittivity = [3, [3]] }": "x.permittivity"
    ".permittivity: expected an array of shape (2,), got a ragged one",
    "[x]\nconductor = true\ncoating = { thickness_m = 1e-4 }": "x.coating.permittivity: expected "
    "a value, got none",
    "[x]\nconductor = true\ncorrelation_length_m = 'long'": "x.correlation_length_m: expected a n",
    "[x]\nconductor = true\n[x]": "TOMLDecodeError",
}


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_mistakes_name_the_file_and_the_key(tmp_path, text):
    path = tmp_path / "lab.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError) as caught:
        read_materials(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert REFUSED[text] in message
    assert "\n" not in message
    assert len(message) < 1000


def test_files_that_are_none(tmp_path):
    for name, content, words in (
        ("x.txt", b"", r"ends in \.toml or \.json"),
        ("x.json", b"[]", "list where a JSON object"),
        ("x.json", b'{"x": {"conductor": true}, "x": {}}', "the key 'x' twice"),
        ("x.json", b'{"x": 1}', "x: expected a table or object, got 1"),
        ("x.toml", b"\xff", "bytes that are no UTF-8 text"),
        ("x.toml", b"#" * (MAX_TOML_BYTES + 1), "of at most"),
        ("gone/x.toml", None, "nothing there"),
    ):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(MeasurementError, match=words):
            read_materials(path)


def test_mistakes_of_several_materials_are_reported_at_once(tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text("[a]\npermitivity = 3\n[b]\npermittivity = 3\n[c]\npermittivity = 'x'\n")
    with pytest.raises(MeasurementError, match=r"^2 mistakes, one per line:") as caught:
        read_materials(path)
    _, first, second = str(caught.value).split("\n")
    assert first.startswith(f"{path}: a.permitivity: unknown key")
    assert second.startswith(f"{path}: c.permittivity: expected a number")
