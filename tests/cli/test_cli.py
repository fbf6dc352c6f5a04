"""The command line: outputs, refusals and messages."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import clradar
from clradar.cli import comparison, console, main, outputs
from clradar.cli.commands import simulate as simulate_command
from clradar.cli.launcher import COMMANDS
from clradar.cli.options.imaging import GridOptions, axis_mm
from clradar.cli.options.simulation import PlacementOptions
from clradar.errors import ClradarError, DeviceError, MeshError, ModelError, OutputError
from clradar.files.hashing import sha256_of
from measurement_io import (
    open_capture,
    open_volume,
    save_capture,
    save_maroon_frame,
    save_volume,
)

EDGE_MM = "4"
DENSITY = "0.2"
GRID = ("--x-mm", "-60:60:6", "--y-mm", "-90:90:6", "--z-mm", "280:320:5")
"""21 x 31 x 9 voxels: no finer than the SSIM's window of 11 pixels needs."""

HEAVY = ("trimesh", "scipy", "skimage", "matplotlib", "h5py", "measurement_io", "rich.progress")
"""Modules that a help text does not need."""


@pytest.fixture(autouse=True)
def _device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")


Run = Callable[..., "Outcome"]


class Outcome:
    """Exit status and both streams of one command."""

    def __init__(self, status: int, out: str, err: str) -> None:
        self.status, self.out, self.err = status, out, err


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: object) -> Outcome:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([str(a) for a in arguments])
        captured = capsys.readouterr()
        code = ended.value.code
        return Outcome(0 if code is None else int(code), captured.out, captured.err)

    return call


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a hand, a capture, its volume, and a recording of the same data."""
    folder = tmp_path_factory.mktemp("made")
    commands = [
        ["hand", "F", "-o", "hand.ply", "--edge-mm", EDGE_MM],
        ["hand", "F", "-o", "parts.glb", "--edge-mm", EDGE_MM],
        ["simulate", "hand.ply", "-o", "sim.h5", "--samples-per-mm2", DENSITY, "--steps", "16",
         "--alpha", "0.4", "--seed", "7"],
        ["image", "sim.h5", "-o", "volume.h5", *GRID],
    ]  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLRADAR_DEVICE", "pocl")
        patch.chdir(folder)
        for command in commands:
            with pytest.raises(SystemExit) as ended:
                main(command)
            assert ended.value.code in (0, None), command
        save_maroon_frame("recording", open_capture("sim.h5"))
        yield folder


def one_error_line(outcome: Outcome, *parts: str) -> None:
    assert outcome.status == 1, outcome.err
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("clradar: error: ")
    for part in parts:
        assert part in lines[0]


def in_process(code: str, *arguments: str, **kwargs: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        **kwargs,
    )


# Help, version, imports


def test_help_lists_the_commands_there_are(run: Run) -> None:
    outcome = run("--help")
    assert outcome.status == 0
    listed = outcome.out.split("Commands:")[1]
    for name in COMMANDS:
        assert f"  {name}" in listed


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_each_command(run: Run, name: str) -> None:
    outcome = run(name, "--help")
    assert (outcome.status, outcome.err) == (0, "")
    text = " ".join(outcome.out.split())
    assert text.startswith(f"Usage: clradar {name}")
    assert COMMANDS[name] in text


def test_bench_says_which_peer_is_missing(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("clradar.bench")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "finufft", None)
    outcome = run("bench", "--quick")
    assert outcome.status == 1
    assert "finufft is not installed" in outcome.err
    assert "clradar[bench]" in outcome.err


def test_version(run: Run) -> None:
    outcome = run("--version")
    assert (outcome.status, outcome.out) == (0, f"clradar {clradar.__version__}\n")


@pytest.mark.parametrize("arguments", [["--help"], ["simulate", "--help"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys, clradar\n"
        "before = set(sys.modules)\n"
        "from clradar.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as e:\n    assert not e.code\n"
        "print('\\n' + ' '.join(set(sys.modules) - before))"
    )
    done = in_process(code, *arguments)
    assert done.returncode == 0, done.stderr
    new = set(done.stdout.splitlines()[-1].split())
    assert not [name for name in new if name.split(".")[0] in HEAVY or name in HEAVY]
    assert "clradar.cli.launcher" in new
    others = {f"clradar.cli.commands.{name}" for name in COMMANDS if name != arguments[0]}
    assert not others & new


# Exit status


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["nonsense"], "nonsense"),
        (["hand"], "-o"),
        (["hand", "-o", "x.ply", "--edge-mm", "long"], "--edge-mm"),
        (["simulate", "hand.ply"], "--output"),
        (["simulate", "-o", "x.h5"], "MESH"),
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "1.5"], "[0, 1]"),
        (["simulate", "hand.ply:1.5", "-o", "x.h5"], "[0, 1]"),
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "nan"], "[0, 1]"),
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "rough"], "--alpha"),
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "0", "--alpha", "1"], "--alpha"),
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "a=0", "--alpha", "a=1"], "twice"),
        (["simulate", "hand.ply", "-o", "x.h5", "--unit", "inch"], "--unit"),
        (["image", "sim.h5", "-o", "x.h5", "--x-mm", "10:0:1"], "--x-mm"),
        (["image", "sim.h5", "-o", "x.h5", "--y-mm", "0:10"], "--y-mm"),
        (["image", "sim.h5", "-o", "x.h5", "--z-mm", "0:10:3"], "0:9:3"),
        (["image", "sim.h5", "-o", "x.h5", "--z-mm", "0:nan:3"], "--z-mm"),
        (["image", "sim.h5", "-o", "x.h5", "--method", "quick"], "--method"),
        (["compare", "volume.h5"], "SIMULATED"),
        (["compare", "volume.h5", "volume.h5", "--x-mm", "0:60:6"], "no capture"),
        (["inspect", "volume.h5", "--loud"], "--loud"),
    ],
)
def test_wrong_usage_is_2(
    run: Run, made: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], part: str
) -> None:
    monkeypatch.chdir(made)
    outcome = run(*arguments)
    assert outcome.status == 2
    assert part in outcome.err
    assert "Traceback" not in outcome.err
    assert not Path("x.h5").exists()


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["simulate", "none.ply", "-o", "x.h5"], ("none.ply", "expected a mesh file")),
        (["simulate", "two\nlines.ply", "-o", "x.h5"], ("two lines.ply",)),
        (["simulate", "hand.ply", "-o", "x.h5", "--unit", "mm"], ("unit='mm'", "did you mean")),
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "nail=0"], ("hand.ply", "nail")),
        (["simulate", "hand.ply", "-o", "x.h5", "--device", "abacus"], ("abacus",)),
        (["hand", "-o", "x.ply", "--device", "abacus"], ("abacus",)),
        (["simulate", "hand.ply", "-o", "x.h5", "--samples-per-mm2", "-1"], ("positive",)),
        (["simulate", "hand.ply", "-o", "no/x.h5"], ("no/x.h5", "folder")),
        (["simulate", "hand.ply", "-o", "."], ("folder",)),
        (["simulate", "hand.ply", "-o", "hand.ply", "--force"], ("also an input",)),
        (["hand", "J", "-o", "x.ply"], ("pose", "'J'")),
        (["hand", "F", "-o", "x.stp"], (".ply", "'.stp'")),
        (["image", "hand.ply", "-o", "x.h5"], ("hand.ply", "something else")),
        (["image", "volume.h5", "-o", "x.h5"], ("expected a capture", "a volume")),
        (["image", "sim.h5", "-o", "x.h5", "--png", "x.bmp"], (".png", "'.bmp'")),
        (["image", "sim.h5", "-o", "x.png", "--png", "x.png"], ("twice",)),
        (["image", "sim.h5", "-o", "x.h5", "--dynamic-range-db", "0"], ("positive",)),
        (["convert", "recording", "-o", "x.h5", "--frame", "5"], ("frame 5",)),
        (["convert", "sim.h5", "-o", "x.h5", "--frame", "1"], ("one file",)),
        (["inspect", "none.h5"], ("none.h5",)),
        (["inspect", "none.h5", "--check"], ("none.h5",)),
        (["compare", "volume.h5", "none.h5", "-o", "x.png"], ("none.h5",)),
        (["compare", "volume.h5", "volume.h5", "--report", "x.pdf"], (".html", "'.pdf'")),
        (
            ["compare", "volume.h5", "sim.h5", "--x-mm", "0:60:6", *GRID[2:], "-o", "x.png"],
            ("same pixels",),
        ),
    ],
)
def test_an_error_is_1_and_one_line(
    run: Run, made: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], parts: list[str]
) -> None:
    monkeypatch.chdir(made)
    before = sorted(made.iterdir())
    one_error_line(run(*arguments), *parts)
    assert sorted(made.iterdir()) == before


@pytest.mark.parametrize("place", [0, 1, 4])
def test_debug_shows_the_traceback(place: int, tmp_path: Path) -> None:
    arguments = ["simulate", "none.ply", "-o", str(tmp_path / "x.h5")]
    arguments.insert(place, "--debug")
    with pytest.raises(MeshError, match=r"none\.ply"):
        main(arguments)


def test_debug_after_two_dashes_is_a_name(run: Run, tmp_path: Path) -> None:
    one_error_line(run("simulate", "-o", tmp_path / "x.h5", "--", "--debug"), "--debug")


def test_an_unexpected_error_names_its_type(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("first line\nsecond line")

    monkeypatch.setattr("clradar.hand.hand_mesh", broken)
    outcome = run("hand", "-o", tmp_path / "x.ply")
    one_error_line(outcome, "ZeroDivisionError: first line second line", "--debug")


def test_control_c_is_130_without_a_traceback(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys, clradar.hand\n"
        "def interrupted(*a, **k):\n    os.kill(os.getpid(), signal.SIGINT)\n    return 1 / 0\n"
        "clradar.hand.hand_mesh = interrupted\n"
        "from clradar.cli import main\nmain(sys.argv[1:])"
    )
    done = in_process(code, "hand", "-o", str(tmp_path / "x.ply"))
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


# Nothing is overwritten


@pytest.mark.parametrize(
    ("arguments", "target"),
    [
        (["hand", "-o", "{}", "--edge-mm", EDGE_MM], "a.ply"),
        (
            ["simulate", "hand.ply", "--samples-per-mm2", DENSITY, "--steps", "2", "-o", "{}"],
            "a.h5",
        ),
        (["image", "sim.h5", *GRID, "-o", "{}"], "a.h5"),
        (["image", "sim.h5", *GRID, "-o", "b.h5", "--force", "--png", "{}"], "a.png"),
        (["convert", "recording", "-o", "{}"], "a.h5"),
        (["compare", "volume.h5", "sim.h5", "-o", "{}"], "a.png"),
        (["compare", "volume.h5", "sim.h5", "--json", "{}"], "a.json"),
        (["compare", "volume.h5", "sim.h5", "--report", "{}"], "a.html"),
    ],
)
def test_a_file_is_kept_without_force(
    run: Run,
    made: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    target: str,
) -> None:
    monkeypatch.chdir(made)
    kept = tmp_path / target
    kept.write_bytes(b"precious")
    command = [a.format(kept).replace("b.h5", str(tmp_path / "b.h5")) for a in arguments]
    with monkeypatch.context() as patch:
        # Refused before the work starts: none of these may be reached.
        for name in ("simulate", "backproject", "open_device"):
            patch.setattr(clradar, name, None)
        patch.setattr("clradar.hand.hand_mesh", None)
        one_error_line(run(*(a for a in command if a != "--force")), target, "--force")
    assert kept.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [kept]
    outcome = run(*command, *([] if "--force" in command else ["--force"]))
    assert outcome.status == 0, outcome.err
    assert kept.read_bytes() != b"precious"
    assert not [p.name for p in tmp_path.iterdir() if p.name.endswith(".tmp")]


def test_a_dangling_link_is_kept(run: Run, tmp_path: Path) -> None:
    link = tmp_path / "x.ply"
    link.symlink_to(tmp_path / "nowhere")
    one_error_line(run("hand", "-o", link), "exists already")


def test_check_outputs_sees_through_links(tmp_path: Path) -> None:
    (tmp_path / "in.h5").write_bytes(b"")
    (tmp_path / "link.h5").symlink_to(tmp_path / "in.h5")
    with pytest.raises(OutputError, match="also an input"):
        outputs.check_outputs([tmp_path / "link.h5"], force=True, inputs=[tmp_path / "in.h5"])
    with pytest.raises(OutputError, match="cannot be written"):
        outputs.check_outputs([tmp_path / ("x" * 5000)], force=False)
    outputs.check_outputs([None, tmp_path / "new.h5"], force=False)


# Messages


def test_a_pipe_sees_no_progress_and_a_terminal_does(made: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "clradar.cli", "simulate", str(made / "hand.ply"),
               "--samples-per-mm2", DENSITY, "--steps", "2", "-o"]  # fmt: skip
    # PoCL's compiler writes to stderr when it builds a kernel for the first time; here it has been.
    piped = subprocess.run(
        [*command, str(tmp_path / "a.h5")], capture_output=True, timeout=600, check=True
    )
    assert piped.stderr == b""
    assert b"\x1b" not in piped.stdout
    assert piped.stdout.count(b"\n") == 1

    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [*command, str(tmp_path / "b.h5")], stdout=subprocess.PIPE, stderr=theirs
    ) as process:
        os.close(theirs)
        shown = b""
        while True:
            try:
                block = os.read(ours, 4096)
            except OSError:  # how Linux reports that the other end is closed
                break
            if not block:
                break
            shown += block
        os.close(ours)
        assert process.stdout is not None
        process.stdout.read()
    assert process.returncode == 0
    assert b"tracing" in shown


def test_a_table_in_a_pipe_is_not_cut(capsys: pytest.CaptureFixture[str]) -> None:
    long = "a [bold]name[/bold] " + 60 * "with words "
    console.print_table(("one", "two"), [(long, "1"), ("line\nbreak", "2")], right=("two",))
    lines = capsys.readouterr().out.splitlines()
    assert long.strip() in lines[2]
    assert "line break" in lines[3]


def test_error_lines_are_printable(capsys: pytest.CaptureFixture[str]) -> None:
    console.print_error("a\n\tb \x1b[31m \udcff")
    assert capsys.readouterr().err == "clradar: error: a b \\x1b[31m \\udcff\n"


def test_devices_marks_the_one_that_is_used(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = run("devices")
    assert outcome.status == 0
    (marked,) = [line for line in outcome.out.splitlines() if line.startswith("*")]
    assert "Portable Computing Language" in marked
    for column in ("selector", "name", "platform", "kind", "memory", "units"):
        assert column in outcome.out
    monkeypatch.setenv("CLRADAR_DEVICE", "abacus")
    outcome = run("devices")
    one_error_line(outcome, "CLRADAR_DEVICE", "abacus")
    assert "Portable Computing Language" in outcome.out


def test_devices_without_opencl(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise DeviceError("no OpenCL platform was found")

    monkeypatch.setattr("clradar.opencl.device.list_devices", none)
    one_error_line(run("devices"), "no OpenCL platform")


# hand


def test_hand_lists_its_poses(run: Run) -> None:
    outcome = run("hand", "--list")
    assert outcome.status == 0
    assert {"A", "F", "Y", "0", "9", "flat"} <= set(outcome.out.split())
    assert "Fist with the thumb across the front of the fingers." in outcome.out


def test_a_hand_of_a_pose_file_and_of_another_size(run: Run, made: Path, tmp_path: Path) -> None:
    from clradar.hand import HandPose, pose_by_name, write_pose

    pose = tmp_path / "mine.toml"
    write_pose(pose, HandPose("mine", pose_by_name("F").joints))
    whole, small = tmp_path / "whole.ply", tmp_path / "small.ply"
    outcome = run("hand", pose, "-o", whole, "--edge-mm", EDGE_MM)
    assert outcome.status == 0, outcome.err
    assert "hand 'mine'" in outcome.out
    same = clradar.Scene.from_mesh(made / "hand.ply")
    assert clradar.Scene.from_mesh(whole).digest() == same.digest()
    outcome = run("hand", "F", "-o", small, "--edge-mm", EDGE_MM, "--length-mm", "165",
                  "--breadth-mm", "75", "--girth", "0.95",
                  "--finger-lengths", "1", "1", "1.02", "1", "0.98")  # fmt: skip
    assert outcome.status == 0, outcome.err
    extents = [np.ptp(clradar.Scene.from_mesh(path).vertices_m, axis=0) for path in (whole, small)]
    # Length and breadth are 0.88 of the default's; the hand is a stub of forearm longer.
    assert (extents[1][:2] / extents[0][:2] < 0.92).all()
    one_error_line(run("hand", "F", "-o", tmp_path / "x.ply", "--length-mm", "30"), "length_m")
    pose.write_text('name = "x"\n[joints.elbow]\nflexion_deg = 1', encoding="utf-8")
    one_error_line(run("hand", pose, "-o", tmp_path / "x.ply"), "mine.toml", "elbow")


def test_a_left_hand_is_the_mirror_image(run: Run, made: Path, tmp_path: Path) -> None:
    left = tmp_path / "left.stl"
    outcome = run("hand", "f", "-o", left, "--left", "--edge-mm", EDGE_MM,
                  "--center-mm", "10", "-5", "400")  # fmt: skip
    assert outcome.status == 0, outcome.err
    ours = clradar.Scene.from_mesh(left).triangles_m.reshape(-1, 3)
    right = clradar.Scene.from_mesh(made / "hand.ply").triangles_m.reshape(-1, 3)
    expected = right * [-1, 1, 1] + [0.010, -0.005, 0.100]
    # Both files hold float32: half an ulp each of coordinates below 0.5 m.
    tolerance = 2 * 2.0**-25
    assert np.allclose(ours.min(axis=0), expected.min(axis=0), rtol=0, atol=tolerance)
    assert np.allclose(ours.max(axis=0), expected.max(axis=0), rtol=0, atol=tolerance)
    assert np.allclose(ours.mean(axis=0), expected.mean(axis=0), rtol=0, atol=tolerance)


def test_a_turned_hand(run: Run, made: Path, tmp_path: Path) -> None:
    target = tmp_path / "turned.ply"
    outcome = run("hand", "F", "-o", target, "--turn-deg", "90", "--edge-mm", EDGE_MM)
    assert outcome.status == 0, outcome.err
    ours = clradar.Scene.from_mesh(target).vertices_m
    straight = clradar.Scene.from_mesh(made / "hand.ply").vertices_m
    # A quarter turn about x = 0, z = 0.3: +x comes to smaller z.
    expected = np.stack([straight[:, 2] - 0.3, straight[:, 1], 0.3 - straight[:, 0]], axis=1)
    # Both files hold float32: half an ulp each of coordinates below 0.5 m.
    assert np.allclose(ours, expected, rtol=0, atol=2 * 2.0**-25)


def test_a_glb_keeps_the_parts_apart(made: Path) -> None:
    parts = clradar.Scene.from_mesh(made / "parts.glb")
    whole = clradar.Scene.from_mesh(made / "hand.ply")
    assert set(parts.part_names) == {"palm", "thumb", "index", "middle", "ring", "pinky"}
    assert parts.n_faces == whole.n_faces


# simulate


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
    assert meta["options"]["waveform_ghz"] == [72.0, 82.0, 16]
    digest = sha256_of(made / "hand.ply")
    assert meta["inputs"] == [{"file": "hand.ply", "sha256": digest}]


def test_every_option_of_simulate_reaches_the_library(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    received: dict[str, Any] = {}

    def fake(scene: clradar.Scene, array: object, waveform: clradar.Waveform, **given: Any) -> None:
        received.update(given, waveform=waveform, scene=scene)
        raise ModelError("enough")

    monkeypatch.setattr(clradar, "simulate", fake)
    command = ("simulate", made / "hand.ply", "-o", tmp_path / "x.h5")
    outcome = run(
        *command, "--rays-per-face", 3,
        "--rays-per-sample", 2, "--reception-radius-mm", 5, "--max-bounces", 4, "--normals", "face",
        "--crease-deg", 12, "--amplitude", "spreading", "--pattern-exponent", 1.5, "--seed", 9,
        "--start-ghz", 24, "--stop-ghz", 26, "--steps", 11, "--device", "pocl",
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
        "amplitude": "spreading",
        "pattern_exponent": 1.5,
        "seed": 9,
        "estimator": "stochastic",
    }
    assert asdict(received["settings"]) == expected
    assert np.array_equal(received["waveform"].frequencies_hz, np.linspace(24e9, 26e9, 11))
    assert "portable" in received["device"].info.platform.lower()
    one_error_line(run(*command, "--estimator", "expected", "--samples-per-mm2", 2), "enough")
    settings = received["settings"]
    assert (settings.estimator, settings.samples_per_mm2) == ("expected", 2.0)


def test_alpha_by_mesh_and_by_part(made: Path) -> None:
    named = [simulate_command.split_alpha(str(made / n)) for n in ("hand.ply:0.2", "parts.glb")]
    default, by_part = simulate_command.read_alphas(["palm=0.6", "0.9", "thumb=0"])
    assert default == 0.9
    scene = simulate_command.load_scene(named, default, by_part, "m", None)
    alpha, part = np.asarray(scene.alpha), np.asarray(scene.part)
    for name, value in (("hand.ply", 0.2), ("palm", 0.6), ("thumb", 0.0), ("index", 0.9)):
        assert set(alpha[part == scene.part_names.index(name)]) == {value}


def test_split_alpha(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert simulate_command.split_alpha("a.ply") == (Path("a.ply"), None)
    assert simulate_command.split_alpha("a.ply:0.25") == (Path("a.ply"), 0.25)
    assert simulate_command.split_alpha("c:a.ply") == (Path("c:a.ply"), None)
    Path("a.ply:1").touch()  # a file of that very name
    assert simulate_command.split_alpha("a.ply:1") == (Path("a.ply:1"), None)


def test_transform_moves_the_mesh(made: Path, tmp_path: Path, run: Run) -> None:
    matrix = [[0.0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.03], [0, 0, 0, 1]]
    forms = (matrix, np.ravel(matrix).tolist(), {"transform": matrix, "rms_m": 1})
    path = tmp_path / "t.json"
    for form in forms:
        path.write_text(json.dumps(form))
        read = PlacementOptions(transform=path).matrix()
        assert np.array_equal(read, matrix)
    named = [(made / "hand.ply", None)]
    moved = simulate_command.load_scene(named, 0.5, {}, "m", read)
    assert moved.digest() == clradar.Scene.from_mesh(made / "hand.ply", transform=matrix).digest()
    for text in ("", "{", "[1, 2]", '{"matrix": []}', '["a"]', json.dumps([0] * 16),
                 "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]",
                 "[[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"):  # fmt: skip
        path.write_text(text)
        with pytest.raises(ClradarError, match=r"t\.json"):
            PlacementOptions(transform=path).matrix()
    outcome = run("simulate", made / "hand.ply", "-o", tmp_path / "x.h5", "--transform", path)
    one_error_line(outcome, "t.json")


# image and its grid


def test_axis_in_millimetres() -> None:
    assert axis_mm("--x-mm", "-100:100:1") == (-100.0, 100.0, 1.0)
    assert axis_mm("--x-mm", "300") == (300.0, 300.0, 1.0)
    assert axis_mm("--x-mm", "0:0.3:0.1") == (0.0, 0.3, 0.1)
    for text in ("", "a:b:c", "1:2", "1:2:3:4", "0:1:0", "0:1:-1", "0:1:0.3", "inf"):
        with pytest.raises(typer.BadParameter):
            axis_mm("--x-mm", text)


def test_the_default_grid_is_that_of_the_paper() -> None:
    grid = GridOptions().grid()
    paper = clradar.VoxelGrid.from_extent((-0.1, 0.1), (-0.1, 0.1), (0.26, 0.34), 1e-3)
    assert grid.counts == (201, 201, 81)
    assert grid.same_voxels(paper, tolerance_m=1e-15)


def test_image_writes_what_the_library_gives(made: Path) -> None:
    volume = open_volume(made / "volume.h5")
    capture = open_capture(made / "sim.h5")
    grid = clradar.VoxelGrid.from_extent(
        (-0.06, 0.06), (-0.09, 0.09), (0.28, 0.32), (6e-3, 6e-3, 5e-3)
    )
    expected = clradar.backproject(capture, grid, device="pocl")
    assert volume.grid.same_voxels(grid)
    assert np.array_equal(volume.data, expected.data)
    assert volume.meta["capture"]["settings"]["seed"] == 7
    digest = sha256_of(made / "sim.h5")
    assert volume.meta["inputs"] == [{"file": "sim.h5", "sha256": digest}]


def test_image_of_a_recording_and_its_figure(run: Run, made: Path, tmp_path: Path) -> None:
    target, png = tmp_path / "v.h5", tmp_path / "v.png"
    outcome = run("image", made / "recording", "-o", target, "--png", png, "--method", "exact",
                  "--window", "hann", *GRID)  # fmt: skip
    assert outcome.status == 0, outcome.err
    volume = open_volume(target)
    expected = clradar.backproject(
        open_capture(made / "sim.h5"), volume.grid, method="exact", window="hann", device="pocl"
    )
    assert np.array_equal(volume.data, expected.data)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert [i["file"] for i in volume.meta["inputs"]] == ["000000.npy"]


# convert, inspect


def test_convert_keeps_every_bit(run: Run, made: Path, tmp_path: Path) -> None:
    outcome = run("convert", made / "recording", "-o", tmp_path / "c.h5")
    assert outcome.status == 0, outcome.err
    converted, recorded = open_capture(tmp_path / "c.h5"), open_capture(made / "recording")
    assert np.array_equal(converted.data, recorded.data)
    assert converted.array.same_positions(recorded.array, tolerance_m=0.0)
    assert converted.meta["format"] == "maroon"
    assert [i["file"] for i in converted.meta["inputs"]] == ["000000.npy"]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("sim.h5", "native capture"), ("volume.h5", "native volume"), ("recording", "recording")],
)
def test_inspect(run: Run, made: Path, name: str, kind: str) -> None:
    outcome = run("inspect", made / name)
    assert outcome.status == 0, outcome.err
    assert f"{name}: {kind}" in outcome.out.splitlines()[0]
    described = json.loads(run("inspect", made / name, "--json").out)
    assert described["kind"] == kind
    assert described["facts"]["data"]["type"] == "complex64"
    assert described["problems"] == []
    checked = run("inspect", made / name, "--check")
    assert checked.status == 0, checked.err
    assert "all right" in checked.out
    assert json.loads(run("inspect", made / name, "--check", "--json").out)["ok"] is True


def test_check_finds_a_changed_byte(run: Run, made: Path, tmp_path: Path) -> None:
    content = bytearray((made / "sim.h5").read_bytes())
    content[len(content) // 2] ^= 1
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(content)
    outcome = run("inspect", damaged, "--check")
    one_error_line(outcome, "damaged.h5")
    assert "problem" in outcome.out


# compare


def test_compare_writes_figure_and_metrics(run: Run, made: Path, tmp_path: Path) -> None:
    volume = open_volume(made / "volume.h5")
    rng = np.random.default_rng(1)
    size = float(np.abs(volume.data).max())
    noise = size * 0.05 * (rng.standard_normal((*volume.data.shape, 2)) @ [1, 1j])
    other = clradar.Volume(volume.data + noise, volume.grid, {"kind": "another program's"})
    save_volume(tmp_path / "other.h5", other)
    png, record = tmp_path / "c.png", tmp_path / "c.json"
    # The capture is imaged on the grid of the volume, so it is the measured image itself.
    outcome = run("compare", made / "volume.h5", made / "sim.h5", tmp_path / "other.h5",
                  "-o", png, "--json", record)  # fmt: skip
    assert outcome.status == 0, outcome.err
    assert png.read_bytes().startswith(b"\x89PNG")
    saved = json.loads(record.read_text())
    assert [s["label"] for s in saved["simulated"]] == [
        "\N{GREEK SMALL LETTER ALPHA} = 0.4",
        "other",
    ]
    first, second = (s["metrics"] for s in saved["simulated"])
    assert first == clradar.compare(volume, volume).to_dict()
    assert first["db_correlation"] == 1.0
    assert second == clradar.compare(volume, other).to_dict()
    assert {i["file"] for i in saved["inputs"]} == {"volume.h5", "sim.h5", "other.h5"}
    rows = [line for line in outcome.out.splitlines() if line.startswith("other")]
    assert f"{second['db_correlation']:.3f}" in rows[0]
    assert f"{1e3 * second['depth_rmse_m']:.2f}" in rows[0]


def test_compare_chooses_from_a_recording(run: Run, made: Path, tmp_path: Path) -> None:
    capture = open_capture(made / "sim.h5")
    other = clradar.Capture(np.roll(capture.data, 9, axis=0), capture.array, capture.waveform)
    recording = tmp_path / "recording"
    save_maroon_frame(recording, other)
    save_maroon_frame(recording, other, frame=1, force=True)
    save_maroon_frame(recording, capture, frame=1, variant="emptyfiltered", force=True)
    record = tmp_path / "c.json"

    def correlation(*options: str) -> float:
        outcome = run("compare", recording, made / "sim.h5", "--json", record, "--force", *GRID,
                      *options)  # fmt: skip
        assert outcome.status == 0, outcome.err
        return json.loads(record.read_text())["simulated"][0]["metrics"]["db_correlation"]

    assert correlation("--frame", "1", "--variant", "emptyfiltered") == 1.0
    inputs = json.loads(record.read_text())["inputs"]
    assert [i["file"] for i in inputs] == ["000001_emptyfiltered.npy", "sim.h5"]
    assert correlation("--frame", "1") < 0.9
    assert correlation() < 0.9
    for name in ("volume.h5", "sim.h5"):
        outcome = run("compare", made / name, made / "sim.h5", "--frame", "0")
        one_error_line(outcome, name, "a folder of frames")


def test_labels() -> None:
    def simulated(low: float, high: float) -> dict[str, Any]:
        return {"capture": {"scene": {"alpha_min": low, "alpha_max": high}}}

    alpha = "\N{GREEK SMALL LETTER ALPHA}"
    paths = [Path("a/one.h5"), Path("b/two.h5")]
    metas = [simulated(0.0, 0.0), simulated(0.3, 0.3)]
    assert comparison.labels_of(paths, metas) == [f"{alpha} = 0", f"{alpha} = 0.3"]
    metas = [simulated(0.3, 0.3), simulated(0.3, 0.3)]
    assert comparison.labels_of(paths, metas) == ["one", "two"]
    metas = [simulated(0.0, 1.0), {}]
    assert comparison.labels_of(paths, metas) == ["one", "two"]
    same = [Path("a/x.h5"), Path("b/x.h5")]
    assert comparison.labels_of(same, metas) == ["a/x.h5", "b/x.h5"]


def test_alpha_of_a_foreign_file_is_unknown() -> None:
    for meta in ({}, {"scene": 3}, {"scene": {}}, {"capture": [], "scene": {"alpha_min": "x"}}):
        assert comparison.alpha_of(meta) is None


def test_recordings_of_another_array_are_imaged_too(run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    array = clradar.AntennaArray(rng.normal(size=(3, 3)) * 0.02, rng.normal(size=(5, 3)) * 0.02)
    data = rng.normal(size=(3, 5, 4)) + 0j
    capture = clradar.Capture(data, array, clradar.Waveform.sfcw(24e9, 26e9, 4))
    save_capture(tmp_path / "own.h5", capture)
    outcome = run("image", tmp_path / "own.h5", "-o", tmp_path / "v.h5", "--x-mm", "0",
                  "--y-mm", "-20:20:10", "--z-mm", "250:350:50")  # fmt: skip
    assert outcome.status == 0, outcome.err
    assert open_volume(tmp_path / "v.h5").grid.counts == (1, 5, 3)


def test_a_capture_without_receptions_is_warned_of(run: Run, made: Path, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing.h5"
    outcome = run("simulate", made / "hand.ply", "-o", nothing, "--samples-per-mm2", "1e-9")
    assert outcome.status == 0
    assert "clradar: warning: no ray reached a receiver" in outcome.err
    figure = tmp_path / "nothing.png"
    outcome = run("image", nothing, "-o", tmp_path / "v.h5", *GRID, "--png", figure)
    assert outcome.status == 0
    assert "zero everywhere" in outcome.err
    assert not figure.exists()


def test_a_scene_behind_the_aperture_is_warned_of(run: Run, made: Path, tmp_path: Path) -> None:
    placed = tmp_path / "T.json"
    placed.write_text(json.dumps([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.3], [0, 0, 0, 1]]))
    outcome = run(
        "simulate", made / "hand.ply", "-o", tmp_path / "s.h5", "--transform", placed,
        "--samples-per-mm2", "0.01",
    )  # fmt: skip
    assert outcome.status == 0
    assert "clradar: warning: the scene reaches behind the aperture" in outcome.err
