"""``clradar hand``, ``clradar materials`` and ``clradar fit-hand``, whose fits are made up."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import EDGE_MM, GRID, Cli
from hand_fits import made_up_fit
from mano_files import mano_model, mano_pickle
from rig_files import RigMaker

import calibration
import clradar
from calibration import HandFit
from calibration.hand_fit.starts import read_start
from clradar import Coating, Material, PermittivityTable, Scene, write_materials
from clradar.cli.commands import fit as command
from clradar.cli.commands.fit import FITTED as FILES
from clradar.cli.outputs import write
from clradar.files.json_file import write_json
from clradar.hand import HandPose, HandShape, hand_mesh, pose_by_name, read_pose, write_pose
from clradar.model import Volume
from clradar.model.known_materials import KNOWN
from clradar.model.material_file import material_of
from measurement_io import open_capture, open_volume


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
    line = "array cross.toml --band 60:62:5"
    found = json.loads(cli.ok(f"{line} --json").out)
    assert len(found["widths_m"]) == 3
    assert "resolution_m" not in found
    printed = cli.ok(line).out
    assert "widths at -3 dB: x " in printed
    assert "resolution in range c/2B 74.9 mm" in printed


Calls = list[dict[str, Any]]
FIT = made_up_fit()


@pytest.fixture
def calls(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> Calls:
    """What `calibration.fit_hand` is called with; it returns a made-up fit."""
    received: Calls = []

    def fit(measured: Volume, **settings: Any) -> HandFit:
        received.append({"measured": measured, **settings})
        return FIT

    monkeypatch.setattr(calibration, "fit_hand", fit)
    # The letter F, as it was simulated already; it stands for the letter of the start, too.
    capture, volume = open_capture("sim.h5"), open_volume("volume.h5")
    monkeypatch.setattr(clradar, "simulate", lambda *_, **__: capture)
    monkeypatch.setattr(clradar, "backproject", lambda *_, **__: volume)
    return received


@pytest.fixture
def record_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Writes fit.json and no pictures, which take most of the time."""

    def written(folder: Path, measured: object, fit: HandFit, *rest: Any) -> None:
        write(folder / "fit.json", fit.to_dict())

    monkeypatch.setattr(command, "write_hand_fit", written)


def record_of(folder: str) -> dict[str, Any]:
    return json.loads((Path(folder) / "fit.json").read_text())


def test_a_folder_with_all_that_was_found(cli, calls):
    printed = cli.ok(f"fit-hand sim.h5 --pose L -o fit {GRID}").out
    folder = Path("fit")
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    assert read_pose(folder / "pose.toml").name == "F, fitted to sim.h5"
    record = record_of("fit")
    assert record["transform"] == FIT.transform.tolist()
    assert (record["command"], record["options"]["pose"]) == ("fit-hand", "L")
    assert [one["file"] for one in record["inputs"]] == ["sim.h5"]
    placed = clradar.Scene.from_mesh(folder / "placed.ply")
    assert placed.part_names == FIT.scene.part_names
    assert placed.texture_m is not None
    # float32 in metres: 2^-24 of 0.4 m is 2.4e-8.
    np.testing.assert_allclose(placed.vertices_m, FIT.scene.vertices_m, rtol=0.0, atol=1e-7)
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["after"]["overlap"] == metrics["before"]["overlap"] == pytest.approx(1.0)
    assert open_volume(folder / "volume.h5").grid.same_voxels(open_volume("volume.h5").grid)
    assert open_capture(folder / "capture.h5").meta["command"] == "fit-hand"
    for name in ("overlay.png", "comparison.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    start = read_start(folder)
    assert start.transform is not None
    assert np.array_equal(start.transform, FIT.transform)
    assert FIT.report() in printed


@pytest.mark.usefixtures("record_alone")
def test_what_the_options_say_goes_into_the_fit(cli, calls):
    cli.ok(
        "fit-hand volume.h5 --pose F,l --hand left --fit-shape --alpha 0.2 --quick --seed 5 "
        "--angle-std-deg 9 --search-deg 60 --length-mm 180 --girth 0.95 --band 70:82:64 -o fit"
    )
    (call,) = calls
    assert [start.pose.name for start in call.pop("pose")] == ["F", "L"]
    assert call.pop("shape") == HandShape(length_m=0.18, girth=0.95)
    assert call.pop("measured").grid.same_voxels(open_volume("volume.h5").grid)
    assert isinstance(call.pop("device"), clradar.Device)
    assert call.pop("array").name == "qar50"
    assert call.pop("waveform").same_frequencies(clradar.Waveform.sfcw(70e9, 82e9, 64))
    assert call == {
        "handedness": "left",
        "fit_shape": True,
        "alpha": 0.2,
        "closed_loop": False,
        "angle_std_deg": 9.0,
        "search_deg": 60.0,
        "seed": 5,
        "progress": None,
    }


@pytest.mark.usefixtures("record_alone")
@pytest.mark.parametrize("name", ["left.glb", "MANO_LEFT.pkl"])
def test_a_rig_is_fitted_as_the_hand_that_it_is(cli, calls, name):
    if name.endswith(".glb"):
        RigMaker(turn=np.diag([-1.0, 1.0, 1.0])).save(Path(name))
    else:
        Path(name).write_bytes(mano_pickle(mano_model("left")))
    cli.ok(f"fit-hand volume.h5 --rig {name} -o fit")
    (call,) = calls
    assert (call["rig"].handedness, call["handedness"]) == ("left", "left")
    assert "shape" not in call
    assert [file["file"] for file in record_of("fit")["inputs"]] == ["volume.h5", name]


@pytest.mark.usefixtures("record_alone")
def test_a_fit_goes_on_from_an_earlier_one(cli, calls):
    Path("one").mkdir()
    write_json("one/fit.json", FIT.to_dict(), force=False)
    cli.ok("fit-hand volume.h5 --pose one -o two")
    ((start,),) = (call["pose"] for call in calls)
    assert start.transform.tolist() == FIT.transform.tolist()
    assert (start.name, start.pose.name) == ("one", "F")
    assert [file["file"] for file in record_of("two")["inputs"]] == ["volume.h5", "fit.json"]
    wrong = "fit-hand volume.h5 --pose one --hand left -o x"
    cli.fails(wrong, "expected right, as in --pose, got 'left'", status=2)
    # A file that is no result is not replaced, not even with --force.
    again = "fit-hand volume.h5 -o two"
    cli.fails(again, "holds files already")
    Path("two/notes.txt").write_text("mine")
    cli.fails(f"{again} --force", "holds 'notes.txt', which --force would delete")
    Path("two/notes.txt").unlink()
    cli.ok(f"{again} --force")
    assert len(calls[-1]["pose"]) == 24
