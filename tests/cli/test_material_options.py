"""``--material`` and ``--material-of``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import typer
from command_line import Run, group_of

import clradar
from clradar.cli.groups import files_of
from clradar.cli.options import MaterialOptions
from clradar.errors import ClradarError, ClradarWarning
from clradar.model.material_file import material_of
from measurement_io import open_capture

OWN = '[resin]\npermittivity = "2.9 - 0.04j"\n[palm]\npermittivity = 3\n'


@pytest.fixture
def scene() -> clradar.Scene:
    mesh = trimesh.creation.icosphere(1, 0.02)
    part = np.arange(len(mesh.faces)) % 3
    return clradar.Scene(mesh.vertices, mesh.faces, part=part, part_names=("palm", "thumb", "nail"))


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    return path


def of(**given: Any) -> MaterialOptions:
    return group_of(MaterialOptions, **given)


def names(scene: clradar.Scene) -> list[str]:
    return [scene.materials[i].name for i in np.asarray(scene.material)[:3]]


def test_materials_of_all_and_of_parts(scene: clradar.Scene, own: Path) -> None:
    assert MaterialOptions().on(scene) is scene
    assert names(of(material="palm").on(scene)) == ["palm"] * 3
    some = of(material="palm", material_of=["thumb=skin", f"nail={own}:resin"])
    assert names(some.on(scene)) == ["palm", "skin", "resin"]
    assert files_of(some) == [own]
    alone = of(material_of=["thumb=skin"]).on(scene)
    assert names(alone) == ["perfect conductor", "skin", "perfect conductor"]
    file = of(material=f"{own}:resin").on(scene)
    assert file.materials == (clradar.read_materials(own)["resin"],)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"material": "rubber"}, "expected one of metal, skin, .*got 'rubber'"),
        ({"material": "{own}:rubber"}, "expected one of resin, palm of .*own.toml, got 'rubber'"),
        ({"material": "{own}"}, "expected one of metal, .*got .*own.toml'"),
        ({"material": "gone.toml:resin"}, "gone.toml: expected"),
        ({"material_of": ["skin"]}, "expected PART=NAME, got 'skin'"),
        ({"material_of": ["thumb=skin", "thumb=palm"]}, "part 'thumb' is given twice"),
        ({"material_of": ["toe=skin"]}, r"expected parts .*\(palm, thumb, nail\), got toe"),
    ],
)
def test_wrong_names_list_what_is_known(
    scene: clradar.Scene, own: Path, options: dict[str, str | list[str]], message: str
) -> None:
    if "material" in options:
        options = {"material": str(options["material"]).format(own=own)}
    with pytest.raises((typer.BadParameter, ClradarError), match=message):
        of(**options).on(scene)


def test_a_material_chooses_the_estimator_that_knows_it() -> None:
    assert MaterialOptions().estimator(None) is None
    assert MaterialOptions().estimator("stochastic") == "stochastic"
    assert of(material_of=["thumb=skin"]).estimator(None) == "physical"
    assert of(material="palm").estimator("physical") == "physical"
    with pytest.warns(ClradarWarning, match="--material: not used by --estimator expected"):
        assert of(material="palm").estimator("expected") == "expected"


def test_simulate_takes_the_materials_of_parts(run: Run, made: Path, tmp_path: Path) -> None:
    file = tmp_path / "s.h5"
    outcome = run("simulate", made / "hand.ply", "-o", file, "--band", "72:82:2",
                  "--material", "palm", "--material-of", "thumb=skin", "--samples-per-mm2",
                  "1.5")  # fmt: skip
    assert outcome.status == 0, outcome.err
    assert "2 S-parameters of palm, skin," in outcome.out or "of skin, palm," in outcome.out
    meta = open_capture(file).meta
    assert meta["settings"]["estimator"] == "physical"
    found = {record["name"]: material_of(record) for record in meta["scene"]["materials"]}
    assert found == {name: clradar.material(name) for name in ("palm", "skin")}
    outcome = run("simulate", made / "hand.ply", "-o", tmp_path / "x.h5", "--alpha", "0.3",
                  "--material", "palm", "--material-of", "toe=skin")  # fmt: skip
    assert outcome.status == 1
    warning, error = outcome.err.splitlines()
    assert "--alpha: not used by --estimator physical" in warning
    assert "expected parts of the meshes (palm, thumb, " in error
    assert "toe" in error
