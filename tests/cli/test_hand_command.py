"""``clradar hand`` and ``clradar materials``."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from command_line import EDGE_MM

from clradar import Coating, Material, PermittivityTable, Scene, write_materials
from clradar.hand import HandPose, hand_mesh, pose_by_name, write_pose
from clradar.model.known_materials import KNOWN
from clradar.model.material_file import material_of


def test_hand_lists_its_poses(cli):
    printed = cli.ok("hand --list").out
    assert {"A", "F", "Y", "0", "9", "flat"} <= set(printed.split())
    assert "Fist with the thumb across the front of the fingers." in printed


def test_a_hand_of_a_pose_file_and_of_another_size(cli, made):
    write_pose("mine.toml", HandPose("mine", pose_by_name("F").joints))
    outcome = cli.ok(f"hand mine.toml -o whole.ply --edge-mm {EDGE_MM}")
    assert "hand 'mine'" in outcome.out
    whole = Scene.from_mesh("whole.ply")
    assert whole.digest() == Scene.from_mesh(made / "hand.ply").digest()
    cli.ok(
        f"hand F -o small.ply --edge-mm {EDGE_MM} --length-mm 165 --breadth-mm 75 --girth 0.95 "
        "--finger-lengths 1 1 1.02 1 0.98"
    )
    small = Scene.from_mesh("small.ply")
    extents = [np.ptp(scene.vertices_m, axis=0) for scene in (whole, small)]
    # Length and breadth are 0.88 of the default's; the hand is a stub of forearm longer.
    assert (extents[1][:2] / extents[0][:2] < 0.92).all()
    cli.fails("hand F -o x.ply --length-mm 30", "length_m")
    Path("mine.toml").write_text('name = "x"\n[joints.elbow]\nflexion_deg = 1', encoding="utf-8")
    cli.fails("hand mine.toml -o x.ply", "mine.toml", "elbow")


def test_a_turned_hand(cli, made):
    cli.ok(f"hand F -o turned.ply --turn-deg 90 --edge-mm {EDGE_MM}")
    straight = Scene.from_mesh(made / "hand.ply").vertices_m
    # A quarter turn about x = 0, z = 0.3: +x comes to smaller z.
    expected = np.stack([straight[:, 2] - 0.3, straight[:, 1], 0.3 - straight[:, 0]], axis=1)
    # Both files hold float32: half an ulp each of coordinates below 0.5 m.
    found = Scene.from_mesh("turned.ply").vertices_m
    np.testing.assert_allclose(found, expected, rtol=0, atol=2 * 2.0**-25)


def test_files_keep_parts_and_texture(made):
    """So that the roughness of a simulation from the file is that of the hand in memory."""
    hand, scene = hand_mesh("F", float(EDGE_MM) / 1e3), Scene.from_mesh(made / "hand.ply")
    assert scene.n_faces == len(hand.faces)
    assert set(scene.part_names) == set(hand.part_names)
    assert np.array_equal(scene.part, hand.part)
    # The file holds float32: half an ulp of coordinates below 0.25 m.
    np.testing.assert_allclose(scene.texture_m, hand.texture_m, rtol=0, atol=2.0**-27)


def test_known_materials_are_listed(cli):
    outcome = cli.ok("materials")
    table, sources = outcome.out.split(
        "at normal incidence, 72 to 82 GHz, phase in degrees; sources:"
    )
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


def test_own_materials(cli):
    resin = Material("resin", PermittivityTable([75e9, 80e9], [2.9 - 0.04j, 2.8 - 0.06j]))
    paint = Material("paint", conductor=True, coating=Coating(1e-4, 3.5), source="[bold]guess")
    write_materials("lab.toml", [resin])
    write_materials("more.json", [paint, Material("air", 1.0, micro_roughness_rms_m=1e-5)])
    line = "materials lab.toml more.json --band-ghz 76:79"
    printed = cli.ok(line).out
    assert [line.split()[0] for line in printed.splitlines()[2:5]] == ["resin", "paint", "air"]
    for part in ("resin: not stated\npaint: [bold]guess", "h_micro mm", "-inf"):
        assert part in printed
    records = json.loads(cli.ok(f"{line} --json").out)
    assert [material_of(record["material"]) for record in records][:2] == [resin, paint]
    assert records[0]["band_hz"] == [76e9, 79e9]
    assert records[0]["permittivity_at_middle"] == pytest.approx([2.85, -0.05], abs=1e-12)
    # 1 - 2 n / (1 + n) at both ends.
    indices = [(2.88 - 0.044j) ** 0.5, (2.82 - 0.056j) ** 0.5]
    ends = [20 * math.log10(abs((1 - n) / (1 + n))) for n in indices]
    assert sorted(records[0]["reflectance_db"]) == pytest.approx(sorted(ends), abs=1e-9)
    assert records[2]["reflectance_db"] == [None, None]
    cli.fails("materials lab.toml", "material resin: permittivity", "75 to 80 GHz", "72 to 82")


def test_widths_of_an_array_are_not_called_its_resolution(cli):
    Path("cross.toml").write_text(
        "[[tx]]\nline = { first_m = [-0.0275, 0, 0], last_m = [0.0275, 0, 0], n = 6 }\n"
        "[[rx]]\nline = { first_m = [0, -0.0375, 0], last_m = [0, 0.0375, 0], n = 5 }\n"
    )
    line = "array cross.toml --band 60:62:5 --within-deg 10"
    found = json.loads(cli.ok(f"{line} --json").out)
    assert len(found["widths_m"]) == 3
    assert "resolution_m" not in found
    printed = cli.ok(line).out
    assert "widths at -3 dB: x " in printed
    assert "resolution in range c/2B 74.9 mm" in printed
