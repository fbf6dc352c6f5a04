"""The command that fits a hand: its folder, its tables, its refusals. The fit itself is made up."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import GRID, Cli
from hand_fits import UNTOLD, made_up_fit
from mano_files import mano_model, mano_pickle
from rig_files import RigMaker

import calibration
import clradar
from calibration import HandFit
from calibration.hand_fit.starts import read_start
from clradar.cli.commands import fit_hand as command
from clradar.cli.commands.fit_hand import FILES
from clradar.cli.comparison import CAPTURE, VOLUME
from clradar.cli.outputs import write
from clradar.cli.tables import digit_rows
from clradar.files.json_file import write_json
from clradar.hand import HandShape, read_pose
from clradar.model import Volume
from measurement_io import open_capture, open_volume

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
    assert open_volume(folder / VOLUME).grid.same_voxels(open_volume("volume.h5").grid)
    assert open_capture(folder / CAPTURE).meta["command"] == "fit-hand"
    for name in ("overlay.png", "comparison.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    start = read_start(folder)
    assert start.transform is not None
    assert np.array_equal(start.transform, FIT.transform)
    # The tables: a tip with its standard deviation, what is not told, the other basin.
    lines = [line.split("  ") for line in printed.splitlines()]
    rows = {line[0].strip(): [cell.strip() for cell in line[1:] if cell.strip()] for line in lines}
    x, y, z = 1e3 * FIT.tips_m[1]
    told = ["5.0", "no", "3 of 4", "phalanx-distal flexion"]
    assert rows["index"] == [f"{x:.1f}, {y:.1f}, {z:.1f}", *told]
    assert rows["palm"] == ["2 of 2"]
    assert rows["2"][:3] == ["D", "right", "130.0"]
    assert "Simulated there, the overlap is 0.95." in printed


@pytest.mark.usefixtures("record_alone")
def test_what_the_options_say_goes_into_the_fit(cli, calls):
    cli.ok(
        "fit-hand volume.h5 --pose F,l --hand left --fit-shape --alpha 0.2 --quick --seed 5 "
        "--angle-std-deg 9 --search-deg 60 --length-mm 180 --girth 0.95 -o fit"
    )
    (call,) = calls
    assert [start.pose.name for start in call.pop("pose")] == ["F", "L"]
    assert call.pop("shape") == HandShape(length_m=0.18, girth=0.95)
    assert call.pop("measured").grid.same_voxels(open_volume("volume.h5").grid)
    assert isinstance(call.pop("device"), clradar.Device)
    assert call.pop("array").name == "qar50"
    assert call.pop("waveform").same_frequencies(clradar.Waveform.sfcw(72e9, 82e9, 128))
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


def test_untold_angles_are_in_the_table_of_their_digit():
    rows = {row[0]: row for row in digit_rows(FIT)}
    assert set(rows) == {"thumb", "index", "middle", "ring", "pinky", "palm"}
    assert rows["thumb"][4:] == ["4 of 5", "phalanx-distal flexion"]
    assert len(UNTOLD) == 2
    assert all(rows[digit][5] == "" for digit in ("middle", "ring", "pinky", "palm"))
    doubted = digit_rows(made_up_fit(overlap=0.7))
    assert all(row[4].startswith("0 of ") for row in doubted)
    assert doubted[0][5] == "phalanx-distal flexion"
