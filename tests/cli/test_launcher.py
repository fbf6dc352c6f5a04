"""Help, exit status and errors of all commands."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_line import Run, one_error_line
from nightly import nightly
from systems import posix_only

import clradar
from clradar.cli import main
from clradar.cli.app import COMMANDS, PANELS, context_of, module_of
from clradar.errors import MeshError

HEAVY = ("trimesh", "scipy", "skimage", "matplotlib", "h5py", "measurement_io", "rich.progress")
"""Modules that a help text does not need."""


def in_process(code: str, *arguments: str, **kwargs: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        capture_output=True, text=True, check=False, **kwargs,
    )  # fmt: skip


def test_help_lists_the_commands_there_are(run: Run) -> None:
    outcome = run("--help")
    assert outcome.status == 0
    for panel, names in PANELS.items():
        listed = outcome.out.split(f"\n{panel}:\n")[1]
        for name in names:
            assert f"  {name}" in listed


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_each_command(run: Run, name: str) -> None:
    outcome = run(name, "--help")
    assert (outcome.status, outcome.err) == (0, "")
    text = " ".join(outcome.out.split())
    assert text.startswith(f"Usage: clradar {name}")
    assert COMMANDS[name] in text
    context = context_of(name)
    records = [p.get_help_record(context) for p in context.command.get_params(context)]
    names = [record[0].split()[0] for record in records if record is not None]
    assert "-h," in names
    assert not [one for one in names if one not in text]


@pytest.mark.parametrize(
    ("typed", "completed"), [("image --met", "--method"), *nightly([("pro", "process")])]
)
def test_a_shell_completes_commands_and_their_options(typed: str, completed: str) -> None:
    words = f"clradar {typed}"
    variables = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    environment = {**os.environ, "_CLRADAR_COMPLETE": "complete_bash", **variables}
    done = in_process("from clradar.cli import main; main()", env=environment)
    assert done.stdout.split() == [completed]


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


@pytest.mark.parametrize("place", [0, 1, 4])
def test_debug_shows_the_traceback(place: int, tmp_path: Path) -> None:
    arguments = ["simulate", "none.ply", "-o", str(tmp_path / "x.h5")]
    arguments.insert(place, "--debug")
    with pytest.raises(MeshError, match=r"none\.ply"):
        main(arguments)


def test_an_unexpected_error_names_its_type(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("first line\nsecond line")

    monkeypatch.setattr("clradar.hand.hand_mesh", broken)
    outcome = run("hand", "-o", tmp_path / "x.ply")
    one_error_line(outcome, "ZeroDivisionError: first line second line", "--debug")


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
        ("TERM", "Lost()", {"done"}),  # where Python can raise nothing
        ("HUP", "starting()", {"done", "whole"}),
        *nightly([("INT", "import sending", {"done", "imported"}), ("TERM", "send()", {"done"})]),
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
