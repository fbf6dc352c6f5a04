"""Help, exit status and errors of all commands."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_line import GRID, Run, one_error_line
from systems import posix_only

import clradar
from clradar.cli import main
from clradar.cli.app import COMMANDS, context_of, module_of
from clradar.errors import MeshError

HEAVY = ("trimesh", "scipy", "skimage", "matplotlib", "h5py", "measurement_io", "rich.progress")
"""Modules that a help text does not need."""


def in_process(code: str, *arguments: str, **kwargs: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=False,
        **kwargs,
    )


def test_help_lists_the_commands_there_are(run: Run) -> None:
    outcome = run("--help")
    assert outcome.status == 0
    listed = outcome.out.split("Commands:")[1]
    for name in COMMANDS:
        assert f"  {name}" in listed


HELP = {
    "devices": "CLRADAR_DEVICE",
    "materials": "[FILE.toml]... --band-ghz FIRST:LAST --json docs/materials.md metres",
    "array": "[ARRAY] --output --at-mm --band --within-deg --json docs/arrays.md",
    "demo": "--full --force --device SNR",
    "hand": "--edge-mm --left --list --joints --length-mm --device metres",
    "process": "RECORDING --frames --average --empty --empty-by --channels --gate-mm --mesh "
    "--workers --keep-captures --keep-volumes --output fit-hand",
    "simulate": "--alpha --unit --transform --samples-per-mm2 --rays-per-sample --rays-per-face "
    "--reception-radius-mm --max-bounces --normals --crease-deg --amplitude --array "
    "--band --seed --clusters --workers --device --force MESH[:ALPHA] PART=ALPHA",
    "image": "--x-mm --y-mm --z-mm -100:100:1 260:340:1 --method exact --tolerance-db --window "
    "taylor --png --dynamic-range-db",
    "convert": "--frame --variant emptyfiltered --to --all-frames --timestamp-us",
    "export": "SOURCE --output .vti .ply .mat .npz --depth-map --dynamic-range-db --frame "
    "--variant --force metres",
    "view": "PATH 127.0.0.1 clradar[view] --watch --variant --html --force --port "
    "--dynamic-range-db",
    "live": "SOURCE tcp:PORT --output --tolerance-db --window --variant --watch --frames "
    "--dynamic-range-db --x-mm --device --force docs/live.md",
    "replay": "RECORDING --to --rate-hz --repeat --variant docs/live.md",
    "clean": "--empty --scaling --gate-mm --edge-mm --clutter-db --average --align-phase "
    "--channels --gains --keep-noisy --frame --variant NEAR:FAR",
    "channels": "--target plate --distance-mm --tilt-deg --size-mm --position-mm --radius-mm "
    "--tolerance-mm --hold --common-delay --level --gate-mm --plot --frame",
    "diagnose": "--expect-mm --json --output --frame --variant --device",
    "inspect": "--check --json --png",
    "dataset": "[PLAN.toml] --output --dry-run --replay",
    "compare": "MEASURED SIMULATED --json --dynamic-range-db docs/metrics.md --frame --variant "
    "--report",
    "align": "MEASURED [SIMULATED] --mesh --unit -o --search-deg",
    "register": "MEASURED MESH -o --alpha fit --max-rounds --force",
    "fit-hand": "MEASURED -o --pose --start all --hand --fit-shape --alpha fit --quick "
    "--angle-std-deg --search-deg --length-mm --rig --x-mm --frame --force docs/hand-fit.md",
    "sweep": "MEASURED MESH --alpha FIRST:LAST:STEP --seeds --metric --regions "
    "parts|fingers|FILE --joints --transform --align --samples-per-mm2 --max-bounces --x-mm "
    "--device --force docs/sweep.md",
}
"""What the help of each command has to name."""


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_each_command(run: Run, name: str) -> None:
    outcome = run(name, "--help")
    assert (outcome.status, outcome.err) == (0, "")
    text = " ".join(outcome.out.split())
    assert text.startswith(f"Usage: clradar {name}")
    assert COMMANDS[name] in text
    assert not [word for word in HELP[name].split() if word not in text]
    context = context_of(name)
    records = [p.get_help_record(context) for p in context.command.get_params(context)]
    names = [record[0].split()[0] for record in records if record is not None]
    assert "-h," in names
    assert not [one for one in names if one not in text]


def test_version(run: Run) -> None:
    outcome = run("--version")
    assert (outcome.status, outcome.out) == (0, f"clradar {clradar.__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "not_needed"),
    [(["--help"], {*HEAVY, "numpy", "pyopencl"}), (["simulate", "--help"], set(HEAVY))],
)
def test_help_imports_nothing_heavy(arguments: list[str], not_needed: set[str]) -> None:
    code = (
        "import sys\n"
        "from clradar.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as e:\n    assert not e.code\n"
        "print('\\n' + ' '.join(sys.modules))"
    )
    done = in_process(code, *arguments)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.splitlines()[-1].split())
    assert not not_needed & loaded
    assert "clradar.cli.app" in loaded
    others = {module_of(name) for name in COMMANDS if name != arguments[0]}
    assert not others & loaded


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
        (["simulate", "hand.ply", "-o", "x.h5", "--unit", "furlong"], "--unit"),
        (["simulate", "hand.ply", "-o", "x.h5", "--band", "82:72:8"], "FIRST below LAST"),
        (["simulate", "hand.ply", "-o", "x.h5", "--band", "72:82:0"], "STEPS from 1"),
        (["image", "sim.h5", "-o", "x.h5", "--x-mm", "10:0:1"], "--x-mm"),
        (["image", "sim.h5", "-o", "x.h5", "--y-mm", "0:10"], "--y-mm"),
        (["image", "sim.h5", "-o", "x.h5", "--z-mm", "0:10:3"], "0:9:3"),
        (["image", "sim.h5", "-o", "x.h5", "--z-mm", "0:nan:3"], "--z-mm"),
        (["image", "sim.h5", "-o", "x.h5", "--method", "quick"], "--method"),
        (["image", "volume.h5", "-o", "x.h5"], "an image already"),
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
        (["simulate", "hand.ply", "-o", "x.h5", "--alpha", "nail=0"], ("palm", "nail")),
        (["simulate", "hand.ply", "-o", "x.h5", "--device", "abacus"], ("abacus",)),
        (["hand", "-o", "x.ply", "--device", "abacus"], ("abacus",)),
        (["simulate", "hand.ply", "-o", "x.h5", "--samples-per-mm2", "-1"], ("positive",)),
        (["simulate", "hand.ply", "-o", "no/x.h5"], ("no/x.h5", "folder")),
        (["simulate", "hand.ply", "-o", "."], ("folder",)),
        (["simulate", "hand.ply", "-o", "hand.ply", "--force"], ("also an input",)),
        (["hand", "J", "-o", "x.ply"], ("pose", "'J'")),
        (["hand", "F", "-o", "x.stp"], (".ply", "'.stp'")),
        (["image", "hand.ply", "-o", "x.h5"], ("hand.ply", "got a mesh")),
        (["image", "sim.h5", "-o", "x.h5", "--png", "x.bmp"], (".png", "'.bmp'")),
        (["image", "sim.h5", "-o", "x.png", "--png", "x.png"], ("twice",)),
        (["image", "sim.h5", "-o", "x.h5", "--dynamic-range-db", "0"], ("positive",)),
        (["convert", "recording", "-o", "x.h5", "--frame", "5"], ("frame 5",)),
        (["convert", "sim.h5", "-o", "x.h5", "--frame", "1"], ("one file",)),
        (["inspect", "none.h5"], ("none.h5",)),
        (["inspect", "none.h5", "--check"], ("none.h5",)),
        (["compare", "volume.h5", "none.h5", "-o", "x.png"], ("none.h5",)),
        (["compare", "volume.h5", "volume.h5", "--report", "x.pdf"], (".html", "'.pdf'")),
    ],
)
def test_an_error_is_1_and_one_line(
    run: Run, made: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], parts: list[str]
) -> None:
    monkeypatch.chdir(made)
    before = sorted(made.iterdir())
    one_error_line(run(*arguments), *parts)
    assert sorted(made.iterdir()) == before


def test_images_on_other_pixels_are_an_error(
    run: Run, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made)
    outcome = run("compare", "volume.h5", "sim.h5", "--x-mm", "0:60:6", *GRID[2:], "-o", "x.png")
    *remarks, error = outcome.err.splitlines()  # the grid cuts the hand
    assert outcome.status == 1
    assert all(line.startswith("clradar: warning: the grid ") for line in remarks)
    assert error.startswith("clradar: error: compare: expected both images on the same pixels")
    assert not (made / "x.png").exists()


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


@posix_only
def test_surroundings_that_packages_would_blame_a_file_for(tmp_path: Path) -> None:
    done = in_process(
        "from clradar.cli import main; main(['materials'])",
        env={**os.environ, "SOURCE_DATE_EPOCH": "x"},
    )
    assert done.stderr == (
        "clradar: error: SOURCE_DATE_EPOCH: expected whole seconds since 1970, got 'x'\n"
    )
    gone = tmp_path / "gone"
    gone.mkdir()
    done = in_process(
        "import os, sys; os.rmdir(os.getcwd()); from clradar.__main__ import run\n"
        "sys.argv = ['clradar', 'materials']; run()",
        cwd=gone,
    )
    expected = "clradar: error: the current folder does not exist any more: change to another\n"
    assert (done.returncode, done.stderr) == (1, expected)


@posix_only
def test_control_c_is_130_without_a_traceback(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys, clradar.hand\n"
        "def interrupted(*a, **k):\n    os.kill(os.getpid(), signal.SIGINT)\n    return 1 / 0\n"
        "clradar.hand.hand_mesh = interrupted\n"
        "from clradar.cli import main\nmain(sys.argv[1:])"
    )
    done = in_process(code, "hand", "-o", str(tmp_path / "x.ply"))
    assert done.returncode == 130
    assert done.stderr == "clradar: interrupted\n"
    assert list(tmp_path.iterdir()) == []


SENDING = """
import os, signal, sys, tempfile, time
from pathlib import Path
import clradar.hand
from clradar.cli import main
from clradar.files import interrupts
from clradar.files.atomic import replacing
from clradar.jobs.lock import held, scratch_folder

tempfile.tempdir = os.getcwd()
send = lambda: os.kill(os.getpid(), signal.SIG{name})

class Lost:
    def __del__(self):
        send()

def hand(*a, **k):
    with scratch_folder(), held(Path("folder"), "sweep"), replacing("file") as temporary:
        Path("folder/done").touch()
        temporary.touch()
        {sent}
        time.sleep(60)

def starting():
    with interrupts.interrupts_blocked():
        send()
        Path("folder/whole").touch()

clradar.hand.hand_mesh = hand
{before}
main(sys.argv[1:])
"""


@posix_only
@pytest.mark.parametrize(
    ("name", "sent", "left"),
    [
        ("INT", "send()", {"done"}),
        ("TERM", "send()", {"done"}),
        ("HUP", "send()", {"done"}),
        ("TERM", "Lost()", {"done"}),  # where Python can raise nothing
        ("INT", "import sending", {"done", "imported"}),
        ("TERM", "starting()", {"done", "whole"}),
    ],
)
def test_signals_leave_things_in_order(
    name: str, sent: str, left: set[str], tmp_path: Path
) -> None:
    module = tmp_path / "modules" / "sending.py"
    module.parent.mkdir()
    module.write_text("import __main__\n__main__.send()\nopen('folder/imported', 'w').close()\n")
    code = SENDING.format(name=name, sent=sent, before="sys.dont_write_bytecode = True")
    paths = os.pathsep.join([str(module.parent), os.environ.get("PYTHONPATH", "")])
    variables = {**os.environ, "PYTHONPATH": paths}
    done = in_process(code, "hand", "-o", "x.ply", cwd=tmp_path, env=variables)
    assert done.stderr == "clradar: interrupted; the same command resumes folder\n"
    assert done.returncode == 128 + getattr(signal, f"SIG{name}")
    assert {path.name for path in (tmp_path / "folder").iterdir()} == left
    assert {path.name for path in tmp_path.iterdir()} == {"modules", "folder"}


@posix_only
@pytest.mark.parametrize(
    ("before", "status", "said"),
    [
        ("interrupts.working = send", 128 + signal.SIGTERM, "clradar: interrupted\n"),
        (
            "clradar.hand.hand_mesh = None; import atexit; atexit.register(send)",
            1,
            "clradar: error",
        ),
    ],
)
def test_signals_before_and_after_a_command(
    before: str, status: int, said: str, tmp_path: Path
) -> None:
    code = SENDING.format(name="TERM", sent="", before=before)
    done = in_process(code, "hand", "-o", "x.ply", cwd=tmp_path)
    assert done.returncode == status, done.stderr
    assert done.stderr.startswith(said)
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
