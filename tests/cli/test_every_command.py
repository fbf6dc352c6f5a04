"""What holds for every command: help, device, radar, progress, and where its outputs go."""

import inspect
import os
import re
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from command_line import GRID
from comparisons import tree
from nightly import nightly
from systems import posix_only

import clradar
from clradar.cli.app import COMMANDS, PANELS, context_of, function_of
from clradar.cli.groups import expanded


def parameters_of(name: str) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(expanded(function_of(name))).parameters)


def test_help_lists_the_commands_there_are(cli):
    printed = cli.ok("--help").out
    for panel, names in PANELS.items():
        listed = printed.split(f"\n{panel}:\n")[1]
        assert all(f"  {name}" in listed for name in names)
    assert cli.ok("--version").out == f"clradar {clradar.__version__}\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_each_command(cli, name):
    outcome = cli.ok(f"{name} --help")
    assert outcome.err == ""
    text = " ".join(outcome.out.split())
    assert text.startswith(f"Usage: clradar {name}")
    assert COMMANDS[name] in text
    assert not re.search(r"[{}]|<(list\[|path|str|float|int)", text)  # types of Python
    context = context_of(name)
    records = [p.get_help_record(context) for p in context.command.get_params(context)]
    names = [record[0].split()[0] for record in records if record is not None]
    assert "-h," in names
    assert not [one for one in names if one not in text]


WITH_DEVICE = {  # and what the command fails for once it has opened the device; "": nothing
    "hand": ("hand A -o new.ply --edge-mm 4", ""),
    "simulate": ("simulate hand.ply -o new.h5 --samples-per-mm2 0.01 --band 72:82:2", ""),
    "image": (f"image sim.h5 -o new.h5 {GRID}", ""),
    "compare": (f"compare sim.h5 none.h5 {GRID}", "none.h5"),
    "diagnose": ("diagnose sim.h5 --x-mm -40:40:20 --y-mm -40:40:20 --z-mm 300", ""),
    "align": ("align none.h5 --mesh hand.ply -o new.json", "none.h5"),
    "register": ("register none.h5 hand.ply -o new", "none.h5"),
    "fit-hand": ("fit-hand none.h5 --pose F -o new", "none.h5"),
    "sweep": ("sweep none.h5 hand.ply -o new", "none.h5"),
    "dataset": ("dataset --replay none 0", "none"),
    "process": (f"process recording -o new {GRID}", ""),
    "view": ("view none.h5", "none.h5"),
    "demo": ("demo -o new", "the demo"),
}
WITH_RADAR = {"simulate", "demo", "array", "register", "align", "sweep", "fit-hand"}
"""Those that take any radar, by --array and --band; the others have it from what they read."""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_with_a_device_takes_all_and_with_a_radar_any(cli, place, monkeypatch, name):
    parameters = parameters_of(name)
    assert ({"array", "band"} <= set(parameters)) == (name in WITH_RADAR)
    assert ("device" in parameters) == (name in WITH_DEVICE)
    if name not in WITH_DEVICE:
        return

    def broken(*_: object) -> None:
        raise ValueError("the demo is made")

    monkeypatch.setattr("clradar.cli.commands.simulate.run_demo", broken)
    monkeypatch.setattr("clradar.cli.commands.process.write_results", lambda *_: None)
    line, reason = WITH_DEVICE[name]
    outcome = cli(f"{line} --device all")
    assert outcome.status == bool(reason), outcome.err
    assert reason in outcome.err
    assert "expected one device" not in outcome.err


@pytest.mark.parametrize(
    ("line", "labels"),
    [
        ("image volume.h5 --png a.png --report a.html", ("drawing", "writing the page")),
        ("inspect recording --check", ("checking",)),
        ("inspect recording --png a.png", ("reading",)),
        *nightly(
            [
                ("compare volume.h5 volume.h5 --report a.html", ("writing the page",)),
                ("align volume.h5 volume.h5 -o a.json", ("aligning",)),
            ]
        ),
    ],
)
@pytest.mark.usefixtures("quickly")
def test_a_terminal_shows_progress_and_a_pipe_none(cli, place, monkeypatch, line, labels):
    for kind in ("html", "image"):
        monkeypatch.setattr(f"clradar.report.{kind}_report", lambda *_, **__: "a page")
    plain = cli.ok(line)
    assert not any(label in plain.err for label in labels)
    for path in place.glob("a.*"):
        path.unlink()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    shown = cli.ok(line)
    assert all(label in shown.err for label in labels)
    assert shown.out == plain.out  # results stay on stdout


FILE_OUTPUTS = (
    "hand in.json -o {}.ply --force",
    "hand in.json -o x.ply --joints {} --force",
    "simulate in.ply --transform in.json -o {} --force",
    "image in.h5 -o {} --force",
    "image in.h5 -o x.h5 --png {}.png --force",
    "image in.h5 -o x.h5 --report {}.html --force",
    "convert in.h5 -o {} --force",
    "export in.h5 -o {}.npz --force",
    "inspect in.h5 --png {}.png --force",
    "clean in.h5 --empty in.json -o {} --force",
    "align in.h5 in.json -o {} --force",
    "channels in.h5 --target plate --distance-mm 300 -o {} --force",
    "channels in.h5 --target plate --distance-mm 300 -o x.h5 --plot {}.png --force",
    "diagnose in.h5 -o {}.png --force",
    "diagnose in.h5 --json {} --force",
    "diagnose in.h5 --fix-to {} --force",
    "compare in.h5 in.json -o {}.png --force",
    "compare in.h5 in.json --json {} --force",
    "compare in.h5 in.json --report {}.html --force",
    "view in.h5 --html {}.html --force",
    "array in.toml -o {}.png --force",
)
FOLDER_OUTPUTS = (
    "demo --device abacus -o {} --force",
    "convert in.h5 --all-frames -o {} --force",
    "convert in.h5 --to maroon -o {} --force",
    "register in.h5 in.ply -o {} --force",
    "sweep in.h5 in.ply -o {} --force",
    "fit-hand in.h5 -o {} --force",
    "dataset plan.toml --device abacus -o {} --force",
    "process hand/30 -o {} --force",
    "simulate in.ply --motion in.toml --frames 2 --device abacus -o {} --force",
    "simulate in.ply --array wall.toml --device abacus -o {} --force",
)
LINES = FILE_OUTPUTS + FOLDER_OUTPUTS
OUTPUTS = {"output", "png", "joints", "plot", "json", "json_file", "fix_to", "report", "html"}
INPUTS = {
    *("rig", "mapping", "theta", "transform", "capture", "captures", "source", "sources", "layout"),
    *("rx_file", "tx_file", "empty", "file", "files", "materials", "measured", "simulated", "mesh"),
    *("channels", "plan", "replay", "rigs", "path", "recording", "motion"),
}
"""Parameters of commands that are paths."""


def is_path(hint: Any) -> bool:
    return hint is Path or any(is_path(part) for part in get_args(hint))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_output_of_every_command_is_tried_here(name):
    lines = [line.split() for line in LINES]
    for key, parameter in list(parameters_of(name).items())[1:]:  # after the context
        hint, declared = get_args(parameter.annotation)
        if not is_path(hint):
            continue
        assert key in OUTPUTS | INPUTS, f"clradar {name}: is {key} read or written?"
        if key in INPUTS:
            continue
        options = {declared.default, *declared.param_decls}  # as typer keeps those of Annotated
        assert any(
            line[0] == name and option in options and "{}" in value
            for line in lines
            for option, value in pairwise(line)
        ), f"clradar {name}: no line above writes to {sorted(options)}"


@pytest.fixture
def unread(tmp_path: Path) -> Path:
    """A folder with inputs that cannot be read, a data set, and a recording."""
    for name in (
        *("in.h5", "in.ply", "in.json", "ds/manifest.json", "ds/shards/shard-00000.h5"),
        *("hand/30/radar_72.0_82.0_2/calibrated_data/000000.npy", "hand/30/alignment.json"),
        *("hand/30/photogrammetry/mesh.obj", "old/placed.ply", "old/transform.json"),
        *("old/metadata.json", "old/fit.json"),
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text("as it was")
    plan = 'samples = 1\nposes.names = ["A"]\noutput.products = ["joints"]'
    (tmp_path / "plan.toml").write_text(plan)
    (tmp_path / "wall.toml").write_text(
        'copy_of = "qar50"\npairs = "cluster"\npose = [{points_m = [[0, 0, 0], [0, 1, 0]]}]'
    )
    return tmp_path


WRONG_INPUTS = {
    "text": lambda path: path.write_text("as it was"),
    "folder": lambda path: path.mkdir(),
    "nothing": lambda path: None,
}
if sys.platform != "win32":
    WRONG_INPUTS["pipe"] = os.mkfifo


@pytest.mark.parametrize("line", LINES)
def test_a_command_that_fails_leaves_nothing(cli, unread, line):
    for made in WRONG_INPUTS.values():
        for name in ("in.h5", "in.ply", "in.json"):
            path = unread / name
            if path.is_dir():
                path.rmdir()
            else:
                path.unlink(missing_ok=True)
            made(path)
        before = tree(unread)
        cli.fails(line.format("new"))
        assert tree(unread) == before


OWNED = (
    "ds/shards/shard-00000.h5",
    "ds/shards/new",
    "hand/30/radar_72.0_82.0_2/calibrated_data/000001",
    "hand/30/radar_72.0_82.0_2/new",
    "hand/30/photogrammetry/mesh.obj",
)
"""Places in a data set and in a recording."""


@posix_only
@pytest.mark.parametrize("line", LINES)
def test_no_output_goes_where_something_else_is(cli, unread, line):
    """Refused before an input is read: none can be."""
    suffix = line.split("{}")[1].split()[0] if "{}." in line else ""
    os.mkfifo(f"pipe{suffix}")
    os.symlink(f"pipe{suffix}", f"link{suffix}")
    os.link("in.json", f"hard{suffix}")
    os.symlink("in.json", f"soft{suffix}")
    Path(f"kept{suffix}").touch()
    before = tree(unread)
    refused = [(f"{name}/x", "expected an existing folder") for name in ("no/such", "in.h5")]
    refused += [(name, f"{name}{suffix}: expected a f") for name in ("pipe", "link")]
    first = LINES.index(line)  # one rule, tried in turn
    refused += [(OWNED[i % 5], "belongs to the |got a file") for i in (first, first + 2)]
    if line in FILE_OUTPUTS:
        kept = line.removesuffix(" --force").format("kept")
        cli.fails(kept, "exists already; --force or force=True replaces it")
        refused += [(name, "also an input") for name in ("hard", "soft") if "in.json" in line]
    for name, said in refused:
        outcome = cli(line.format(name))
        assert outcome.status == 1
        assert re.search(f"^clradar: error: .*({said}).*\n$", outcome.err)
    assert tree(unread) == before


def test_an_input_is_not_replaced_with_its_folder_nor_what_a_layout_names(cli, unread):
    np.savez("lab.npz", s=np.ones((2, 2, 3), np.complex64))
    for side in ("tx", "rx"):
        Path(f"{side}.csv").write_text("x,y,z\n0,0,0\n0.1,0,0\n")
    Path("lab.toml").write_text(
        'data = {key = "s", axes = ["tx", "rx", "freq"]}\n'
        'frequency = {start = 72, stop = 82, points = 3, unit = "GHz"}\n'
        'tx = {file = "tx.csv"}\nrx = {file = "rx.csv"}\nantennas = {unit = "m"}\n'
    )
    before = tree(unread)
    for line, reason in (
        ("register in.h5 old/placed.ply -o old", "old: holds the input 'old/"),
        ("convert in.h5 --to maroon --rx-file old/metadata.json -o old", "old: holds the input"),
        ("fit-hand in.h5 --pose old -o old", "old: holds the input 'old"),
        ("convert lab.npz --layout lab.toml -o tx.csv", "tx.csv: is also an input"),
    ):
        cli.fails(f"{line} --force", reason)
    assert tree(unread) == before
