"""Where commands write: one rule for the outputs of all of them, and nothing left of a refusal."""

from __future__ import annotations

import inspect
import os
import re
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import pytest
from command_line import Run, one_error_line
from systems import posix_only

from clradar.cli.app import COMMANDS, module_of
from clradar.cli.groups import expanded

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
    "dataset --replay in.h5 0 -o {} --force",
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
OUTPUTS = {"output", "png", "joints", "plot", "json", "json_file", "fix_to", "report", "html"}
INPUTS = {
    "rig", "mapping", "theta", "transform", "capture", "captures", "source", "sources", "layout",
    "rx_file", "tx_file", "empty", "file", "files", "materials", "measured", "simulated", "mesh",
    "channels", "plan", "replay", "rigs", "path", "recording", "motion",
}  # fmt: skip
"""Parameters of commands that are paths; `joints` of a sweep is read."""


def is_path(hint: Any) -> bool:
    return hint is Path or any(is_path(part) for part in get_args(hint))


def path_parameters(name: str) -> dict[str, Any]:
    """The parameters of a command that are paths: name -> typer's declaration."""
    command = expanded(import_module(module_of(name)).command)
    found = {}
    for parameter in list(inspect.signature(command).parameters.values())[1:]:  # after the context
        hint, declared = get_args(parameter.annotation)
        if is_path(hint):
            found[parameter.name] = declared
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_every_output_of_every_command_is_tried_here(name: str) -> None:
    lines = [line.split() for line in FILE_OUTPUTS + FOLDER_OUTPUTS]
    for parameter, declared in path_parameters(name).items():
        assert parameter in OUTPUTS | INPUTS, f"clradar {name}: is {parameter} read or written?"
        if parameter not in OUTPUTS or (name, parameter) == ("sweep", "joints"):
            continue
        options = {declared.default, *declared.param_decls}  # as typer keeps those of Annotated
        assert any(
            line[0] == name and option in options and "{}" in value
            for line in lines
            for option, value in pairwise(line)
        ), f"clradar {name}: no line above writes to {sorted(options)}"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with inputs that cannot be read, a data set, and a recording."""
    monkeypatch.chdir(tmp_path)
    for name in ("in.h5", "in.ply", "in.json", "ds/manifest.json", "ds/shards/shard-00000.h5",
                 "hand/30/radar_72.0_82.0_2/calibrated_data/000000.npy",
                 "hand/30/photogrammetry/mesh.obj", "hand/30/alignment.json"):  # fmt: skip
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text("as it was")
    plan = 'samples = 1\nposes.names = ["A"]\noutput.products = ["joints"]'
    (tmp_path / "plan.toml").write_text(plan)
    (tmp_path / "wall.toml").write_text(
        'copy_of = "qar50"\npairs = "cluster"\npose = [{points_m = [[0, 0, 0], [0, 1, 0]]}]'
    )
    return tmp_path


def tree(folder: Path) -> dict[str, Any]:
    """What is in a folder: the bytes of its files, the kind of all else."""
    return {
        str(path): path.lstat().st_mode
        if path.is_symlink() or not path.is_file()
        else path.read_bytes()
        for path in folder.rglob("*")
    }


WRONG_INPUTS = {
    "text": lambda path: path.write_text("as it was"),
    "folder": lambda path: path.mkdir(),
    "nothing": lambda path: None,
}
if sys.platform != "win32":
    WRONG_INPUTS["pipe"] = os.mkfifo


@pytest.mark.parametrize("line", FILE_OUTPUTS + FOLDER_OUTPUTS)
def test_a_command_that_fails_leaves_nothing(run: Run, place: Path, line: str) -> None:
    for kind, made in WRONG_INPUTS.items():
        for name in ("in.h5", "in.ply", "in.json"):
            path = place / name
            if path.is_dir():
                path.rmdir()
            else:
                path.unlink(missing_ok=True)
            made(path)
        before = tree(place)
        outcome = run(*line.format("new").split())
        one_error_line(outcome)
        assert "unexpected" not in outcome.err, kind
        assert tree(place) == before, kind


OWNED = (
    "ds/shards/shard-00000.h5",
    "ds/shards/new",
    "hand/30/radar_72.0_82.0_2/calibrated_data/000001",
    "hand/30/radar_72.0_82.0_2/new",
    "hand/30/photogrammetry/mesh.obj",
)
"""Places in a data set and in a recording."""


@posix_only
@pytest.mark.parametrize("line", FILE_OUTPUTS + FOLDER_OUTPUTS)
def test_no_output_goes_where_something_else_is(run: Run, place: Path, line: str) -> None:
    """Refused before an input is read: none can be."""
    suffix = line.split("{}")[1].split()[0] if "{}." in line else ""
    os.mkfifo(f"pipe{suffix}")
    os.symlink(f"pipe{suffix}", f"link{suffix}")
    os.link("in.json", f"hard{suffix}")
    os.symlink("in.json", f"soft{suffix}")
    Path(f"kept{suffix}").touch()
    before = tree(place)
    refused = [(line, f"{name}/x", "expected an existing folder") for name in ("no/such", "in.h5")]
    refused += [(line, name, f"{name}{suffix}: expected a f") for name in ("pipe", "link")]
    first = (FILE_OUTPUTS + FOLDER_OUTPUTS).index(line)  # one rule, tried in turn
    refused += [(line, OWNED[i % 5], "belongs to the |got a file") for i in (first, first + 2)]
    if line in FILE_OUTPUTS:
        kept = "exists already; --force replaces it"
        refused.append((line.removesuffix(" --force"), "kept", kept))
        refused += [(line, name, "also an input") for name in ("hard", "soft") if "in.json" in line]
    for words, name, said in refused:
        outcome = run(*words.format(name).split())
        one_error_line(outcome)
        assert re.search(said, outcome.err)
    assert tree(place) == before


def test_an_input_is_not_replaced_with_its_folder(run: Run, place: Path) -> None:
    (place / "old").mkdir()
    for name in ("placed.ply", "transform.json", "metadata.json", "fit.json"):
        (place / "old" / name).write_text("as it was")
    before = tree(place)
    for line in (
        "register in.h5 old/placed.ply -o old --force",
        "convert in.h5 --to maroon --rx-file old/metadata.json -o old --force",
        "fit-hand in.h5 --pose old -o old --force",
    ):
        one_error_line(run(*line.split()), "old: holds the input 'old/")
    assert tree(place) == before


def test_the_file_that_a_layout_names_is_an_input_too(run: Run, place: Path) -> None:
    import numpy as np

    np.savez("lab.npz", s=np.ones((2, 2, 3), np.complex64))
    for side in ("tx", "rx"):
        (place / f"{side}.csv").write_text("x,y,z\n0,0,0\n0.1,0,0\n")
    (place / "lab.toml").write_text(
        'data = {key = "s", axes = ["tx", "rx", "freq"]}\n'
        'frequency = {start = 72, stop = 82, points = 3, unit = "GHz"}\n'
        'tx = {file = "tx.csv"}\nrx = {file = "rx.csv"}\nantennas = {unit = "m"}\n'
    )
    before = tree(place)
    line = "convert lab.npz --layout lab.toml -o tx.csv --force"
    one_error_line(run(*line.split()), "tx.csv: is also an input")
    assert tree(place) == before
