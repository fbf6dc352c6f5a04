"""Materials: reflection against boundary conditions; their files; what is refused of both."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clradar
from clradar import METAL, Coating, ColeCole, Material, PermittivityTable, PowerLaw, Waveform
from clradar.errors import ClradarWarning, MeasurementError, ModelError, OutputError
from clradar.files.limits import MAX_TOML_BYTES
from clradar.model.kirchhoff import check_kirchhoff, curvature_radius_m
from clradar.model.known_materials import HORNY_LAYER, KNOWN
from clradar.model.material_file import (
    read_materials,
    write_materials,
)
from clradar.model.permittivity import MAX_TABLE_ROWS

C = 299_792_458.0
EPS_0 = 8.8541878128e-12
BAND = np.array([72e9, 77e9, 82e9])
COSINES = np.cos(np.deg2rad([0, 20, 45, 70, 85, 89.9]))

ROUNDING = 1e-12
"""Of a few hundred operations in float64 on numbers of about 1, with a margin of ten."""


def by_boundary_conditions(
    layers: list[complex | None], thicknesses_m: list[float], frequency_hz: float, cosine: float
) -> tuple[complex, complex]:
    """r_s and r_p of layers, by solving the equations that the fields obey at each boundary.

    The last layer is a half space, or a conductor where it is None. U is the electric field for s
    and the magnetic one for p; it and its slope (for p over the permittivity) are continuous. On a
    conductor the electric one of the two is 0. Unknown are the wave that goes back from each
    boundary and the one that goes on.
    """
    k = 2 * np.pi * frequency_hz / C
    eps = [1.0 + 0j, *(e for e in layers if e is not None)]
    roots = [np.sqrt(e - 1 + cosine**2) for e in eps]
    kz = [k * root * (1 if root.imag <= 0 else -1) for root in roots]  # exp(-j kz z) decays
    ends = np.concatenate([[0.0], np.cumsum(thicknesses_m)])
    count = len(ends) + len(eps) - 1  # waves back in front of each boundary, waves on behind it
    found = []
    for kind in "sp":

        def wave(medium: int, sign: int, z: float, slope: bool, kind: str = kind) -> complex:
            weight = sign * 1j * kz[medium] / (eps[medium] if kind == "p" else 1)
            return np.exp(sign * 1j * kz[medium] * z) * (weight if slope else 1)

        matrix, right = [], []
        for at, z in enumerate(ends):
            behind = at + 1 < len(eps)
            for slope in (False, True) if behind else (kind == "p",):
                row = np.zeros(count, complex)
                row[at] = wave(at, +1, z, slope)
                if at > 0:
                    row[len(ends) + at - 1] = wave(at, -1, z, slope)
                if behind:
                    row[len(ends) + at] = -wave(at + 1, -1, z, slope)
                if at + 1 < len(ends):
                    row[at + 1] = -wave(at + 1, +1, z, slope)
                matrix.append(row)
                right.append(-wave(0, -1, z, slope) if at == 0 else 0)
        found.append(np.linalg.solve(matrix, right)[0])
    return found[0], found[1]


STACKS = {
    "lossless": Material("x", 6.0),
    "skin": KNOWN["skin"],
    "palm": KNOWN["palm"],
    "thick layer": Material("x", 6 - 9j, coating=Coating(5e-3, 3 - 0.01j)),
    "paint on metal": Material("x", conductor=True, coating=Coating(0.2e-3, 3.5 - 0.05j)),
    "thinner than vacuum": Material("x", 0.5),
    "tunnel": Material("x", 4.0, coating=Coating(0.3e-3, 0.4)),
    "lossless on metal": Material("x", conductor=True, coating=Coating(0.7e-3, 4.0)),
}


@pytest.mark.parametrize("name", STACKS)
def test_reflection_is_that_of_the_boundary_conditions(name):
    own = STACKS[name]
    r_s, r_p = own.fresnel(BAND, COSINES)
    for i, frequency in enumerate(BAND):
        layers: list[Any] = [None if own.conductor else own.permittivity_at(frequency)[0]]
        thicknesses = []
        if own.coating is not None:
            eps = own.coating.permittivity
            layers.insert(0, eps.at(frequency)[0] if isinstance(eps, ColeCole) else eps)
            thicknesses.append(own.coating.thickness_m)
        for m, cosine in enumerate(COSINES):
            s, p = by_boundary_conditions(layers, thicknesses, frequency, cosine)
            assert abs(s - r_s[i, m]) < ROUNDING
            assert abs(p - r_p[i, m]) < ROUNDING
    assert np.array_equal(own.reflection(BAND, COSINES), (r_s - r_p) / 2)


def test_a_conductor_turns_the_field_at_every_angle():
    assert np.array_equal(METAL.reflection(BAND, COSINES), np.full((3, 6), -1))


def test_dispersion_is_that_of_the_tables_of_gabriel():
    # IFAC-CNR's program after Gabriel (niremf.ifac.cnr.it): permittivity and conductivity in S/m.
    published = {
        "skin": {84.918e9: (6.1512, 38.711), 100e9: (5.5987, 39.433)},
        "skin-wet": {84.918e9: (8.0029, 44.199), 100e9: (7.2453, 46.117)},
    }
    for name, rows in published.items():
        for frequency, (real, sigma) in rows.items():
            (eps,) = KNOWN[name].permittivity_at(frequency)
            assert eps.real == pytest.approx(real, rel=5e-5)
            assert -eps.imag * 2 * np.pi * frequency * EPS_0 == pytest.approx(sigma, rel=5e-5)
    # The horny layer of the palm, after Alekseev and Ziskin.
    assert HORNY_LAYER.at(77e9)[0] == pytest.approx(3.08 - 0.41j, abs=0.005)
    # ITU-R P.2040 at 60 GHz: plasterboard has 0.398 S/m.
    (eps,) = KNOWN["plaster"].permittivity_at(60e9)
    assert eps.real == 2.73
    assert -eps.imag * 2 * np.pi * 60e9 * EPS_0 == pytest.approx(0.0085 * 60**0.9395, rel=1e-12)


def test_a_table_is_linear_between_its_rows_and_ends_there():
    table = PermittivityTable([70e9, 80e9, 90e9], [3 - 0.1j, 2.8 - 0.3j, 2.8 - 0.2j])
    assert table.at([70e9, 75e9, 82.5e9, 90e9]) == pytest.approx(
        [3 - 0.1j, 2.9 - 0.2j, 2.8 - 0.275j, 2.8 - 0.2j], abs=1e-12
    )
    resin = Material("resin", table)
    with pytest.raises(ModelError, match="material resin: permittivity: expected") as caught:
        resin.reflection([60e9, 82e9], 1.0)
    assert str(caught.value).endswith("within its table, 70 to 90 GHz, got 60 to 82 GHz")
    painted = Material("painted", conductor=True, coating=Coating(1e-4, table))
    with pytest.raises(ModelError, match=r"material painted: coating\.permittivity: .* 70 to 90"):
        painted.reflection(100e9, 1.0)


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "gain": (lambda: Material("x", 3 + 0.1j), "passive permittivity, eps' - j eps'' with eps''"),
    "gain of a coating": (lambda: Coating(1e-4, 3 + 1e-9j), "Coating.permittivity: expected a pas"),
    "gain in a table": (lambda: PermittivityTable([7e10, 8e10], [2, 2 + 1j]), "which has gain"),
    "zero": (lambda: Material("x", 0.0), "positive real part, got 0+0j"),
    "infinite": (lambda: Material("x", complex(3, -np.inf)), "a finite number"),
    "text": (lambda: Material("x", "3"), "a ColeCole, a PowerLaw or a PermittivityTable, got str"),
    "neither": (lambda: Material("x"), "either a permittivity or conductor=True, got neither"),
    "both": (lambda: Material("x", 3.0, conductor=True), "got both"),
    "conductor": (lambda: Material("x", 3.0, conductor=1), "True or False, got 1"),
    "no name": (lambda: Material(" ", 3.0), "Material.name: expected a name"),
    "no length": (
        lambda: Material("x", 3.0, roughness_rms_m=1e-4),
        "Material.correlation_length_m: expected a length, since roughness_rms_m is positive",
    ),
    "h in mm": (
        lambda: Material("x", 3.0, roughness_rms_m=0.15, correlation_length_m=3e-3),
        "roughness_rms_m: expected an RMS height of at most 0.01 m, got 0.15 m; did you mean 0.15 "
        "mm (0.00015 m)",
    ),
    "l in mm": (
        lambda: Material("x", 3.0, roughness_rms_m=1e-4, correlation_length_m=3),
        "did you mean 3 mm (0.003 m)",
    ),
    "micro in mm": (lambda: Material("x", 3.0, micro_roughness_rms_m=0.02), "got 0.02 m; did you"),
    "negative h": (lambda: Material("x", 3.0, roughness_rms_m=-1e-4), "an RMS height"),
    "coating in mm": (lambda: Coating(0.14, 3.0), "did you mean 0.14 mm (0.00014 m)"),
    "no coating": (lambda: Material("x", 3.0, coating=(1e-4, 3.0)), "a Coating, got tuple"),
    "growing pole": (lambda: ColeCole(4, [(-1, 1e-12)]), "poles[0] delta: expected a number that"),
    "pole": (lambda: ColeCole(4, [(1, 1e-12, 0.1, 3)]), "(delta, tau_s) or (delta, tau_s, alpha)"),
    "alpha": (lambda: ColeCole(4, [(1, 1e-12, 1.0)]), "alpha: expected a number in [0, 1)"),
    "tau": (lambda: ColeCole(4, [(1, 0.0)]), "tau_s: expected a positive number"),
    "tau in ps": (lambda: ColeCole(4, [(32, 7.234)]), "in seconds, at most 1, got 7.234; did you"),
    "sigma": (lambda: ColeCole(4, (), -1), "sigma_s_per_m: expected a number that is not negative"),
    "many poles": (lambda: ColeCole(4, [(1, 1e-12)] * 17), "at most 16 poles, got 17"),
    "growing law": (lambda: PowerLaw(2, 0, -1), "PowerLaw.c: expected a number that is not negat"),
    "exponent": (lambda: PowerLaw(2, 99), "PowerLaw.b: expected an exponent from -10 to 10"),
    "table in GHz": (lambda: PermittivityTable([70, 80], [2, 2]), "did you mean 70 to 80 GHz"),
    "table order": (lambda: PermittivityTable([8e10, 7e10], [2, 2]), "strictly ascending"),
    "table lengths": (lambda: PermittivityTable([7e10, 8e10], [2]), "shape (2,), got shape (1,)"),
    "one row": (lambda: PermittivityTable([7e10], [2]), "2 to 2000 frequencies, got 1"),
    "unknown": (lambda: clradar.material("velvet"), "material: expected one of 'metal', 'skin'"),
    "cosine": (lambda: METAL.reflection(77e9, 1.01), "cosines in [0, 1], got [1.01, 1.01]"),
    "frequency": (lambda: METAL.reflection(77, 1.0), "did you mean 77 GHz"),
    "no permittivity": (lambda: METAL.permittivity_at(77e9), "a dielectric, got the conductor"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name):
    make, part = REFUSED[name]
    with pytest.raises(ModelError) as caught:
        make()
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("own", KNOWN.values(), ids=KNOWN)
def test_known_materials(own):
    assert clradar.material(own.name) is own
    assert own.source
    check_kirchhoff(own, Waveform.sfcw(72e9, 82e9, 2))  # a warning is an error here
    again = pickle.loads(pickle.dumps(own))
    assert again == own == eval(repr(own), globals())
    assert hash(again) == hash(own)
    assert again.source == own.source


def test_radius_of_curvature_is_that_of_drawn_profiles():
    # Mean of 1/|curvature'| as the formula has it: (1 + s^2)^1.5 / E|z''| with E|z''| replaced by
    # the RMS 2 sqrt(3) h / l^2 of a Gaussian correlation: here from its fourth derivative, 12 h^2.
    h, length = 0.15e-3, 3e-3
    own = Material("x", 3.0, roughness_rms_m=h, correlation_length_m=length)
    x = np.linspace(-0.02, 0.02, 5) * length

    def correlation(r: np.ndarray) -> np.ndarray:
        return h**2 * np.exp(-((r / length) ** 2))

    step = x[1] - x[0]
    fourth = (np.array([1, -4, 6, -4, 1]) @ correlation(x)) / step**4
    slope = -np.array([0, 1, -2, 1, 0]) @ correlation(x) / step**2
    expected = (1 + slope) ** 1.5 / np.sqrt(fourth)
    assert curvature_radius_m(own) == pytest.approx(expected, rel=1e-3)
    assert own.rms_slope == pytest.approx(np.sqrt(slope), rel=1e-3)
    assert curvature_radius_m(METAL) == np.inf
    assert METAL.rms_slope == 0


@pytest.mark.parametrize(
    ("h_mm", "l_mm", "words"),
    [
        (1.0, 4.0, "RMS slope of 0.35"),
        (0.3, 2.0, "mean radius of 4.1 mm, below 2 wave"),
    ],
)
def test_what_kirchhoff_cannot_do_is_warned_of(h_mm, l_mm, words):
    own = Material("x", 3.0, roughness_rms_m=h_mm / 1e3, correlation_length_m=l_mm / 1e3)
    with pytest.warns(ClradarWarning, match="material 'x': roughness of") as caught:
        check_kirchhoff(own, Waveform.sfcw(72e9, 82e9, 2))
    assert words in " ".join(str(w.message) for w in caught)


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


WRONG_FILES = {
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


@pytest.mark.parametrize("text", WRONG_FILES, ids=range(len(WRONG_FILES)))
def test_mistakes_name_the_file_and_the_key(tmp_path, text):
    path = tmp_path / "lab.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError) as caught:
        read_materials(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert WRONG_FILES[text] in message
    assert "\n" not in message
    assert len(message) < 1000


def test_mistakes_of_several_materials_are_reported_at_once(tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text("[a]\npermitivity = 3\n[b]\npermittivity = 3\n[c]\npermittivity = 'x'\n")
    with pytest.raises(MeasurementError, match=r"^2 mistakes, one per line:") as caught:
        read_materials(path)
    _, first, second = str(caught.value).split("\n")
    assert first.startswith(f"{path}: a.permitivity: unknown key")
    assert second.startswith(f"{path}: c.permittivity: expected a number")
