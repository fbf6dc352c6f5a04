"""The program as a process: what it loads, signals, languages, pipes, files named as ours."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_line import GRID
from nightly import nightly
from systems import posix_only

import clradar
from clradar.cli import main
from clradar.cli.app import MODULES
from clradar.errors import MeshError

ROOT = Path(clradar.__file__).resolve().parents[1]


def python(*arguments: object, cwd: Path | None = None, **variables: str) -> Any:
    """A run of Python with these words and variables of the environment."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )


MAIN = "from clradar.cli import main; main()"


@pytest.mark.parametrize(
    ("typed", "completed"), [("image --met", "--method"), *nightly([("pro", "process")])]
)
def test_a_shell_completes_commands_and_their_options(typed, completed):
    words = f"clradar {typed}"
    variables = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    done = python("-c", MAIN, _CLRADAR_COMPLETE="complete_bash", **variables)
    assert done.stdout.split() == [completed]


HEAVY = {"trimesh", "scipy", "skimage", "matplotlib", "h5py", "rich.progress"}
"""Modules that a help text does not need."""

LOADED = """
import sys
from clradar.cli import main
try:
    main(sys.argv[1:])
except SystemExit as e:
    assert not e.code
print('\\n' + ' '.join(sys.modules))
"""


@pytest.mark.parametrize(
    ("line", "not_needed"),
    [("--help", {*HEAVY, "numpy", "pyopencl", "measurement_io"}), ("simulate --help", HEAVY)],
)
def test_help_imports_nothing_heavy(line, not_needed):
    done = python("-W", "error", "-c", LOADED, *line.split())
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.splitlines()[-1].split())
    others = {f"clradar.cli.commands.{own}" for own in MODULES if own not in line.split()}
    assert not (not_needed | others) & loaded
    assert "clradar.cli.app" in loaded


@pytest.mark.parametrize("place", [0, 1, 4])
def test_debug_shows_the_traceback(place):
    arguments = ["simulate", "none.ply", "-o", "x.h5"]
    arguments.insert(place, "--debug")
    with pytest.raises(MeshError, match=r"none\.ply"):
        main(arguments)


def test_an_unexpected_error_names_its_type(cli, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("first line\nsecond line")

    monkeypatch.setattr("clradar.hand.hand_mesh", broken)
    outcome = cli("hand -o x.ply")
    assert outcome.status == 1
    said = "ZeroDivisionError: first line second line"
    assert said in outcome.err
    assert "--debug" in outcome.err
    assert outcome.err.count("\n") == 1


SENDING = """
import os, signal, sys, tempfile, time
from pathlib import Path
import clradar.hand
from clradar.cli import main
from clradar.files import interrupts
from clradar.files.atomic import replacing
from clradar.jobs.lock import held, scratch_folder

tempfile.tempdir = os.getcwd()
signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs behind a shell ignores it
send = lambda: os.kill(os.getpid(), signal.SIG{name})

def hand(*a, **k):
    with scratch_folder(), held(Path("folder"), "sweep"), replacing("file") as temporary:
        Path("folder/done").touch()
        temporary.touch()
        {sent}
        time.sleep(60)

def importing(_):
    try:
        exec("send()\\nwhile True: pass")  # as dataclasses and named tuples are made
    except KeyboardInterrupt:
        raise ImportError("as numpy has it") from None

def starting():
    with interrupts.interrupts_blocked():
        send()
        Path("folder/whole").touch()

clradar.hand.hand_mesh = hand
{before}
main(["hand", "-o", "x.ply"])
"""
RESUMES = "clradar: interrupted; the same command resumes folder\n"


@posix_only
@pytest.mark.parametrize(
    ("name", "sent", "left"),
    [
        ("INT", "send()", {"done"}),
        ("TERM", "starting()", {"done", "whole"}),
        *nightly([("HUP", "send()", {"done"})]),
    ],
)
def test_signals_leave_things_in_order(name, sent, left, tmp_path):
    code = SENDING.format(name=name, sent=sent, before="")
    done = python("-W", "error", "-c", code, cwd=tmp_path)
    assert (done.stderr, done.returncode) == (RESUMES, 128 + getattr(signal, f"SIG{name}"))
    assert {path.name for path in (tmp_path / "folder").iterdir()} == left
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


@posix_only
def test_a_signal_before_a_command_is_one_line(tmp_path):
    before = "import clradar.cli.app as app; app.main = importing"
    (tmp_path / "program.py").write_text(SENDING.format(name="TERM", sent="", before=before))
    done = python("-B", "-W", "error", "-m", "program", cwd=tmp_path)
    assert (done.stderr, done.returncode) == ("clradar: interrupted\n", 128 + signal.SIGTERM)
    assert [path.name for path in tmp_path.iterdir()] == ["program.py"]


NAME = "Häñde und 手"
"""Blanks, umlauts, and what no code page of Europe has."""

ASCII = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}

CHAIN = """
import sys
from clradar.cli import main
for command in sys.argv[1:]:
    try:
        main(command.split(chr(10)))
    except SystemExit as end:
        print("ended: ", end.code or 0, ";", sep="", file=sys.stderr)
"""
"""A process that runs several commands."""


NAMED = (
    "image|~ sim.h5|-o|~ volume.h5|" + GRID.replace(" ", "|"),
    "convert|~ recording|-o|~ frame.h5",
    "inspect|~ recording",
    "export|~ volume.h5|-o|~.ply",
    "image|~ missing.h5|-o|x.h5",
)


@pytest.mark.parametrize("language", ["C", *nightly(["utf-8"])])
def test_blanks_and_umlauts_in_every_path(made, tmp_path, language):
    """A chain through all kinds of files, its folder and their names included."""
    folder = tmp_path / NAME
    folder.mkdir()
    shutil.copy(made / "sim.h5", folder / f"{NAME} sim.h5")
    shutil.copytree(made / "recording", folder / f"{NAME} recording")
    commands = [line.replace("~", NAME).replace("|", "\n") for line in NAMED]
    variables = ASCII if language == "C" else {"PYTHONUTF8": "1"}
    done = python("-W", "error", "-c", CHAIN, *commands, cwd=folder, **variables)
    assert "Traceback" not in done.stderr
    *passed, (err, status) = [said.split("ended: ") for said in done.stderr.split(";\n")[:-1]]
    assert [status for _, status in passed] == ["0"] * (len(NAMED) - 1), done.stderr
    for name in (" volume.h5", " frame.h5", ".ply"):
        assert (folder / f"{NAME}{name}").exists()
    assert status == "1"
    assert err.count("\n") == 1
    assert (r"H\udcc3\udca4" if language == "C" else "Hä") in err


@posix_only
@pytest.mark.parametrize("command", ["materials", *nightly(["inspect recording --json"])])
def test_a_pipe_that_ends_is_no_error(made, command):
    """As of `| head -1`: the reader is gone before the first line is written."""
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "clradar", *command.split()]
    done = subprocess.run(words, cwd=made, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder whose files have the names of ours, and must not run."""
    for name in ("calibration.py", "measurement_io.py", "kernels/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("raise SystemExit('the file of the lab ran')\n")
    # The folder of a script is first on Python's path.
    (tmp_path / "script.py").write_text("from clradar.cli import main; main(['devices'])")
    return tmp_path


CLEAN = "clean none.h5 --channels none.h5 -o x.h5"
"""A command that imports both packages before it reads a file."""


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (f"-m clradar {CLEAN}", "clradar: error: none.h5: no such file"),
        ("script.py", "clradar: error: {lab}/calibration.py: hides "),
    ],
)
def test_files_of_the_names_of_ours_are_passed_by_or_named(lab, line, said):
    done = python(*line.split(), cwd=lab, PYTHONPATH=str(ROOT))
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert done.stderr.startswith(said.format(lab=lab))


def test_our_name_taken_by_a_file_raises_from_the_library(lab):
    done = python("-c", "import clradar; clradar.open_dataset", cwd=lab, PYTHONPATH=str(ROOT))
    hidden = f"{lab / 'measurement_io.py'}: hides "
    assert f"clradar.errors.PackageError: {hidden}" in done.stderr
    assert "rename it" in done.stderr


@pytest.mark.slow
def test_the_command_of_a_checkout_that_is_not_installed():
    # `python -m` finds clradar in the current folder only; that folder has to stay on the path.
    done = python("-m", "clradar", "inspect", "none.h5", cwd=ROOT, PYTHONPATH="")
    assert (done.returncode, done.stderr.split(": ")[2]) == (1, "none.h5")
