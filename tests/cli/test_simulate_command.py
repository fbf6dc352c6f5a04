"""``clradar simulate``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import DENSITY, Run, group_of, one_error_line

import clradar
from clradar.cli.options import PlacementOptions, SceneOptions, mesh_and_alpha
from clradar.errors import ClradarError, ModelError
from clradar.files.hashing import sha256_of
from measurement_io import open_capture


def test_simulate_writes_what_the_library_gives(made: Path) -> None:
    capture = open_capture(made / "sim.h5")
    scene = clradar.Scene.from_mesh(made / "hand.ply", alpha=0.4)
    expected = clradar.simulate(
        scene,
        clradar.arrays.qar50(),
        clradar.Waveform.sfcw(72e9, 82e9, 16),
        samples_per_mm2=float(DENSITY),
        seed=7,
        device="pocl",
    )
    assert np.array_equal(capture.data, expected.data)
    meta = capture.meta
    assert meta["settings"]["seed"] == 7
    assert meta["scene"]["sha256"] == scene.digest()
    assert meta["device"] == expected.meta["device"]
    assert meta["clradar"] == clradar.__version__
    assert meta["packages"]["numpy"] == np.__version__
    assert meta["command"] == "simulate"
    assert meta["options"]["band"] == [72.0, 82.0, 16]
    digest = sha256_of(made / "hand.ply")
    assert meta["inputs"] == [{"file": "hand.ply", "sha256": digest}]


def test_every_option_of_simulate_reaches_the_library(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    received: dict[str, Any] = {}

    def fake(scene: clradar.Scene, array: object, waveform: clradar.Waveform, **given: Any) -> None:
        received.update(given, array=array, waveform=waveform, scene=scene)
        raise ModelError("enough")

    monkeypatch.setattr(clradar, "simulate", fake)
    command = ("simulate", made / "hand.ply", "-o", tmp_path / "x.h5")
    lab = tmp_path / "lab.toml"
    lab.write_text("[[antennas]]\nring = { radius_m = 0.1, n = 5 }")
    outcome = run(
        *command, "--rays-per-face", 3,
        "--rays-per-sample", 2, "--reception-radius-mm", 5, "--max-bounces", 4, "--normals", "face",
        "--crease-deg", 12, "--facets", "flat", "--seed", 9, "--array", lab, "--band", "24:26:11",
        "--device", "pocl",
    )  # fmt: skip
    one_error_line(outcome, "enough")
    expected = {
        "samples_per_mm2": None,
        "rays_per_face": 3,
        "rays_per_sample": 2,
        "reception_radius_m": 0.005,
        "max_bounces": 4,
        "normals": "face",
        "crease_deg": 12.0,
        "facets": "flat",
        "amplitude": "unit",
        "pattern_exponent": 0.0,
        "seed": 9,
        "estimator": None,
    }
    assert asdict(received["settings"]) == expected
    assert (received["array"].name, received["array"].n_tx) == ("lab", 5)
    assert np.array_equal(received["waveform"].frequencies_hz, np.linspace(24e9, 26e9, 11))
    assert "portable" in received["device"].info.platform.lower()
    one_error_line(run(*command, "--estimator", "expected", "--samples-per-mm2", 2), "enough")
    settings = received["settings"]
    assert (settings.estimator, settings.samples_per_mm2) == ("expected", 2.0)


def test_alpha_by_mesh_and_by_part(made: Path) -> None:
    meshes = [str(made / name) for name in ("hand.ply:0.2", "parts.glb")]
    scene = group_of(SceneOptions, meshes=meshes, alpha=["palm-2=0.6", "0.9", "thumb=0"]).load()
    alpha, part = np.asarray(scene.alpha), np.asarray(scene.part)
    # Both meshes have the parts of a hand.
    expected = {"palm": 0.2, "palm-2": 0.6, "thumb": 0.0, "thumb-2": 0.9, "index-2": 0.9}
    for name, value in expected.items():
        assert set(alpha[part == scene.part_names.index(name)]) == {value}


def test_mesh_and_alpha(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert mesh_and_alpha("a.ply") == (Path("a.ply"), None)
    assert mesh_and_alpha("a.ply:0.25") == (Path("a.ply"), 0.25)
    assert mesh_and_alpha("c:a.ply") == (Path("c:a.ply"), None)
    Path("a.ply:1").touch()  # a file of that very name
    assert mesh_and_alpha("a.ply:1") == (Path("a.ply:1"), None)


def test_transform_moves_the_mesh(made: Path, tmp_path: Path, run: Run) -> None:
    matrix = [[0.0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.03], [0, 0, 0, 1]]
    forms = (matrix, np.ravel(matrix).tolist(), {"transform": matrix, "rms_m": 1})
    path = tmp_path / "t.json"
    for form in forms:
        path.write_text(json.dumps(form))
        read = PlacementOptions(transform=path).matrix()
        assert np.array_equal(read, matrix)
    moved = SceneOptions(meshes=[(made / "hand.ply", None)], transform=path).load()
    assert moved.digest() == clradar.Scene.from_mesh(made / "hand.ply", transform=matrix).digest()
    for text in ("", "{", "[1, 2]", '{"matrix": []}', '["a"]', json.dumps([0] * 16),
                 "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]",
                 "[[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"):  # fmt: skip
        path.write_text(text)
        with pytest.raises(ClradarError, match=r"t\.json"):
            PlacementOptions(transform=path).matrix()
    outcome = run("simulate", made / "hand.ply", "-o", tmp_path / "x.h5", "--transform", path)
    one_error_line(outcome, "t.json")
