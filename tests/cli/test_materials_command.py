"""``clradar materials``."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from command_line import Run, one_error_line

from clradar import Coating, Material, PermittivityTable, write_materials
from clradar.model.known_materials import KNOWN
from clradar.model.material_file import material_of


def test_known_materials_are_listed(run: Run) -> None:
    outcome = run("materials")
    assert (outcome.status, outcome.err) == (0, "")
    table, sources = outcome.out.split("at normal incidence, 72:82 GHz, phase in degrees; sources:")
    lines = table.splitlines()
    for column in ("name", "permittivity", "coat mm", "power dB", "phase", "h mm", "l mm"):
        assert column in lines[0]
    assert "h_micro" not in lines[0]
    assert max(len(line.rstrip()) for line in lines) <= 80
    rows = {line.split()[0]: line for line in lines[2:]}
    assert list(rows) == list(KNOWN)
    assert "conductor" in rows["metal"]
    assert " ".join(rows["palm"].split()) == "palm 6.56 - 8.91j 0.14 -6.2 .. -5.6 -39.9 0.15 3"
    assert [line.split(": ")[0] for line in sources.splitlines()[1:]] == list(KNOWN)
    assert f"palm: {KNOWN['palm'].source}" in sources


def test_own_materials(run: Run, tmp_path: Path) -> None:
    lab, more = tmp_path / "lab.toml", tmp_path / "more.json"
    resin = Material("resin", PermittivityTable([75e9, 80e9], [2.9 - 0.04j, 2.8 - 0.06j]))
    paint = Material("paint", conductor=True, coating=Coating(1e-4, 3.5), source="[bold]guess")
    write_materials(lab, [resin])
    write_materials(more, [paint, Material("air", 1.0, micro_roughness_rms_m=1e-5)])
    outcome = run("materials", lab, more, "--band-ghz", "76:79")
    assert outcome.status == 0, outcome.err
    assert [line.split()[0] for line in outcome.out.splitlines()[2:5]] == ["resin", "paint", "air"]
    assert "resin: not stated\npaint: [bold]guess" in outcome.out
    assert "h_micro mm" in outcome.out
    assert "-inf" in outcome.out
    outcome = run("materials", lab, more, "--band-ghz", "76:79", "--json")
    records = json.loads(outcome.out)
    assert [material_of(record["material"]) for record in records][:2] == [resin, paint]
    assert records[0]["band_hz"] == [76e9, 79e9]
    assert records[0]["permittivity_at_middle"] == pytest.approx([2.85, -0.05], abs=1e-12)
    # 1 - 2 n / (1 + n) at both ends.
    ends = [20 * math.log10(abs((1 - n) / (1 + n))) for n in (
        (2.88 - 0.044j) ** 0.5, (2.82 - 0.056j) ** 0.5)]  # fmt: skip
    assert sorted(records[0]["reflectance_db"]) == pytest.approx(sorted(ends), abs=1e-9)
    assert records[2]["reflectance_db"] == [None, None]
    one_error_line(
        run("materials", lab), "material resin: permittivity", "75 to 80 GHz", "72 to 82"
    )
