"""Every example runs beside what the others wrote, and prints the expected results."""

import re
import runpy
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
from dataset_plans import tiny

from clradar.dataset import run
from clradar.dataset.plan.plan import plan_from

GLINTS_MM = {"left": (-93.5, 46.8, 420.9), "right": (113.6, -37.9, 520.8)}
"""Where the line from the centre of tutorial 7's array to the centre of a ball meets the ball."""

OutputOf = Callable[..., list[str]]

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder for all examples, one after the other."""
    return tmp_path_factory.mktemp("examples")


@pytest.fixture
def output_of(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> OutputOf:
    """Run an example in the folder of all; its output."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")

    def run(name: str, *pictures: str, arguments: tuple[str, ...] = ()) -> list[str]:
        path = str(EXAMPLES / name)
        monkeypatch.setattr(sys, "argv", [path, *arguments])
        capsys.readouterr()
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            runpy.run_path(path, run_name="__main__")
        for picture in pictures:
            assert (folder / picture).read_bytes().startswith(b"\x89PNG")
        return capsys.readouterr().out.splitlines()

    return run


def numbers(line: str) -> list[float]:
    return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", line)]


def test_all_are_tried():
    assert {p.stem for p in EXAMPLES.glob("*.py")} == {"train_letters"}
    tutorials = [p.stem.split("_")[0] for p in (EXAMPLES / "tutorials").glob("*.py")]
    assert sorted(tutorials) == sorted(["7a", *map(str, range(1, 11))])


@pytest.mark.slow
def test_train_letters_and_poses(folder, tmp_path, output_of):
    """A fist and a flat hand are distinguished from a few samples, and their angles found."""
    plan = plan_from(
        tiny(
            samples=24,
            poses={"names": ["A", "B"]},
            hands={"handedness": "right"},
            radar={"every": 4},
            image={"step_mm": 5},
            output={"shard_size": 24, "products": ["max_projection", "depth_map"]},
        ),
        "plan",
        tmp_path,
    )
    run(plan, folder / "letters")
    right = output_of("train_letters.py", "confusion.png", arguments=("letters",))[0]
    # 5 of 6: guessing is right as often once in nine times, and the seed is fixed.
    assert numbers(right)[0] == 6
    assert numbers(right)[1] >= 0.8


def test_tutorial_first_image(output_of):
    pixels, depth_mm = numbers(output_of("tutorials/1_first_image.py", "first_image.png")[-1])
    # 2 mm pixels of 4 mm^2: the hand's outline has about 10 000 mm^2, of which a part is visible.
    assert 500 < pixels < 2500
    assert 280 < depth_mm < 320


def test_tutorial_recording_to_image(output_of):
    lines = output_of("tutorials/2_recording_to_image.py", "recording.png")
    assert "  s_real  (64, 24, 20) float64" in lines
    assert "[frequency]" in lines
    assert "Nothing to change: the capture is in clradar's convention." in lines
    # Within a voxel of 2 mm.
    for value, expected in zip(numbers(lines[-1]), (20, -10, 250), strict=True):
        assert abs(value - expected) <= 2


@pytest.mark.slow
def test_tutorial_maroon(output_of):
    """The recording is written by the tutorial, which is given none."""
    lines = output_of("tutorials/3_maroon_recording.py", "maroon.png")
    assert lines[-3:-1] == ["frame 0 at 125000 us", "frame 1 at 250000 us"]
    assert numbers(lines[-1])[0] > 0.9


@pytest.mark.slow
def test_tutorial_simulation_beside_recording(output_of):
    *_, given, registered = output_of(
        "tutorials/4_simulation_beside_recording.py", "beside_recording.png"
    )
    assert numbers(registered)[0] > max(0.95, numbers(given)[0] + 0.1)


def test_tutorial_channel_calibration(output_of):
    recorded, corrected = output_of("tutorials/5_channel_calibration.py", "channels.png")
    assert numbers(recorded)[0] < 0.5
    assert numbers(corrected)[0] > 0.9


@pytest.mark.slow
def test_tutorial_dataset_to_classifier(output_of):
    lines = output_of("tutorials/6_dataset_to_classifier.py", "hands.png")
    right, new = numbers(lines[-1])
    # Guessing has 7 of 8 right once in 28 times, and the seed is fixed.
    assert new == 8
    assert right >= 7


@pytest.mark.slow
def test_tutorial_own_array(output_of):
    lines = output_of("tutorials/7_own_array.py", "own_array.png")
    # Half a voxel is 2.5 mm, and c / 2B is 75 mm: a tenth of that for what the array's size does to
    # the glint.
    for line, (name, glint) in zip(lines[-2:], GLINTS_MM.items(), strict=True):
        assert line.startswith(name)
        for value, expected in zip(numbers(line), glint, strict=True):
            assert abs(value - expected) <= 10


@pytest.mark.slow
def test_tutorial_other_radar(output_of):
    lines = output_of("tutorials/7a_other_radar.py", "other_radar.png", "cross60.png")
    _, _, lobe, in_grid, alias, place = lines
    # asin(4.835 mm / 5 mm) = 75.2 degrees.
    assert numbers(lobe)[0] == 75
    assert in_grid.startswith("the array has a grating lobe in the grid")
    assert "is the alias of an echo at" in alias
    assert numbers(place) == [0, 0, 1]


@pytest.mark.slow
def test_tutorial_physical_surfaces(output_of):
    ball, skin, smooth, rough, rougher = output_of(
        "tutorials/8_physical_surfaces.py", "roughness.png"
    )
    theory_dbsm, read_dbsm = numbers(ball)
    assert -1.5 < read_dbsm - theory_dbsm < 0.5
    by_reflection_db, of_skin_dbsm = numbers(skin)
    # Reflection at other angles than facing, and what is rounded.
    assert abs(of_skin_dbsm - read_dbsm - by_reflection_db) < 0.5
    # Speckle that is fully developed has the contrast 1.
    assert numbers(smooth)[-1] < numbers(rough)[-1] < numbers(rougher)[-1] < 1.1
    assert numbers(rougher)[-1] > 0.5


@pytest.mark.slow
def test_tutorial_hand_from_capture(output_of):
    """The index finger, whose tip starts 30 mm off, is found within a quarter of that."""
    lines = output_of("tutorials/9_hand_from_capture.py", "hand_from_capture.png")
    tips = dict(line.split(": ", 1) for line in lines[-5:])
    assert list(tips) == ["thumb", "index", "middle", "ring", "pinky"]
    assert numbers(tips["index"])[0] < 7.5


@pytest.mark.slow
def test_tutorial_moving_hand(output_of):
    rests, moves, way, alike = output_of("tutorials/10_moving_hand.py", "moving_hand.png")[-4:]
    assert numbers(rests)[1] < numbers(moves)[1]
    assert numbers(way)[0] > 5.0
    assert numbers(alike)[0] < 0.95
